"""The rasteriser against its slow NumPy twin."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos import reference_raster
from hsvaos.camera import Camera
from hsvaos.kernels import raster
from hsvaos.simulate.buffers import ray_table
from hsvaos.simulate.mesh import Material, Mesh
from hsvaos.simulate.textures import Tile, draw_atlas

ATLAS = draw_atlas(3)
CAMERA = Camera(40, 30, 32.0, 34.0, 19.0, 15.5, (-0.08, 0.02, 0.003, -0.002, 0.001))


def random_mesh(rng: np.random.Generator, count: int) -> Mesh:
    parts = []
    for triangle in (False, True):
        n = count // 2
        corner = rng.uniform((-3, -3, 1.5), (3, 3, 9.0), (n, 3))
        sides = rng.normal(0.0, 1.2, (2, n, 3))
        tile = rng.choice([raster.OPAQUE, int(Tile.OVATE), int(Tile.NEEDLES)], n)
        parts.append(
            Mesh.build(corner, *sides, Material.LEAF, (0.1, 0.2, 0.1), tile, triangle=triangle)
        )
    return Mesh.join(parts)


def patches_of(mesh: Mesh) -> object:
    patches = raster.Patches()
    patches.corner = wp.array(mesh.corner, dtype=wp.vec3, device="cpu")
    patches.side_a = wp.array(mesh.side_a, dtype=wp.vec3, device="cpu")
    patches.side_b = wp.array(mesh.side_b, dtype=wp.vec3, device="cpu")
    patches.info = wp.array(mesh.info, dtype=wp.int32, device="cpu")
    patches.colour = wp.array(mesh.colour, dtype=wp.uint32, device="cpu")
    return patches


def drawn(mesh: Mesh, places: np.ndarray, bands: list[tuple[int, int]] | None = None) -> np.ndarray:
    keys = wp.full(CAMERA.width * CAMERA.height, int(raster.EMPTY), dtype=wp.uint64, device="cpu")
    alpha = wp.array(np.ascontiguousarray(ATLAS[:, 0]), dtype=wp.uint8, device="cpu")
    for band in bands or [(0, CAMERA.height)]:
        raster.draw(
            patches_of(mesh),
            0,
            len(mesh),
            places,
            np.arange(len(places), dtype=np.int32),
            raster.lens_of(CAMERA),
            ray_table(CAMERA),
            alpha,
            keys,
            band,
        )
    return keys.numpy().reshape(CAMERA.height, CAMERA.width)


def random_places(rng: np.random.Generator, count: int) -> np.ndarray:
    places = np.empty((count, 3, 4))
    places[:, :, :3] = np.eye(3) + rng.normal(0.0, 0.1, (count, 3, 3))
    places[:, :, 3] = rng.normal(0.0, 0.4, (count, 3))
    return places


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_kernel_is_its_numpy_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh, places = random_mesh(rng, 30), random_places(rng, 2)
    depth, identity = reference_raster.unpack(drawn(mesh, places))
    want_depth, want_identity = reference_raster.draw(mesh, CAMERA, places, ATLAS[:, 0])
    same = identity == want_identity
    # Pixels whose centre lies within rounding of an edge or a texel may go either way.
    assert same.mean() > 0.985
    both = same & (identity >= 0)
    np.testing.assert_allclose(depth[both], want_depth[both], rtol=2e-4)


def test_the_picture_covers_something_and_holes_are_holes() -> None:
    rng = np.random.default_rng(1)
    mesh, places = random_mesh(rng, 60), random_places(rng, 3)
    identity = reference_raster.unpack(drawn(mesh, places))[1]
    assert (identity >= 0).mean() > 0.2
    opaque = Mesh(mesh.corner, mesh.side_a, mesh.side_b, mesh.info | 255, mesh.colour)
    solid = reference_raster.unpack(drawn(opaque, places))[1]
    assert (solid >= 0).sum() > (identity >= 0).sum()


def test_order_and_bands_do_not_matter() -> None:
    rng = np.random.default_rng(2)
    mesh, places = random_mesh(rng, 60), random_places(rng, 3)
    whole = drawn(mesh, places)
    np.testing.assert_array_equal(whole, drawn(mesh, places, [(17, 30), (0, 9), (9, 17)]))


def test_neighbouring_triangles_leave_no_crack() -> None:
    axis = np.linspace(-3.0, 3.0, 14)
    y, x = np.meshgrid(axis, axis, indexing="ij")
    z = 4.0 + 0.3 * np.sin(3 * x) * np.cos(2 * y)
    nodes = np.stack([x, y, z], axis=-1)
    p00, p01, p10, p11 = nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]
    flat = (-1, 3)
    mesh = Mesh.build(
        np.concatenate([p00.reshape(flat), p11.reshape(flat)]),
        np.concatenate([(p01 - p00).reshape(flat), (p10 - p11).reshape(flat)]),
        np.concatenate([(p10 - p00).reshape(flat), (p01 - p11).reshape(flat)]),
        Material.GROUND,
        (0.1, 0.1, 0.1),
        triangle=True,
    )
    keys = drawn(mesh, np.eye(4)[None, :3])
    assert (keys != raster.EMPTY).all()


@pytest.mark.parametrize("count", [raster.MAX_INSTANCES, raster.MAX_INSTANCES + 5])
def test_too_many_instances_are_refused(count: int) -> None:
    mesh = random_mesh(np.random.default_rng(0), 4)
    keys = wp.zeros(CAMERA.width * CAMERA.height, dtype=wp.uint64, device="cpu")
    with pytest.raises(ValueError, match="instances at most"):
        raster.draw(
            patches_of(mesh),
            0,
            len(mesh),
            np.zeros((1, 3, 4)),
            np.array([count], dtype=np.int32),
            raster.lens_of(CAMERA),
            ray_table(CAMERA),
            wp.zeros(1, dtype=wp.uint8, device="cpu"),
            keys,
        )


def test_too_many_patches_are_refused() -> None:
    mesh = random_mesh(np.random.default_rng(0), 4)
    keys = wp.zeros(CAMERA.width * CAMERA.height, dtype=wp.uint64, device="cpu")
    with pytest.raises(ValueError, match="patches at most"):
        raster.draw(
            patches_of(mesh),
            0,
            raster.MAX_PATCHES + 1,
            np.zeros((1, 3, 4)),
            np.zeros(1, dtype=np.int32),
            raster.lens_of(CAMERA),
            ray_table(CAMERA),
            wp.zeros(1, dtype=wp.uint8, device="cpu"),
            keys,
        )
