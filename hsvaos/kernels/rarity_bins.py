"""The bin of every pixel's colour, and histograms of them, for `kernels.rarity`."""

from functools import lru_cache
from typing import Any

import warp as wp

from hsvaos.kernels.arrays import Stack
from hsvaos.kernels.device import bands, in_vectors, launch
from hsvaos.kernels.lab import byte_light, lab_of_light, lab_pixel, lab_tables
from hsvaos.kernels.pixels import as_value, as_vec3, is_colour
from hsvaos.kernels.rarity_chunks import count_bytes
from hsvaos.rarity_model import (
    CHROMA_BINS,
    CHROMA_RANGE,
    GREY_BINS,
    LIGHTNESS_BINS,
    LIGHTNESS_FLOOR,
)

wp.set_module_options({"enable_backward": False})

_COLOUR_BINS = LIGHTNESS_BINS * CHROMA_BINS * CHROMA_BINS

Tables = tuple[Any, Any]
"""Linear light by value, and Lab's curve; the first by byte where pixels are bytes."""


@wp.func
def colour_bin(lab: wp.vec3) -> int:
    """Bin of a colour: lightness level, then chroma relative to lightness."""
    scale = 40.0 / wp.max(lab[0], LIGHTNESS_FLOOR)
    per_bin = float(CHROMA_BINS) / (2.0 * CHROMA_RANGE)
    level = wp.clamp(int(lab[0] * (float(LIGHTNESS_BINS) / 100.0)), 0, LIGHTNESS_BINS - 1)
    a = wp.clamp(int((lab[1] * scale + CHROMA_RANGE) * per_bin), 0, CHROMA_BINS - 1)
    b = wp.clamp(int((lab[2] * scale + CHROMA_RANGE) * per_bin), 0, CHROMA_BINS - 1)
    return (level * CHROMA_BINS + a) * CHROMA_BINS + b


@lru_cache
def bin_function(pixel: Any) -> Any:
    """Return the function that finds the bin of a pixel of a type.

    Args:
        pixel: Warp type. The function takes a pixel, its scale and the two tables.
    """
    if pixel in (wp.uint8, wp.uint16, wp.float32):

        @wp.func
        def bin_of(
            value: Any, scale: wp.vec3, light: wp.array(dtype=float), curve: wp.array(dtype=float)
        ) -> int:
            level = float(value) * scale[0] * float(GREY_BINS - 1) + 0.5
            return wp.clamp(int(level), 0, GREY_BINS - 1)

    elif pixel is wp.vec3ub:

        @wp.func
        def bin_of(
            value: Any, scale: wp.vec3, light: wp.array(dtype=float), curve: wp.array(dtype=float)
        ) -> int:
            r, g, b = int(value[0]), int(value[1]) + 256, int(value[2]) + 512
            return colour_bin(lab_of_light(wp.vec3(light[r], light[g], light[b]), curve))

    else:

        @wp.func
        def bin_of(
            value: Any, scale: wp.vec3, light: wp.array(dtype=float), curve: wp.array(dtype=float)
        ) -> int:
            return colour_bin(lab_pixel(wp.cw_mul(as_vec3(value), scale), light, curve))

    return bin_of


def bin_tables(stack: Stack, scales: list[Any]) -> list[Tables]:
    """Return the tables for each image.

    Args:
        stack: The images.
        scales: From `arrays.pixel_scales`.
    """
    gamma, curve = lab_tables(stack.device)
    if stack.pixels.dtype is not wp.vec3ub:
        return [(gamma, curve)] * stack.count
    light = byte_light(scales, stack.device)
    return [(light[i], curve) for i in range(stack.count)]


@lru_cache
def _count_kernel(pixel: Any) -> Any:
    bin_of = bin_function(pixel)

    @wp.kernel(module="unique", enable_backward=False)
    def colour_histogram_kernel(
        offset: int,
        band: int,
        scale: wp.vec3,
        light: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        image: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        counts: wp.array2d(dtype=wp.int64),
        kept: wp.array(dtype=float),
    ):
        i = wp.tid() + offset
        bin = int(-1)
        if valid[i] > wp.uint8(0) and is_colour(as_value(image[i])):
            bin = bin_of(image[i], scale, light, curve)
            wp.atomic_add(counts, band, bin, wp.int64(1))
        if kept:
            kept[i] = float(bin)

    return colour_histogram_kernel


def counts_shape(size: int, channels: int, device: Any) -> tuple[int, int]:
    """Return the shape of the histogram of images of a size [px]: one row a band."""
    bins = _COLOUR_BINS if channels == 3 else GREY_BINS
    return len(bands(size, device)), bins


def count_photo(
    pixels: Any, valid: Any, scale: Any, tables: Tables, counts: Any, kept: Any = None
) -> None:
    """Add the colours of an image to a histogram.

    Args:
        pixels: Warp array (H * W) of pixels.
        valid: Warp array (H * W), uint8, pixels to use.
        scale: Vector that brings pixels to 0..1, see `arrays.pixel_scales`.
        tables: From `bin_tables`.
        counts: Warp array of `counts_shape`, int64, added to.
        kept: Warp array (H * W), float32, set to the bin of every pixel, -1 where it does not
            count; None to keep none.
    """
    inputs = [*tables, pixels, valid, counts, kept]
    if pixels.dtype is wp.vec3ub and in_vectors(pixels.device):
        count_bytes(pixels, inputs)
    else:
        launch(_count_kernel(pixels.dtype), pixels.size, [scale, *inputs], pixels.device)
