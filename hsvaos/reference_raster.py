"""Slow, obvious NumPy twin of `hsvaos.kernels.raster`: one patch at a time, whole pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.kernels.raster import EMPTY, NEAR_M, OPAQUE, PATCH_BITS, TILE_BYTES, TILE_SIZE
from hsvaos.simulate.mesh import Mesh

Array = NDArray[np.float64]


def tile_level(pixels: float) -> int:
    """Return the texture level for a card of this many pixels (finest 0, coarsest 4)."""
    level, size = 0, float(TILE_SIZE)
    while level < 4 and size > 1.5 * pixels:
        size /= 2.0
        level += 1
    return level


def texel_index(tile: int, level: int, u: Array, v: Array) -> NDArray[np.int64]:
    """Return the place of texels in the atlas, shape of u."""
    start = tile * TILE_BYTES + sum((TILE_SIZE >> k) ** 2 for k in range(level))
    size = TILE_SIZE >> level
    x = np.clip((u * size).astype(np.int64), 0, size - 1)
    y = np.clip((v * size).astype(np.int64), 0, size - 1)
    return np.asarray(start + y * size + x, dtype=np.int64)


def draw(
    mesh: Mesh,
    camera: Camera,
    camera_from_mesh: Array,
    alpha: NDArray[np.uint8],
) -> tuple[Array, NDArray[np.int64]]:
    """Draw instances of a mesh by solving d = s c + (su) a + (sv) b for every pixel.

    Args:
        mesh: Its patches.
        camera: The lens.
        camera_from_mesh: Shape (I, 3, 4).
        alpha: Shape (tiles TILE_BYTES,), 0 is a hole.

    Returns:
        Depth (H, W) [m], inf where nothing is, and identity (H, W), `instance << 19 | patch`,
        -1 where nothing is.
    """
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.back_project(np.stack([columns, rows], axis=-1))
    depth = np.full(rays.shape[:2], np.inf)
    identity = np.full(rays.shape[:2], -1, dtype=np.int64)
    for i, place in enumerate(camera_from_mesh):
        for p in range(len(mesh)):
            c = place[:, :3] @ mesh.corner[p] + place[:, 3]
            a, b = place[:, :3] @ mesh.side_a[p], place[:, :3] @ mesh.side_b[p]
            triangle = bool(mesh.info[p] >> 16 & 1)
            corners = np.array([c, c + a, c + b] + ([] if triangle else [c + a + b]))
            # A patch is drawn whole or, if it comes too near or too far to the side, not at all.
            if corners[:, 2].min() < NEAR_M or not np.isfinite(camera.project(corners)).all():
                continue
            matrix = np.stack([c, a, b], axis=1)
            if abs(np.linalg.det(matrix)) < 1e-12:
                continue
            s, su, sv = np.moveaxis(rays @ np.linalg.inv(matrix).T, -1, 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                z, u, v = 1.0 / s, su / s, sv / s
            hair = 1e-5
            hit = (s > 0.0) & (u >= -hair) & (v >= -hair)
            hit &= (u + v <= 1.0 + hair) if triangle else (u <= 1.0 + hair) & (v <= 1.0 + hair)
            tile = int(mesh.info[p] & 255)
            if tile != OPAQUE:
                side = max(np.linalg.norm(a), np.linalg.norm(b))
                level = tile_level(float(side * camera.fx / c[2]))
                hit[hit] &= alpha[texel_index(tile, level, u[hit], v[hit])] != 0
            nearer = hit & (z < depth)
            depth[nearer] = z[nearer]
            identity[nearer] = i << PATCH_BITS | p
    return depth, identity


def unpack(keys: NDArray[np.uint64]) -> tuple[Array, NDArray[np.int64]]:
    """Return depth and identity of the kernel's keys, in the form `draw` returns."""
    empty = keys == EMPTY
    depth = (keys >> np.uint64(32)).astype(np.uint32).view(np.float32).astype(np.float64)
    identity = (keys & np.uint64(0xFFFFFFFF)).astype(np.int64)
    return np.where(empty, np.inf, depth), np.where(empty, -1, identity)
