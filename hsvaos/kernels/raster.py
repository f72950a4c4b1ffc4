"""Z-buffer rasteriser for patches: triangles and parallelograms, opaque or cut out by a texture.

A patch is the set {c + u a + v b}: u, v >= 0 and u + v <= 1 for a triangle, u, v <= 1 for a
parallelogram. With c, a, b in the camera frame and d = (x, y, 1) the ray through a pixel, the hit
solves  d = s c + (su) a + (sv) b,  z = 1 / s,  so that

    (s, su, sv) = [c a b]^-1 d

is linear in d (homogeneous rasterisation, Olano and Greer 1997). Since d comes from a table of the
pixels' rays, a lens with distortion is rendered exactly: no edge is taken to be straight.

The buffer holds one 64-bit key a pixel: bits of the depth above, `instance << 19 | patch` below.
The smallest key wins, so the picture does not depend on the order of drawing, and the key says
exactly which patch of which instance each pixel shows. `hsvaos.reference_raster` is the slow twin.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import Camera

wp.set_module_options({"enable_backward": False})

PATCH_BITS = 19
MAX_PATCHES = 1 << PATCH_BITS
"""Most patches of one mesh."""
MAX_INSTANCES = 1 << (32 - PATCH_BITS)
"""Most instances of one scene."""
EMPTY = np.uint64(0xFFFFFFFFFFFFFFFF)
"""Key of a pixel that shows nothing."""
TILE_SIZE = 128
"""Side of a texture tile at its finest level [px]."""
TILE_LEVELS = 5
"""Levels of a texture tile: 128, 64, 32, 16, 8 px."""
TILE_BYTES = sum((TILE_SIZE >> level) ** 2 for level in range(TILE_LEVELS))
"""Texels of a tile over all levels."""
OPAQUE = 255
"""Tile number of a patch without a texture."""
NEAR_M = 0.2
"""Patches that come nearer to the camera than this are not drawn [m]."""


@wp.struct
class Lens:
    """Intrinsics of a camera, as `hsvaos.Camera`."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    max_r2: float


@wp.struct
class Patches:
    """All patches of all meshes, one behind the other.

    info packs tile (bits 0-7), material (bits 8-15), triangle (bit 16); colour packs red, green,
    blue in bits 0-23, each the square root of the linear value.
    """

    corner: wp.array(dtype=wp.vec3)
    side_a: wp.array(dtype=wp.vec3)
    side_b: wp.array(dtype=wp.vec3)
    info: wp.array(dtype=wp.int32)
    colour: wp.array(dtype=wp.uint32)


@wp.func
def distort(lens: Lens, x: float, y: float) -> wp.vec2:
    """Apply Brown-Conrady distortion to normalised coordinates and return pixels."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    xd = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (r2 + 2.0 * x * x)
    yd = y * radial + lens.p1 * (r2 + 2.0 * y * y) + 2.0 * lens.p2 * x * y
    return wp.vec2(lens.fx * xd + lens.cx, lens.fy * yd + lens.cy)


@wp.func
def tile_level(pixels: float) -> int:
    """Return the texture level whose texels are about as large as the pixels of the picture."""
    level = int(0)
    size = float(TILE_SIZE)
    while level < TILE_LEVELS - 1 and size > 1.5 * pixels:
        size = 0.5 * size
        level += 1
    return level


@wp.func
def texel_index(tile: int, level: int, u: float, v: float) -> int:
    """Return the place of a texel in the atlas."""
    start = tile * TILE_BYTES
    size = int(TILE_SIZE)
    for _ in range(level):
        start += size * size
        size = size >> 1
    x = wp.clamp(int(u * float(size)), 0, size - 1)
    y = wp.clamp(int(v * float(size)), 0, size - 1)
    return start + y * size + x


@wp.func
def is_inside(su: float, sv: float, s: float, triangle: int) -> bool:
    """Whether the hit lies on the patch; a hair is added so that neighbours leave no crack."""
    hair = 1.0e-5 * s
    if su < -hair or sv < -hair:
        return False
    if triangle != 0:
        return su + sv <= s + hair
    return su <= s + hair and sv <= s + hair


@wp.func
def depth_key(z: float, identity: wp.uint32) -> wp.uint64:
    """Return the key of a hit; positive floats sort like their bits."""
    return (wp.uint64(wp.cast(z, wp.uint32)) << wp.uint64(32)) | wp.uint64(identity)


@wp.func
def card_level(lens: Lens, a: wp.vec3, b: wp.vec3, z: float) -> int:
    """Return the texture level of a card from its longer side, seen square on."""
    side = wp.max(wp.length(a), wp.length(b))
    return tile_level(side * lens.fx / z)


@wp.kernel
def _draw(
    patches: Patches,
    first_patch: int,
    camera_from_mesh: wp.array(dtype=wp.mat33),
    mesh_origin: wp.array(dtype=wp.vec3),
    instance: wp.array(dtype=wp.int32),
    lens: Lens,
    rays: wp.array(dtype=wp.vec2),
    alpha: wp.array(dtype=wp.uint8),
    first_row: int,
    end_row: int,
    keys: wp.array(dtype=wp.uint64),
) -> None:
    i, p = wp.tid()
    rotation = camera_from_mesh[i]
    k = first_patch + p
    c = rotation * patches.corner[k] + mesh_origin[i]
    a = rotation * patches.side_a[k]
    b = rotation * patches.side_b[k]
    info = patches.info[k]
    triangle = (info >> 16) & 1
    nearest = wp.min(c[2], wp.min(c[2] + a[2], c[2] + b[2]))
    if triangle == 0:
        nearest = wp.min(nearest, c[2] + a[2] + b[2])
    if nearest < NEAR_M:
        return
    low = wp.vec2(1.0e9, 1.0e9)
    high = wp.vec2(-1.0e9, -1.0e9)
    for corner in range(4 - triangle):
        point = c
        if corner == 1 or corner == 3:
            point = point + a
        if corner >= 2:
            point = point + b
        x = point[0] / point[2]
        y = point[1] / point[2]
        if x * x + y * y > lens.max_r2:
            return
        pixel = distort(lens, x, y)
        low = wp.min(low, pixel)
        high = wp.max(high, pixel)
    # A lens bends edges outwards by less than half a pixel for patches of everyday size.
    x0 = wp.max(int(wp.ceil(low[0] - 0.5)), 0)
    x1 = wp.min(int(wp.floor(high[0] + 0.5)), lens.width - 1)
    y0 = wp.max(int(wp.ceil(low[1] - 0.5)), first_row)
    y1 = wp.min(int(wp.floor(high[1] + 0.5)), end_row - 1)
    if x0 > x1 or y0 > y1:
        return
    normal = wp.cross(a, b)
    volume = wp.dot(c, normal)
    if wp.abs(volume) < 1.0e-12:
        return
    w = normal / volume
    wu = wp.cross(b, c) / volume
    wv = wp.cross(c, a) / volume
    tile = info & 255
    level = int(0)
    if tile != OPAQUE:
        level = card_level(lens, a, b, c[2])
    identity = (wp.uint32(instance[i]) << wp.uint32(PATCH_BITS)) | wp.uint32(p)
    for row in range(y0, y1 + 1):
        for column in range(x0, x1 + 1):
            at = row * lens.width + column
            ray = rays[at]
            s = w[0] * ray[0] + w[1] * ray[1] + w[2]
            su = wu[0] * ray[0] + wu[1] * ray[1] + wu[2]
            sv = wv[0] * ray[0] + wv[1] * ray[1] + wv[2]
            if s > 0.0 and is_inside(su, sv, s, triangle):
                z = 1.0 / s
                key = depth_key(z, identity)
                if key < keys[at]:
                    # Not `or`: a kernel evaluates both sides, and tile 255 has no texels.
                    solid = tile == OPAQUE
                    if not solid:
                        solid = alpha[texel_index(tile, level, su * z, sv * z)] != wp.uint8(0)
                    if solid:
                        wp.atomic_min(keys, at, key)


def lens_of(camera: Camera) -> Any:
    """Return the kernel's form of a camera."""
    lens = Lens()
    lens.width, lens.height = camera.width, camera.height
    lens.fx, lens.fy, lens.cx, lens.cy = camera.fx, camera.fy, camera.cx, camera.cy
    lens.k1, lens.k2, lens.p1, lens.p2, lens.k3 = camera.distortion
    lens.max_r2 = float(min(camera.max_radius, 1e4) ** 2)
    return lens


def draw(
    patches: Any,
    first_patch: int,
    patch_count: int,
    camera_from_mesh: NDArray[np.float64],
    instance: NDArray[np.int32],
    lens: Any,
    rays: Any,
    alpha: Any,
    keys: Any,
    rows: tuple[int, int] | None = None,
) -> None:
    """Draw some instances of one mesh into the key buffer.

    Args:
        patches: `Patches` struct with all meshes.
        first_patch: Number of the mesh's first patch.
        patch_count: Patches of the mesh, at most MAX_PATCHES.
        camera_from_mesh: Shape (I, 3, 4), affine, mesh to camera frame [m].
        instance: Shape (I,), numbers of the instances, below MAX_INSTANCES.
        lens: From `lens_of`.
        rays: wp.array of vec2, shape (H W,): x/z and y/z of the ray through each pixel.
        alpha: wp.array of uint8, texture atlas, TILE_BYTES a tile; 0 is a hole.
        keys: wp.array of uint64, shape (H W,), changed in place.
        rows: Draw only rows first <= row < end: bands can be drawn by threads side by side.

    Raises:
        ValueError: If there are more patches or instances than a key can tell apart.
    """
    if patch_count > MAX_PATCHES:
        raise ValueError(f"a mesh may have {MAX_PATCHES} patches at most, got {patch_count}")
    if len(instance) == 0 or patch_count == 0:
        return
    if int(instance.max()) >= MAX_INSTANCES:
        raise ValueError(f"a scene may have {MAX_INSTANCES} instances at most")
    device = keys.device
    first_row, end_row = rows if rows is not None else (0, lens.height)
    wp.launch(
        _draw,
        dim=(len(instance), patch_count),
        inputs=[
            patches,
            int(first_patch),
            wp.array(camera_from_mesh[:, :, :3].astype(np.float32), dtype=wp.mat33, device=device),
            wp.array(camera_from_mesh[:, :, 3].astype(np.float32), dtype=wp.vec3, device=device),
            wp.array(instance.astype(np.int32), dtype=wp.int32, device=device),
            lens,
            rays,
            alpha,
            int(first_row),
            int(end_row),
            keys,
        ],
        device=device,
    )
