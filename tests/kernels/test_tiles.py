"""The fast gather of the CPU against the twin and the plain kernel, where it could go wrong."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import Camera, FocalPlane, FocalTerrain, Integrator, VirtualCamera, reference
from hsvaos.kernels import packing
from hsvaos.kernels.arrays import Stack
from hsvaos.kernels.device import resolve_device
from tests.kernels.strategies import (
    in_vectors_only,
    random_camera,
    random_pose,
    random_view,
    seeds,
)
from tests.kernels.test_integrate import looking_down, random_surface


def decibel(image: np.ndarray, twin: np.ndarray, white: float) -> float:
    error = (image - twin).ravel() / white
    return float(10 * np.log10(1.0 / max(np.mean(error**2), 1e-20)))


def plain(integrator: Integrator) -> Integrator:
    """The same integrator, made to use the plain kernel."""
    integrator._packed = None
    return integrator


KINDS = {
    "rgb8": ("uint8", True, "mask"),
    "rgb16": ("uint16", True, "float32"),
    "grey16": ("uint8", False, "float32"),
    "grey32": ("float32", False, None),
    "grey32 weighted": ("float32", False, "uint8"),
}


@in_vectors_only
@given(seed=seeds, kind=st.sampled_from(sorted(KINDS)))
def test_tiles_equal_the_plain_kernel(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    dtype, colour, weight = KINDS[kind]
    count, width, height = int(rng.integers(1, 9)), *map(int, rng.integers(2, 70, 2))
    camera = random_camera(rng, width, height, rng.random() < 0.3)
    white = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    images = (rng.random((count, height, width, 3)[: 4 if colour else 3]) * white).astype(dtype)
    weights = None
    if weight is not None:
        weights = rng.integers(0, 256, (count, height, width), dtype=np.uint8)
        if weight == "mask":
            weights = (weights > 99) * np.uint8(255)
        if weight == "float32":
            weights = (weights / 50.0).astype(np.float32)
    poses = np.stack([random_pose(rng, reach=20.0) for _ in range(count)])
    view, surface = random_view(rng), random_surface(rng)
    aperture = None if rng.random() < 0.5 else rng.uniform(2, 30)
    gains = rng.uniform(0.5, 1.5, (count, 3))
    make = (camera, images, poses, weights)
    fast = Integrator(*make, gains=gains)
    image, cover = fast.integrate(view, surface, aperture)
    assert fast._packed.form == kind
    expected, footprint = plain(Integrator(*make, gains=gains)).integrate(view, surface, aperture)
    # a border may fall on either side of a pixel in float32
    same = np.abs(cover - footprint) <= 2e-3 * np.maximum(footprint, 1.0)
    assert same.mean() > 0.97
    certain = same & (footprint > 0.05)
    if certain.any():
        assert decibel(image[certain], expected[certain], white) > 65.0


@in_vectors_only
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@given(seed=seeds)
def test_rarity_like_weights_lose_no_accuracy(dtype: str, seed: int) -> None:
    """Weights are mostly a hundredth or a thousandth: premultiplied bytes would be noise."""
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, 60, 50, False)
    white = {"uint8": 255, "uint16": 65535}[dtype]
    images = (rng.random((4, 50, 60, 3)) * white).astype(dtype)
    weights = (10.0 ** rng.uniform(-4.0, -1.5, (4, 50, 60))).astype(np.float32)
    weights[rng.random(weights.shape) < 0.01] = 1.0
    poses = np.stack([random_pose(rng) for _ in range(4)])
    view = VirtualCamera(camera, poses[0])
    surface = FocalPlane(rng.uniform(-2, 2))
    integrator = Integrator(camera, images, poses, weights)
    image, footprint = integrator.integrate(view, surface)
    assert integrator._packed.form == "rgb16"
    twin, cover = reference.integrate(camera, images, poses, view, surface, weights)
    inside = (cover > 1e-5) & (np.abs(footprint - cover) < 1e-3 * cover)
    assert inside.sum() > 0.95 * (cover > 1e-5).sum()
    assert decibel(image[inside], twin[inside], white) > 60.0
    assert decibel(footprint[inside] / cover[inside], np.ones(inside.sum()), 1.0) > 60.0


def test_rarity_map_stays_exact() -> None:
    rng = np.random.default_rng(3)
    camera = Camera.from_fov(64, 48, 60)
    rarity = (10.0 ** rng.uniform(-4.0, 0.0, (5, 48, 64))).astype(np.float32)
    poses = np.stack([looking_down(n, 0.5 * n, 20) for n in range(5)])
    view, surface = VirtualCamera(camera, poses[2]), FocalPlane(-1.0)
    for valid in (None, rng.random((48, 64)) > 0.1):
        image, _ = Integrator(camera, rarity, poses, valid).integrate(view, surface)
        share = None if valid is None else np.stack([valid * np.uint8(255)] * 5)
        twin, cover = reference.integrate(camera, rarity, poses, view, surface, share)
        np.testing.assert_allclose(image[cover > 0.1], twin[cover > 0.1], rtol=1e-3, atol=1e-5)


def test_frames_that_see_nothing_of_a_tile_do_not_change_it() -> None:
    """A long strip over a large ground grid: most frames miss most tiles."""
    rng = np.random.default_rng(0)
    camera = random_camera(rng, 40, 30, False)
    poses = np.stack([random_pose(rng, reach=6.0) for _ in range(30)])
    poses[:, 0, 3] += np.linspace(0.0, 300.0, 30)
    images = rng.integers(0, 256, (30, 30, 40, 3), dtype=np.uint8)
    grid = VirtualCamera.ortho(310.0, -20.0, 0.8, 50, 400)
    wave = 2.0 * np.sin(np.arange(-30.0, 331.0, 3.0) / 11.0)
    terrain = FocalTerrain.from_arrays(
        np.arange(-30.0, 331.0, 3.0), np.arange(-30.0, 31.0, 3.0), np.outer(wave, np.ones(21))
    )
    for surface in (FocalPlane(0.5), FocalPlane(point=(0, 0, 1), normal=(0.1, 0.2, 1)), terrain):
        for aperture in (None, 9.0):
            integrator = Integrator(camera, images, poses)
            image, cover = integrator.integrate(grid, surface, aperture)
            plain_image, footprint = plain(integrator).integrate(grid, surface, aperture)
            same = np.abs(cover - footprint) < 1e-3
            assert same.mean() > 0.999
            np.testing.assert_allclose(image[same], plain_image[same], atol=0.05)
            assert cover.max() > 1.0


def test_a_steep_view_past_the_horizon_and_a_camera_in_the_plane() -> None:
    rng = np.random.default_rng(1)
    camera = Camera.from_fov(64, 64, 80)
    images = rng.integers(0, 256, (3, 64, 64), dtype=np.uint8)
    poses = np.stack([looking_down(n, 0, 20) for n in range(3)])
    level = looking_down(-20, 0, 10)
    level[:3, :3] = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # looks north, horizontally
    view = VirtualCamera(camera, level)
    integrator = Integrator(camera, images, poses)
    image, cover = integrator.integrate(view, FocalPlane(0.0))
    assert (cover[:32] == 0).all()
    assert (image[:32] == 0).all()
    expected, footprint = plain(Integrator(camera, images, poses)).integrate(view, FocalPlane(0.0))
    assert footprint[32:48].any()  # tiles that reach from near by to the horizon
    np.testing.assert_allclose(cover, footprint, atol=2e-2)
    np.testing.assert_allclose(image[footprint > 0.1], expected[footprint > 0.1], atol=1.0)
    _, nothing = integrator.integrate(view, FocalPlane(-10.0))
    assert (nothing == 0).all()


def test_what_has_no_packed_form_is_gathered_plainly() -> None:
    rng = np.random.default_rng(2)
    camera = Camera.from_fov(20, 16, 60)
    poses = [looking_down(0, 0, 20)]
    view = VirtualCamera(camera, poses[0])
    colour = rng.random((1, 16, 20, 3)).astype(np.float32)
    extreme = np.ones((1, 16, 20), np.float32)
    extreme[0, :8] = 1e-12
    for images, weights in ((colour, None), ((colour * 255).astype(np.uint8), extreme)):
        integrator = Integrator(camera, images, poses, weights)
        image, _ = integrator.integrate(view, FocalPlane(0.0))
        assert integrator._packed is None
        np.testing.assert_allclose(image, images[0], rtol=1e-3, atol=1e-3)


def test_no_frame_within_the_aperture_gives_no_sample() -> None:
    camera = Camera.from_fov(20, 16, 60)
    images = np.full((2, 16, 20), 7, np.uint8)
    integrator = Integrator(camera, images, [looking_down(0, 0, 20)] * 2)
    view = VirtualCamera(camera, looking_down(5, 0, 20))
    for frames in (None, []):
        image, cover = integrator.integrate(view, FocalPlane(0.0), 1.0, frames)
        assert not image.any()
        assert not cover.any()


@in_vectors_only
def test_packed_photos_are_made_once_and_shared_masks_count_for_all() -> None:
    rng = np.random.default_rng(0)
    camera = Camera.from_fov(20, 16, 60)
    images = rng.integers(0, 256, (2, 16, 20, 3), dtype=np.uint8)
    integrator = Integrator(camera, images, [looking_down(0, 0, 20)] * 2)
    view = VirtualCamera(camera, looking_down(0, 0, 20))
    first, _ = integrator.integrate(view, FocalPlane(0.0))
    photos = integrator._packed
    again, _ = integrator.integrate(view, FocalPlane(0.0))
    assert integrator._packed is photos
    np.testing.assert_array_equal(first, again)
    assert photos.nbytes == 4 * photos.frame * 2
    assert photos.row * 4 % packing.LINE == 0


@in_vectors_only
@given(seed=seeds, ortho=st.booleans())
def test_a_deep_stack_equals_its_planes_one_by_one(seed: int, ortho: bool) -> None:
    """From 8 planes on photos are gathered in pairs of rows; nothing else may change."""
    rng = np.random.default_rng(seed)
    count, width, height = int(rng.integers(1, 5)), *map(int, rng.integers(2, 60, 2))
    camera = random_camera(rng, width, height, rng.random() < 0.3)
    images = rng.integers(0, 256, (count, height, width, 3), dtype=np.uint8)
    weights = (rng.random((count, height, width)) < 0.7) * np.uint8(255)
    poses = np.stack([random_pose(rng) for _ in range(count)])
    gains = rng.uniform(0.5, 1.5, (count, 3))
    view = VirtualCamera(random_camera(rng, width + 3, height + 2, False), random_pose(rng, 3.0))
    if ortho:
        view = VirtualCamera.ortho(8.0, -8.0, 0.3, width + 3, height + 2)
    integrator = Integrator(camera, images, poses, weights, gains=gains)
    downs = rng.uniform(-3.0, 4.0, 9)
    stack, cover = integrator.sweep(view, downs)
    assert integrator._pairs is not None
    assert integrator._pairs.form == "rgb8 pairs"
    single = Integrator(camera, images, poses, weights, gains=gains)
    for i, down in enumerate(downs):
        image, footprint = single.integrate(view, FocalPlane(down))
        np.testing.assert_array_equal(stack[i], image)
        np.testing.assert_array_equal(cover[i], footprint)
        twin, rays = reference.integrate(
            camera, images, poses, view, FocalPlane(down), weights, gains=gains
        )
        same = (np.abs(cover[i] - rays) < 2e-3 * np.maximum(rays, 1.0)) & (rays > 0.05)
        if same.any():
            assert decibel(stack[i][same], twin[same], 255.0) > 60.0
    assert single._pairs is None


def test_pairs_hold_each_pixel_and_the_one_below() -> None:
    rng = np.random.default_rng(4)
    stack = Stack(rng.integers(0, 256, (2, 5, 7, 3), dtype=np.uint8), resolve_device("cpu"))
    packed = packing.pack(stack, None, 0.0)
    pairs = packing.pair_rows(stack, packed)
    flat, two = packed.words.numpy(), pairs.words.numpy().view(np.uint64)
    for frame in range(2):
        for line in range(6):
            here = flat[frame, line * packed.row :][:9].astype(np.uint64)
            below = flat[frame, (line + 1) * packed.row :][:9].astype(np.uint64)
            twin = here | below << np.uint64(32)
            np.testing.assert_array_equal(two[frame, line * pairs.row :][:9], twin)
    grey = Stack(rng.random((1, 5, 7), np.float32), resolve_device("cpu"))
    assert packing.pair_rows(grey, packing.pack(grey, None, 0.0)) is None
