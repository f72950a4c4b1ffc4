"""RGB to HSV and back, and brightening of dark pixels (hexcone model, Smith 1978)."""

from functools import lru_cache
from typing import Any

import warp as wp

from hsvaos.kernels.arrays import (
    RGB,
    SCALE,
    Stack,
    check_gains,
    device_of,
    like_input,
    output_array,
    pixel_view,
    require_unit_range,
    scalar_type,
    valid_array,
)
from hsvaos.kernels.device import in_vectors, launch
from hsvaos.kernels.hsv_chunks import convert_to_hsv
from hsvaos.kernels.pixels import as_value, as_vec3, brightness, store, times_gain

wp.set_module_options({"enable_backward": False})


@wp.func
def rgb_to_hsv_pixel(rgb: wp.vec3) -> wp.vec3:
    """RGB in 0..1 to hue [0, 360) degrees, saturation and value 0..1; grey has hue 0."""
    r, g, b = rgb[0], rgb[1], rgb[2]
    value = wp.max(r, wp.max(g, b))
    chroma = value - wp.min(r, wp.min(g, b))
    hue = float(0.0)
    saturation = float(0.0)
    if chroma > 0.0:
        saturation = chroma / value
        if value == r:
            hue = 60.0 * (g - b) / chroma
        elif value == g:
            hue = 120.0 + 60.0 * (b - r) / chroma
        else:
            hue = 240.0 + 60.0 * (r - g) / chroma
        if hue < 0.0:
            hue += 360.0
        if hue >= 360.0:  # a tiny negative hue rounds up to a full turn
            hue -= 360.0
    return wp.vec3(hue, saturation, value)


@wp.func
def hsv_to_rgb_pixel(hsv: wp.vec3) -> wp.vec3:
    """Hue in degrees (any turn), saturation and value 0..1 to RGB in 0..1."""
    chroma = hsv[1] * hsv[2]
    sector = hsv[0] / 60.0
    sector = sector - 6.0 * wp.floor(sector / 6.0)
    base = hsv[2] - chroma
    second = chroma * (1.0 - wp.abs(sector - 2.0 * wp.floor(sector / 2.0) - 1.0))
    r, g, b = float(0.0), float(0.0), float(0.0)
    if sector < 1.0:
        r, g = chroma, second
    elif sector < 2.0:
        r, g = second, chroma
    elif sector < 3.0:
        g, b = chroma, second
    elif sector < 4.0:
        g, b = second, chroma
    elif sector < 5.0:
        r, b = second, chroma
    else:
        r, b = chroma, second
    return wp.vec3(r + base, g + base, b + base)


@lru_cache
def _to_hsv_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def rgb_to_hsv_kernel(
        offset: int,
        band: int,
        white: float,
        rgb: wp.array(dtype=pixel),
        hsv: wp.array(dtype=wp.vec3),
    ):
        i = wp.tid() + offset
        hsv[i] = rgb_to_hsv_pixel(as_vec3(rgb[i]) / white)

    return rgb_to_hsv_kernel


@lru_cache
def _to_rgb_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def hsv_to_rgb_kernel(
        offset: int,
        band: int,
        white: float,
        hsv: wp.array(dtype=wp.vec3),
        rgb: wp.array(dtype=pixel),
    ):
        i = wp.tid() + offset
        rgb[i] = store(hsv_to_rgb_pixel(hsv[i]) * white, rgb[i])

    return hsv_to_rgb_kernel


@lru_cache
def _brighten_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def brighten_kernel(
        offset: int,
        band: int,
        white: float,
        target: float,
        gamma: float,
        max_gain: float,
        level: wp.vec3,
        keep: wp.array(dtype=wp.uint8),
        rgb: wp.array(dtype=pixel),
        out: wp.array(dtype=pixel),
    ):
        i = wp.tid() + offset
        colour = times_gain(as_value(rgb[i]), level)
        value = brightness(colour) / white
        gain = float(1.0)
        if keep[i] > wp.uint8(0) and value > 0.0 and value < target:
            gain = wp.min(wp.pow(value / target, gamma - 1.0), max_gain)
        out[i] = store(colour * gain, rgb[i])

    return brighten_kernel


def rgb_to_hsv(images: Any, *, out: Any = None, device: Any = None) -> Any:
    """Convert RGB images to hue, saturation and value.

    Args:
        images: Shape (N, H, W, 3), RGB; uint8, uint16 (full range) or float32 (0..1).
        out: Shape (N, H, W, 3), float32, written in place; new if None.
        device: Where to run; by default where the images lie.

    Returns:
        Shape (N, H, W, 3), float32: hue in degrees [0, 360), saturation and value 0..1. Grey has
        hue 0 (Smith 1978; the values of OpenCV's float `COLOR_RGB2HSV`).

    Raises:
        ValueError: If the images are not RGB.
        TypeError: If their type is not supported.
    """
    stack = Stack(images, device_of(images, device))
    stack.require_colour()
    hsv = output_array(out, tuple(stack.array.shape), wp.float32, stack.device, "out")
    target = pixel_view(hsv, wp.vec3, (stack.count, stack.size))
    for i in range(stack.count):
        if in_vectors(stack.device):
            convert_to_hsv(stack.pixels[i], stack.white, target[i])
        else:
            inputs = [stack.white, stack.pixels[i], target[i]]
            launch(_to_hsv_kernel(stack.pixel), stack.size, inputs, stack.device)
    return like_input(hsv, images) if out is None else out


def hsv_to_rgb(hsv: Any, *, dtype: Any = "float32", out: Any = None, device: Any = None) -> Any:
    """Convert hue, saturation and value back to RGB images.

    Args:
        hsv: Shape (N, H, W, 3), float32: hue in degrees (any turn), saturation and value 0..1.
        dtype: "uint8", "uint16" (full range, rounded) or "float32" (0..1).
        out: Shape (N, H, W, 3) of that type, written in place; new if None.
        device: Where to run; by default where hsv lies.

    Returns:
        Shape (N, H, W, 3) RGB.

    Raises:
        ValueError: If the shape is not that of images.
        TypeError: If a type is not supported.
    """
    stack = Stack(hsv, device_of(hsv, device), "hsv")
    stack.require_colour()
    if stack.scalar is not wp.float32:
        raise TypeError(f"hsv must be float32, got {stack.scalar.__name__}")
    scalar = scalar_type(dtype)
    rgb = output_array(out, tuple(stack.array.shape), scalar, stack.device, "out")
    target = pixel_view(rgb, RGB[scalar], (stack.count, stack.size))
    kernel = _to_rgb_kernel(RGB[scalar])
    for i in range(stack.count):
        launch(kernel, stack.size, [SCALE[scalar], stack.pixels[i], target[i]], stack.device)
    return like_input(rgb, hsv) if out is None else out


def brighten(
    images: Any,
    keep: Any = None,
    *,
    target_value: float = 0.25,
    gamma: float = 0.6,
    max_gain: float = 3.0,
    gains: Any = None,
    out: Any = None,
    device: Any = None,
) -> Any:
    """Brighten dark pixels, hue and saturation untouched, as section 3.1 of the paper asks.

    A kept pixel with value V below the target T gets V' = T (V / T)^gamma, at most max_gain V; all
    three channels are scaled by V' / V.

    Args:
        images: Shape (N, H, W, 3) RGB or (N, H, W) grey; uint8, uint16 or float32 (0..1).
        keep: Shape (N, H, W) or (H, W), uint8 or bool; pixels with 0 stay as they are.
        target_value: Value T below which a pixel counts as dark, 0..1.
        gamma: Exponent, 0 < gamma <= 1; 1 changes nothing.
        max_gain: Largest factor, so that noise in black is not blown up.
        gains: Shape (N, 3), factors on the channels of each image that level exposure before.
        out: Like images, written in place (may be the images themselves); new if None.
        device: Where to run; by default where the images lie.

    Returns:
        Shape and type of the images.

    Raises:
        ValueError: If a parameter is out of range or shapes differ.
        TypeError: If a type is not supported.
    """
    check_brightening(target_value, gamma, max_gain)
    stack = Stack(images, device_of(images, device))
    require_unit_range(stack)
    valid = valid_array(keep, stack)
    result = output_array(out, tuple(stack.array.shape), stack.scalar, stack.device, "out")
    kernel = _brighten_kernel(stack.pixel)
    settings = [stack.white, float(target_value), float(gamma), float(max_gain)]
    target = pixel_view(result, stack.pixel, (stack.count, stack.size))
    levels = check_gains(gains, stack)
    for i in range(stack.count):
        inputs = [
            *settings,
            wp.vec3(*levels[i]),
            valid[i % valid.shape[0]],
            stack.pixels[i],
            target[i],
        ]
        launch(kernel, stack.size, inputs, stack.device)
    return like_input(result, images) if out is None else out


def check_brightening(target_value: float, gamma: float, max_gain: float) -> None:
    """Raise where a parameter of `brighten` makes no sense.

    Raises:
        ValueError: If it is out of range.
    """
    if not 0.0 < target_value <= 1.0:
        raise ValueError(f"target_value must lie in (0, 1], got {target_value!r}")
    if not 0.0 < gamma <= 1.0:
        raise ValueError(f"gamma must lie in (0, 1], got {gamma!r}")
    if not max_gain >= 1.0:
        raise ValueError(f"max_gain must be at least 1, got {max_gain!r}")
