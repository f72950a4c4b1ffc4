"""sRGB to CIE Lab through tables: powers and cube roots are most of the cost on a CPU."""

from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.kernels.device import launch

wp.set_module_options({"enable_backward": False})

GAMMA = 4096
"""Entries of the gamma table; linear in between, error below 1e-6."""

BYTE_LIGHT = 3 * 256
"""Entries of a table of linear light: of each value of a byte, for red, green and blue."""

CURVE = 4096
"""Entries of the table of Lab's cube root; linear in between, error below 1e-5."""


def gamma_table(entries: int) -> NDArray[np.float32]:
    """Return linear light for sRGB values 0..1 (IEC 61966-2-1).

    Args:
        entries: Number of evenly spaced values.
    """
    value = np.linspace(0.0, 1.0, entries)
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


def lab_curve_table(entries: int) -> NDArray[np.float32]:
    """Return f(t) of CIE 1976 Lab for t in 0..1: the cube root, linear near black.

    Args:
        entries: Number of evenly spaced values.
    """
    t = np.linspace(0.0, 1.0, entries)
    return np.where(t > 216.0 / 24389.0, np.cbrt(t), (24389.0 / 27.0 * t + 16.0) / 116.0).astype(
        np.float32
    )


def lab_tables(device: Any) -> tuple[Any, Any]:
    """Return the two tables that `lab_pixel` takes, as Warp arrays; they are brought over once.

    Args:
        device: Warp device.
    """
    return _tables_on(device.alias)


@lru_cache
def _tables_on(alias: str) -> tuple[Any, Any]:
    gamma: Any = wp.array(gamma_table(GAMMA), dtype=float, device=alias)
    curve: Any = wp.array(lab_curve_table(CURVE), dtype=float, device=alias)
    return gamma, curve


@wp.func
def look_up(table: wp.array(dtype=float), value: float) -> float:
    """Table over 0..1, linear in between, clamped outside."""
    last = table.shape[0] - 1
    place = wp.clamp(value, 0.0, 1.0) * float(last)
    left = wp.min(int(place), last - 1)
    part = place - float(left)
    return table[left] * (1.0 - part) + table[left + 1] * part


@wp.func
def lab_pixel(rgb: wp.vec3, gamma: wp.array(dtype=float), curve: wp.array(dtype=float)) -> wp.vec3:
    """Return L 0..100, a and b of an sRGB colour 0..1 under D65 (CIE 15:2004)."""
    light = wp.vec3(look_up(gamma, rgb[0]), look_up(gamma, rgb[1]), look_up(gamma, rgb[2]))
    return lab_of_light(light, curve)


@wp.func
def lab_of_light(light: wp.vec3, curve: wp.array(dtype=float)) -> wp.vec3:
    """Return L, a and b of linear light 0..1 in red, green and blue."""
    r, g, b = light[0], light[1], light[2]
    x = look_up(curve, (0.412453 * r + 0.357580 * g + 0.180423 * b) / 0.950456)
    y = look_up(curve, 0.212671 * r + 0.715160 * g + 0.072169 * b)
    z = look_up(curve, (0.019334 * r + 0.119193 * g + 0.950227 * b) / 1.088754)
    return wp.vec3(116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z))


@wp.kernel(module="unique", enable_backward=False)
def _light_kernel(
    offset: int,
    band: int,
    scales: wp.array(dtype=wp.vec3),
    gamma: wp.array(dtype=float),
    light: wp.array2d(dtype=float),
):
    i = wp.tid() + offset
    photo = i / BYTE_LIGHT
    place = i - photo * BYTE_LIGHT
    channel = place / 256
    value = float(place - channel * 256)
    light[photo, place] = look_up(gamma, value * scales[photo][channel])


def byte_light(scales: list[Any], device: Any) -> Any:
    """Return the linear light of every byte value, a Warp array (N, 768): red, green, blue.

    What `lab_pixel` looks up for each pixel, looked up once a photo: the same to the bit.

    Args:
        scales: N vectors that bring the bytes of each photo to 0..1.
        device: Warp device.
    """
    gamma, _ = lab_tables(device)
    light = wp.empty((len(scales), BYTE_LIGHT), dtype=float, device=device)
    factors = wp.array(scales, dtype=wp.vec3, device=device)
    launch(_light_kernel, light.size, [factors, gamma, light], device)
    return light
