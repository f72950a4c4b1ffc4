"""Orthographic depth maps of patches: what a light, or a view from above, sees first."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.kernels.raster import OPAQUE, Patches, is_inside, texel_index, tile_level

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _draw_depth(
    patches: Patches,
    first_patch: int,
    map_from_mesh: wp.array(dtype=wp.mat33),
    mesh_origin: wp.array(dtype=wp.vec3),
    alpha: wp.array(dtype=wp.uint8),
    columns: int,
    rows: int,
    depth: wp.array(dtype=float),
) -> None:
    # The map frame: x and y in pixels of the map, z along the parallel rays in metres.
    i, p = wp.tid()
    rotation = map_from_mesh[i]
    k = first_patch + p
    c = rotation * patches.corner[k] + mesh_origin[i]
    a = rotation * patches.side_a[k]
    b = rotation * patches.side_b[k]
    info = patches.info[k]
    triangle = (info >> 16) & 1
    low_x = c[0] + wp.min(a[0], 0.0) + wp.min(b[0], 0.0)
    high_x = c[0] + wp.max(a[0], 0.0) + wp.max(b[0], 0.0)
    low_y = c[1] + wp.min(a[1], 0.0) + wp.min(b[1], 0.0)
    high_y = c[1] + wp.max(a[1], 0.0) + wp.max(b[1], 0.0)
    x0 = wp.max(int(wp.ceil(low_x)), 0)
    x1 = wp.min(int(wp.floor(high_x)), columns - 1)
    y0 = wp.max(int(wp.ceil(low_y)), 0)
    y1 = wp.min(int(wp.floor(high_y)), rows - 1)
    area = a[0] * b[1] - a[1] * b[0]
    if x0 > x1 or y0 > y1 or wp.abs(area) < 1.0e-9:
        return
    tile = info & 255
    level = int(0)
    if tile != OPAQUE:
        level = tile_level(wp.sqrt(wp.abs(area)))
    for row in range(y0, y1 + 1):
        for column in range(x0, x1 + 1):
            dx = float(column) - c[0]
            dy = float(row) - c[1]
            u = (dx * b[1] - dy * b[0]) / area
            v = (a[0] * dy - a[1] * dx) / area
            if is_inside(u, v, 1.0, triangle):
                z = c[2] + u * a[2] + v * b[2]
                at = row * columns + column
                if z < depth[at]:
                    # Not `or`: a kernel evaluates both sides, and tile 255 has no texels.
                    solid = tile == OPAQUE
                    if not solid:
                        solid = alpha[texel_index(tile, level, u, v)] != wp.uint8(0)
                    if solid:
                        wp.atomic_min(depth, at, z)


def draw_depth(
    patches: Any,
    first_patch: int,
    patch_count: int,
    map_from_mesh: NDArray[np.float64],
    alpha: Any,
    columns: int,
    rows: int,
    depth: Any,
) -> None:
    """Draw some instances of one mesh into an orthographic depth map (sun, sky, plan view).

    Args:
        patches: `Patches` struct with all meshes.
        first_patch: Number of the mesh's first patch.
        patch_count: Patches of the mesh.
        map_from_mesh: Shape (I, 3, 4), affine; x and y in map pixels, z along the rays [m].
        alpha: wp.array of uint8, texture atlas.
        columns: Width of the map [px].
        rows: Height of the map [px].
        depth: wp.array of float32, shape (rows columns,), changed in place.
    """
    if len(map_from_mesh) == 0 or patch_count == 0:
        return
    device = depth.device
    wp.launch(
        _draw_depth,
        dim=(len(map_from_mesh), patch_count),
        inputs=[
            patches,
            int(first_patch),
            wp.array(map_from_mesh[:, :, :3].astype(np.float32), dtype=wp.mat33, device=device),
            wp.array(map_from_mesh[:, :, 3].astype(np.float32), dtype=wp.vec3, device=device),
            alpha,
            int(columns),
            int(rows),
            depth,
        ],
        device=device,
    )
