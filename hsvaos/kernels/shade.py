"""Shading of a key buffer: sun with shadows, sky with soft occlusion, bounced light, temperature.

    L = albedo (sun V_sun f(n, l) + sky V_sky + bounce (1 - V_sky))

with V_sun from one depth map along the sun and V_sky the share of a few depth maps over the sky
that see the point (Williams 1978). Leaves let part of the sun through to their shaded side.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from hsvaos.kernels.raster import OPAQUE, PATCH_BITS, Lens, Patches, card_level, texel_index

wp.set_module_options({"enable_backward": False})


@wp.struct
class Light:
    """Sun and sky of a scene; colours are linear RGB, directions point to the light (NED)."""

    sun_direction: wp.vec3
    sun: wp.vec3
    sky: wp.vec3
    bounce: wp.vec3
    sun_size: int
    sky_size: int
    sky_count: int
    sun_bias: float
    sky_bias: float
    snow: float
    """Share of up-facing surfaces of the materials that carry snow that is white (0-1)."""


@wp.struct
class Ground:
    """Colour texture of the ground: a square map, north up, with square-root encoded RGB."""

    north0: float
    east0: float
    texel: float
    size: int


@wp.func
def unpack(colour: wp.uint32) -> wp.vec3:
    """Return the linear colour of packed square roots."""
    mask = wp.uint32(255)
    r = float(colour & mask) / 255.0
    g = float((colour >> wp.uint32(8)) & mask) / 255.0
    b = float((colour >> wp.uint32(16)) & mask) / 255.0
    return wp.vec3(r * r, g * g, b * b)


@wp.func
def seen(
    depth: wp.array(dtype=float), start: int, size: int, x: float, y: float, z: float
) -> float:
    """Return the share of the four map texels around (x, y) that see the depth z, bilinear."""
    column = int(wp.floor(x))
    row = int(wp.floor(y))
    if column < 0 or row < 0 or column >= size - 1 or row >= size - 1:
        return 1.0
    fx = x - float(column)
    fy = y - float(row)
    at = start + row * size + column
    w00 = wp.where(z <= depth[at], 1.0, 0.0)
    w01 = wp.where(z <= depth[at + 1], 1.0, 0.0)
    w10 = wp.where(z <= depth[at + size], 1.0, 0.0)
    w11 = wp.where(z <= depth[at + size + 1], 1.0, 0.0)
    return (w00 * (1.0 - fx) + w01 * fx) * (1.0 - fy) + (w10 * (1.0 - fx) + w11 * fx) * fy


@wp.func
def ground_colour(
    ground: Ground, texture: wp.array(dtype=wp.uint8), north: float, east: float
) -> wp.vec3:
    """Return the linear colour of the ground, bilinear in the square roots."""
    x = wp.clamp((east - ground.east0) / ground.texel, 0.0, float(ground.size) - 1.001)
    y = wp.clamp((ground.north0 - north) / ground.texel, 0.0, float(ground.size) - 1.001)
    column = int(x)
    row = int(y)
    fx = x - float(column)
    fy = y - float(row)
    at = 3 * (row * ground.size + column)
    below = at + 3 * ground.size
    colour = wp.vec3()
    for c in range(3):
        top = float(texture[at + c]) * (1.0 - fx) + float(texture[at + 3 + c]) * fx
        bottom = float(texture[below + c]) * (1.0 - fx) + float(texture[below + 3 + c]) * fx
        value = (top * (1.0 - fy) + bottom * fy) / 255.0
        colour[c] = value * value
    return colour


@wp.kernel
def _shade(
    keys: wp.array(dtype=wp.uint64),
    rays: wp.array(dtype=wp.vec2),
    lens: Lens,
    patches: Patches,
    first_patch: wp.array(dtype=wp.int32),
    camera_from_mesh: wp.array(dtype=wp.mat33),
    mesh_origin: wp.array(dtype=wp.vec3),
    tint: wp.array(dtype=wp.vec3),
    world_from_camera: wp.mat33,
    camera_place: wp.vec3,
    texels: wp.array(dtype=wp.uint8),
    materials: wp.array(dtype=wp.vec4),
    warmth: wp.array(dtype=wp.vec4),
    light: Light,
    sun_from_world: wp.mat33,
    sun_origin: wp.vec3,
    sun_depth: wp.array(dtype=float),
    sky_from_world: wp.array(dtype=wp.mat33),
    sky_origin: wp.array(dtype=wp.vec3),
    sky_depth: wp.array(dtype=float),
    ground: Ground,
    ground_texture: wp.array(dtype=wp.uint8),
    out: wp.array(dtype=wp.vec4),
) -> None:
    at = wp.tid()
    key = keys[at]
    ray = rays[at]
    direction = wp.vec3(ray[0], ray[1], 1.0)
    identity = wp.uint32(key & wp.uint64(0xFFFFFFFF))
    if key >> wp.uint64(32) == wp.uint64(0xFFFFFFFF):
        out[at] = wp.vec4(light.sky[0], light.sky[1], light.sky[2], 0.0)
        return
    i = int(identity >> wp.uint32(PATCH_BITS))
    p = int(identity & wp.uint32((1 << PATCH_BITS) - 1))
    rotation = camera_from_mesh[i]
    k = first_patch[i] + p
    c = rotation * patches.corner[k] + mesh_origin[i]
    a = rotation * patches.side_a[k]
    b = rotation * patches.side_b[k]
    info = patches.info[k]
    normal = wp.cross(a, b)
    s = wp.dot(normal, direction) / wp.dot(c, normal)
    volume = wp.dot(c, normal)
    u = wp.dot(wp.cross(b, c), direction) / volume / s
    v = wp.dot(wp.cross(c, a), direction) / volume / s
    hit = direction / s
    normal = wp.normalize(normal)
    if wp.dot(normal, direction) > 0.0:
        normal = -normal
    place = world_from_camera * hit + camera_place
    normal = world_from_camera * normal

    material = materials[(info >> 8) & 255]
    tile = info & 255
    albedo = unpack(patches.colour[k])
    tint_i = tint[i]
    albedo = wp.cw_mul(albedo, tint_i)
    if tile != OPAQUE:
        texel = 3 * texel_index(tile, card_level(lens, a, b, c[2]), u, v)
        brightness = float(texels[texel + 1]) / 160.0
        wood = float(texels[texel + 2]) / 255.0
        albedo = albedo * (1.0 - wood) + wp.vec3(0.11, 0.085, 0.06) * wood
        albedo = albedo * brightness
    if material[3] > 0.5:
        albedo = ground_colour(ground, ground_texture, place[0], place[1])
    up = -normal[2]
    cover = light.snow * material[1] * wp.clamp((wp.abs(up) - 0.25) * 2.5, 0.0, 1.0)
    albedo = albedo * (1.0 - cover) + wp.vec3(0.80, 0.84, 0.90) * cover
    translucent = material[0] * (1.0 - cover)

    facing = wp.dot(normal, light.sun_direction)
    at_sun = sun_from_world * (place + normal * light.sun_bias) + sun_origin
    lit = seen(sun_depth, 0, light.sun_size, at_sun[0], at_sun[1], at_sun[2] - light.sun_bias)
    sky = float(0.0)
    weight = float(0.0)
    for m in range(light.sky_count):
        at_sky = sky_from_world[m] * (place + normal * light.sky_bias) + sky_origin[m]
        start = m * light.sky_size * light.sky_size
        view = seen(
            sky_depth, start, light.sky_size, at_sky[0], at_sky[1], at_sky[2] - light.sky_bias
        )
        towards = wp.vec3(
            -sky_from_world[m][2, 0], -sky_from_world[m][2, 1], -sky_from_world[m][2, 2]
        )
        lambert = wp.max(wp.dot(normal, towards), 0.0)
        # Leaves take light from both sides; solid surfaces only from their own hemisphere.
        share = lambert + translucent * (1.0 - lambert) * 0.7 + 0.02
        sky += view * share
        weight += wp.where(translucent > 0.0, share, 0.5)
    sky = sky / wp.max(weight, 1.0e-3)

    front = wp.max(facing, 0.0)
    through = translucent * wp.max(-facing, 0.0)
    gain = light.sun * (front * lit) + light.sky * sky + light.bounce * (1.0 - 0.7 * sky)
    radiance = wp.cw_mul(albedo, gain)
    # Light that came through a leaf is more yellow and more saturated than what it reflects.
    passed = wp.vec3(
        albedo[0] * (0.25 + 2.4 * albedo[0]),
        albedo[1] * (0.35 + 2.4 * albedo[1]),
        albedo[2] * (0.10 + 2.4 * albedo[2]),
    )
    radiance += wp.cw_mul(passed, light.sun) * (through * lit * 1.6)
    shine = material[2]
    if shine > 0.0:
        half = wp.normalize(light.sun_direction - wp.normalize(world_from_camera * direction))
        lobe = wp.pow(wp.max(wp.dot(normal, half), 0.0), 24.0)
        radiance += light.sun * (shine * lobe * lit) + light.sky * (shine * 0.25 * sky)
    heat = warmth[(info >> 8) & 255]
    temperature = heat[0] + heat[1] * lit * (front + through) + heat[2] * (1.0 - sky)
    out[at] = wp.vec4(radiance[0], radiance[1], radiance[2], temperature)


def shade(inputs: list[Any], out: Any) -> None:
    """Shade every pixel of a key buffer.

    Args:
        inputs: Arguments of the kernel up to `out`, in order (see `hsvaos.simulate.scene`).
        out: wp.array of vec4, shape (H W,): linear radiance R, G, B and temperature [deg C].
    """
    wp.launch(_shade, dim=out.shape[0], inputs=[*inputs, out], device=out.device)
