"""Colours that no mask takes away: pixels like one of them get their full weight back."""

from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from hsvaos.kernels.arrays import Stack, device_of, pixel_scales, pixel_view, to_array, valid_array
from hsvaos.kernels.device import launch
from hsvaos.kernels.lab import lab_pixel, lab_tables
from hsvaos.kernels.pixels import as_vec3, is_colour
from hsvaos.rarity_model import LIGHTNESS_FLOOR

wp.set_module_options({"enable_backward": False})

LIGHTNESS_SHARE = 0.125
"""Weight of a difference in lightness: shade and sun change it more than they change chroma."""


@wp.func
def colour_place(lab: wp.vec3) -> wp.vec3:
    """Chroma relative to lightness, as rarity bins it, and a share of the lightness."""
    scale = 40.0 / wp.max(lab[0], LIGHTNESS_FLOOR)
    return wp.vec3(lab[1] * scale, lab[2] * scale, lab[0] * LIGHTNESS_SHARE)


@lru_cache
def _keep_kernel(pixel: Any, scalar: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def keep_colours_kernel(
        offset: int,
        band: int,
        scale: wp.vec3,
        colours: wp.array(dtype=wp.vec3),
        distance: float,
        unit: float,
        gamma: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        weights: wp.array(dtype=scalar),
    ):
        i = wp.tid() + offset
        colour = wp.cw_mul(as_vec3(rgb[i]), scale)
        if not is_colour(colour):
            return
        place = colour_place(lab_pixel(colour, gamma, curve))
        for k in range(colours.shape[0]):
            kept = colour_place(lab_pixel(colours[k], gamma, curve))
            if wp.length(place - kept) <= distance:
                weights[i] = scalar(float(valid[i]) * unit)

    return keep_colours_kernel


def keep_colours(
    images: Any,
    weights: Any,
    colours: ArrayLike,
    distance: float,
    *,
    valid: Any = None,
    gains: Any = None,
    device: Any = None,
) -> Any:
    """Give pixels like one of some colours their full weight, in place.

    Two colours are alike where sqrt(da^2 + db^2 + dl^2) <= distance, with a and b the chroma of
    CIE Lab at lightness 40 (40 a / L, 40 b / L; L floored at 8) and l an eighth of the lightness.

    Args:
        images: Shape (N, H, W, 3), RGB; uint8, uint16 or float32 (0..1).
        weights: Shape (N, H, W), uint8 (255 = full weight) or float32 (1 = full weight).
        colours: Shape (K, 3), sRGB 0..1, of photos levelled by the gains.
        distance: See above.
        valid: Shape (H, W) or (N, H, W), uint8 or bool: user masks (0 = ignore), the full weight.
        gains: Shape (N, 3), factors on R, G and B of each image; see `kernels.levels`.
        device: Where to run; by default where the images lie.

    Returns:
        The weights.

    Raises:
        ValueError: If a shape is wrong or the distance is not positive.
        TypeError: If a type is not supported.
    """
    stack = Stack(images, device_of(images, device))
    stack.require_colour()
    wanted = np.ascontiguousarray(np.reshape(np.asarray(colours, np.float32), (-1, 3)))
    if not distance > 0.0:
        raise ValueError(f"distance must be a positive number, got {distance!r}")
    array = to_array(weights, stack.device, "weights")
    shape = (stack.count, stack.height, stack.width)
    if tuple(array.shape) != shape:
        raise ValueError(f"weights must have shape {shape}, got {tuple(array.shape)}")
    if array.dtype not in (wp.uint8, wp.float32):
        raise TypeError(f"weights must be uint8 or float32, got {array.dtype.__name__}")
    masks = valid_array(valid, stack)
    target = pixel_view(array, array.dtype, (stack.count, stack.size))
    kernel = _keep_kernel(stack.pixel, array.dtype)
    unit = 1.0 if array.dtype is wp.uint8 else 1.0 / 255.0
    tables = lab_tables(stack.device)
    kept = wp.array(wanted, dtype=wp.vec3, device=stack.device)
    scales = pixel_scales(stack, gains)
    for i in range(stack.count):
        inputs = [scales[i], kept, float(distance), unit, *tables]
        inputs += [stack.pixels[i], masks[i % masks.shape[0]], target[i]]
        launch(kernel, stack.size, inputs, stack.device)
    return weights
