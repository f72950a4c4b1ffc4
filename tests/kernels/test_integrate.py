"""Rays and integral images against the float64 twin, and the laws they obey."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import Camera, FocalPlane, FocalTerrain, VirtualCamera, reference
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.rays import focal_points
from tests.kernels.strategies import dtypes, random_camera, random_pose, random_view, seeds


def random_surface(rng: np.random.Generator) -> FocalPlane | FocalTerrain:
    kind = rng.integers(3)
    if kind == 0:
        return FocalPlane(rng.uniform(-2, 2))
    if kind == 1:
        tilt = rng.normal(size=3) * 0.2
        return FocalPlane(point=rng.uniform(-1, 1, 3), normal=tilt - (0, 0, 3))
    north, east = np.arange(-40, 41, 2.0), np.arange(-44, 45, 2.0)
    wave = np.sin(north / rng.uniform(4, 9))[:, None] * np.cos(east / rng.uniform(4, 9))
    return FocalTerrain.from_arrays(north, east, rng.uniform(0.2, 1.0) * wave)


def in_world(view: VirtualCamera, surface: FocalPlane | FocalTerrain, device: str) -> np.ndarray:
    hits = focal_points(view, surface, device=device).numpy().reshape(view.height, view.width, 4)
    points = hits[..., :3].astype(float) + view.world_from_camera[:3, 3]
    points[hits[..., 3] == 0.0] = np.nan
    return points


@given(seed=seeds)
def test_focal_points_equal_twin(device: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    view, surface = random_view(rng), random_surface(rng)
    ours, twin = in_world(view, surface, device), reference.focal_points(view, surface)
    both = np.isfinite(ours).all(-1) & np.isfinite(twin).all(-1)
    # a ray may graze a wave of the terrain, or its edge, on one side in float32 only
    assert (np.isfinite(ours).all(-1) == np.isfinite(twin).all(-1)).mean() > 0.98
    error = np.linalg.norm(ours - twin, axis=-1)[both]
    assert np.quantile(error, 0.98) < 2e-3 if error.size else True


@given(seed=seeds, dtype=dtypes, colour=st.booleans(), weighted=st.booleans())
def test_integral_equals_twin(
    device: str, seed: int, dtype: str, colour: bool, weighted: bool
) -> None:
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, 36, 28, rng.random() < 0.5)
    count = int(rng.integers(1, 6))
    shape = (count, 28, 36, 3) if colour else (count, 28, 36)
    white = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    images = (rng.random(shape) * white).astype(dtype)
    poses = np.stack([random_pose(rng) for _ in range(count)])
    weights = None
    if weighted:
        weights = rng.integers(0, 256, (count, 28, 36), dtype=np.uint8)
        form = rng.choice(["uint8", "uint16", "float32"])
        if form == "uint16":
            weights = rng.integers(0, 65536, weights.shape, dtype=np.uint16)
        elif form == "float32":
            weights = (weights / 100.0).astype(np.float32)
    view, surface = random_view(rng), random_surface(rng)
    aperture = None if rng.random() < 0.5 else rng.uniform(2, 10)
    frames = None if rng.random() < 0.5 else list(rng.permutation(count)[: max(1, count - 1)])
    gains = None if rng.random() < 0.5 else rng.uniform(0.5, 1.5, (count, 3))
    integrator = Integrator(camera, images, poses, weights, device=device, gains=gains)
    image, footprint = integrator.integrate(view, surface, aperture, frames)
    twin, cover = reference.integrate(
        camera, images, poses, view, surface, weights, aperture, frames, gains
    )
    assert image.dtype == footprint.dtype == np.float32
    assert image.shape == twin.shape
    assert np.isfinite(image).all()
    assert (image[footprint == 0] == 0).all()
    # the border of a photo or of an aperture may fall on either side of a pixel
    same = np.abs(footprint - cover) < 2e-2 * (1.0 if weights is None else 3.0)
    assert same.mean() > 0.97
    certain = same & (cover > 0.05)
    error = np.abs(image - twin)[certain].ravel() / white
    if error.size:
        assert 10 * np.log10(1.0 / max(np.mean(error**2), 1e-20)) > 60.0


def looking_down(north: float, east: float, height: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = [north, east, -height]
    return pose


def test_a_lone_frame_integrates_to_itself(device: str) -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (1, 30, 40, 3), dtype=np.uint8)
    camera = Camera.from_fov(40, 30, 70)
    pose = looking_down(3, -2, 20)
    integrator = Integrator(camera, images, [pose], device=device)
    image, footprint = integrator.integrate(VirtualCamera(camera, pose), FocalPlane(0.0))
    np.testing.assert_allclose(image, images[0], atol=0.05)
    np.testing.assert_allclose(footprint, 1.0, atol=1e-5)


def test_identical_frames_integrate_to_the_frame(device: str) -> None:
    rng = np.random.default_rng(0)
    frame = rng.random((30, 40)).astype(np.float32)
    camera = Camera.from_fov(40, 30, 70)
    pose = looking_down(3, -2, 20)
    weights = rng.random((5, 30, 40)).astype(np.float32) + 0.5
    integrator = Integrator(camera, np.stack([frame] * 5), [pose] * 5, weights, device=device)
    image, footprint = integrator.integrate(VirtualCamera(camera, pose), FocalPlane(0.0))
    np.testing.assert_allclose(image[..., 0], frame, atol=2e-4)
    np.testing.assert_allclose(footprint, weights.sum(axis=0), rtol=1e-3)


@given(seed=seeds)
def test_order_of_frames_does_not_matter(device: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, 20, 16, True)
    images = rng.integers(0, 256, (4, 16, 20, 3), dtype=np.uint8)
    poses = np.stack([random_pose(rng) for _ in range(4)])
    view = VirtualCamera(camera, poses[0])
    turn = rng.permutation(4)
    a, fa = Integrator(camera, images, poses, device=device).integrate(view, FocalPlane())
    b, fb = Integrator(camera, images[turn], poses[turn], device=device).integrate(
        view, FocalPlane()
    )
    np.testing.assert_allclose(a, b, atol=1e-3)
    np.testing.assert_allclose(fa, fb, atol=1e-5)


def test_all_masked_gives_no_sample_and_no_nan(device: str) -> None:
    images = np.full((3, 10, 12, 3), 200, np.uint8)
    camera = Camera.from_fov(12, 10, 80)
    poses = [looking_down(n, 0, 20) for n in range(3)]
    zero = np.zeros((3, 10, 12), np.uint8)
    integrator = Integrator(camera, images, poses, zero, device=device)
    image, footprint = integrator.integrate(VirtualCamera(camera, poses[1]), FocalPlane())
    assert (image == 0).all()
    assert (footprint == 0).all()


def test_points_behind_a_camera_are_not_seen(device: str) -> None:
    images = np.full((2, 10, 12, 3), 200, np.uint8)
    camera = Camera.from_fov(12, 10, 80)
    below = looking_down(0, 0, -30)  # 30 m under the ground, looking further down
    poses = [looking_down(0, 0, 20), below]
    _, footprint = Integrator(camera, images, poses, device=device).integrate(
        VirtualCamera(camera, poses[0]), FocalPlane()
    )
    np.testing.assert_allclose(footprint, 1.0, atol=1e-5)


def test_far_distortion_does_not_fold_back(device: str) -> None:
    """A polynomial that turns over maps far-away ground into the photo; it must not count."""
    camera = Camera(40, 40, 20, 20, 19.5, 19.5, (-0.3, 0.0, 0.0, 0.0, 0.0))
    assert camera.max_radius == pytest.approx(np.sqrt(1 / 0.9))
    images = np.full((1, 40, 40), 100, np.uint8)
    integrator = Integrator(camera, images, [looking_down(0, 0, 10)], device=device)
    view = VirtualCamera.ortho(40, -40, 1.0, 81, 81)
    _, footprint = integrator.integrate(view, FocalPlane())
    north, east = np.mgrid[40:-41:-1, -40:41]
    beyond = np.hypot(north, east) > 10 * camera.max_radius + 0.1
    assert (footprint[beyond] == 0).all()
    assert (footprint[~beyond] > 0).any()


def test_weights_bool_and_uint8_have_unit_scale(device: str) -> None:
    images = np.full((2, 10, 12), 50, np.uint8)
    camera = Camera.from_fov(12, 10, 80)
    poses = [looking_down(0, 0, 20)] * 2
    keep = np.ones((2, 10, 12), bool)
    for weights in (keep, keep * np.uint8(255), keep * np.uint8(1), keep.astype(np.float32)):
        integrator = Integrator(camera, images, poses, weights, device=device)
        _, footprint = integrator.integrate(VirtualCamera(camera, poses[0]), FocalPlane())
        np.testing.assert_allclose(footprint, 2.0, rtol=1e-4)


def test_one_mask_serves_all_photos(device: str) -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3, 10, 12, 3), dtype=np.uint8)
    mask = rng.integers(0, 256, (10, 12), dtype=np.uint8)
    camera = Camera.from_fov(12, 10, 80)
    poses = [looking_down(n, 0, 20) for n in range(3)]
    view = VirtualCamera(camera, poses[1])
    one = Integrator(camera, images, poses, mask, device=device).integrate(view, FocalPlane())
    many = Integrator(camera, images, poses, np.stack([mask] * 3), device=device)
    for a, b in zip(one, many.integrate(view, FocalPlane()), strict=True):
        np.testing.assert_array_equal(a, b)


def test_far_origin_loses_no_precision(device: str) -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (1, 64, 64, 3), dtype=np.uint8)
    camera = Camera.from_fov(64, 64, 70)
    pose = looking_down(250_000.0, -400_000.0, 1020.0)
    integrator = Integrator(camera, images, [pose], device=device)
    image, _ = integrator.integrate(VirtualCamera(camera, pose), FocalPlane(-1000.0))
    np.testing.assert_allclose(image, images[0], atol=0.1)


def test_out_is_written_in_place(device: str) -> None:
    images = np.full((1, 10, 12, 3), 9, np.uint8)
    camera = Camera.from_fov(12, 10, 80)
    integrator = Integrator(camera, images, [looking_down(0, 0, 20)], device=device)
    view = VirtualCamera(camera, looking_down(0, 0, 20))
    if device == "cpu":
        out = (np.empty((10, 12, 3), np.float32), np.empty((10, 12), np.float32))
        assert integrator.integrate(view, FocalPlane(), out=out) is out
        np.testing.assert_allclose(out[0], 9.0)
        with pytest.raises(ValueError, match=r"out\[1\] must have shape"):
            integrator.integrate(view, FocalPlane(), out=(out[0], out[0]))


def test_device_arrays_and_dlpack_are_taken_without_a_copy(device: str) -> None:
    import warp as wp

    host = np.random.default_rng(0).integers(0, 256, (2, 10, 12, 3), dtype=np.uint8)
    camera = Camera.from_fov(12, 10, 80)
    poses = [looking_down(n, 0, 20) for n in range(2)]
    view = VirtualCamera(camera, poses[0])
    expected, _ = Integrator(camera, host, poses, device=device).integrate(view, FocalPlane())
    array = wp.array(host, dtype=wp.uint8, device=device)
    integrator = Integrator(camera, array, poses)
    assert integrator._stack.array.ptr == array.ptr
    image, _ = integrator.integrate(view, FocalPlane())
    assert isinstance(image, wp.array)
    np.testing.assert_array_equal(image.numpy(), expected)

    class Capsule:  # what any DLPack library hands over
        def __dlpack__(self, **kwargs: object) -> object:
            return array.__dlpack__(**kwargs)

        def __dlpack_device__(self) -> object:
            return array.__dlpack_device__()

    image, _ = Integrator(camera, Capsule(), poses, device=device).integrate(view, FocalPlane())
    np.testing.assert_array_equal(np.asarray(image), expected)


@given(seed=seeds)
def test_sweep_is_a_stack_of_integrals(device: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, 20, 16, False)
    images = rng.integers(0, 256, (3, 16, 20, 3), dtype=np.uint8)
    poses = np.stack([random_pose(rng) for _ in range(3)])
    integrator = Integrator(camera, images, poses, device=device)
    view, downs = random_view(rng), rng.uniform(-3, 3, 4)
    stack, cover = integrator.sweep(view, downs)
    for i, down in enumerate(downs):
        image, footprint = integrator.integrate(view, FocalPlane(down))
        np.testing.assert_array_equal(stack[i], image)
        np.testing.assert_array_equal(cover[i], footprint)


def test_holes_of_the_terrain_are_not_sampled(device: str) -> None:
    down = np.zeros((21, 21), np.float32)
    down[8:13, 8:13] = np.nan
    axis = np.arange(-10.0, 11.0)
    terrain = FocalTerrain.from_arrays(axis, axis, down)
    camera = Camera.from_fov(41, 41, 50)
    images = np.full((1, 41, 41), 100, np.uint8)
    pose = looking_down(0, 0, 20)
    integrator = Integrator(camera, images, [pose], device=device)
    _, footprint = integrator.integrate(VirtualCamera(camera, pose), terrain)
    assert footprint[20, 20] == 0
    assert footprint[5, 5] > 0
    _, grid = integrator.integrate(VirtualCamera.ortho(5, -5, 1.0, 11, 11), terrain)
    assert grid[5, 5] == 0
    assert grid[0, 0] > 0


def test_bad_input() -> None:
    images = np.zeros((2, 10, 12, 3), np.uint8)
    camera = Camera.from_fov(12, 10, 80)
    poses = np.stack([np.eye(4)] * 2)
    with pytest.raises(ValueError, match="camera's size 12 x 10"):
        Integrator(camera, images[:, :5], poses)
    with pytest.raises(ValueError, match=r"\(2, 4, 4\)"):
        Integrator(camera, images, poses[:1])
    nan = poses.copy()
    nan[1, 0, 3] = np.nan
    with pytest.raises(ValueError, match=r"world_from_camera\[1\] must be finite"):
        Integrator(camera, images, nan)
    with pytest.raises(ValueError, match="rotation"):
        Integrator(camera, images, poses * 2)
    with pytest.raises(ValueError, match="weights must have shape"):
        Integrator(camera, images, poses, images[..., 0][:1])
    integrator = Integrator(camera, images, poses)
    view = VirtualCamera(camera, np.eye(4))
    with pytest.raises(ValueError, match="aperture_m"):
        integrator.integrate(view, FocalPlane(), aperture_m=-1.0)
    with pytest.raises(ValueError, match=r"frames must lie in 0\.\.1"):
        integrator.integrate(view, FocalPlane(), frames=[2])
    with pytest.raises(TypeError, match="surface"):
        integrator.integrate(view, 3.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="downs_m"):
        integrator.sweep(view, [])


def test_points_of_a_terrain_follow_view_and_surface() -> None:
    """They are kept while nothing changes, on the CPU; whatever changes is seen."""
    rng = np.random.default_rng(5)
    images = rng.integers(0, 255, (3, 24, 32, 3)).astype(np.uint8)
    poses = np.stack([random_pose(rng, reach=3.0) for _ in range(3)])
    camera = Camera.from_fov(32, 24, 70.0)
    integrator = Integrator(camera, images, poses)
    axis = np.arange(-40.0, 41.0, 2.0)
    hills = [
        FocalTerrain.from_arrays(axis, axis, np.sin(axis / k)[:, None] * np.cos(axis / 5.0))
        for k in (3.0, 6.0)
    ]
    views = [VirtualCamera(Camera.from_fov(20, 16, 60.0), poses[k]) for k in (0, 1)]
    grids = [VirtualCamera.ortho(4.0, -5.0, gsd, 20, 16) for gsd in (0.5, 0.6)]
    asked = [(view, hill) for view in (*views, *grids) for hill in (*hills, FocalPlane())]
    alone = [integrator.integrate(*one)[0].copy() for one in asked]
    for i, j in itertools.product(range(len(asked)), repeat=2):
        integrator.integrate(*asked[i])
        np.testing.assert_array_equal(integrator.integrate(*asked[j])[0], alone[j])
        np.testing.assert_array_equal(integrator.integrate(*asked[j])[0], alone[j])


def test_released_photos_are_packed_anew() -> None:
    rng = np.random.default_rng(3)
    camera = random_camera(rng, 36, 28, False)
    images = rng.integers(0, 256, (4, 28, 36, 3), dtype=np.uint8)
    poses = np.stack([random_pose(rng) for _ in range(4)])
    view, plane = VirtualCamera(camera.without_distortion(), poses[0]), FocalPlane(0.0)
    integrator = Integrator(camera, images, poses, device="cpu")
    image, footprint = integrator.integrate(view, plane)
    seen = footprint > 0.0
    assert seen.any()
    images[:] = 255 - images
    integrator.release()
    anew, same = integrator.integrate(view, plane)
    assert np.array_equal(same, footprint)
    np.testing.assert_allclose(anew[seen], 255.0 - image[seen], atol=0.1)
