"""Rarity: weigh every pixel by how rare its colour is over the flight (a step beyond the paper).

A hue cut deletes what has the forest's hue. Rarity asks the whole flight instead: chroma given
lightness, p(chroma | lightness) from a histogram of all pixels, and the weight of a pixel is
min(1, (p0 / p)^exponent). Grey images have no chroma; there the rarity of the grey level counts.
"""

from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.kernels.arrays import (
    Stack,
    device_of,
    like_input,
    output_array,
    pixel_scales,
    pixel_view,
    require_unit_range,
    scalar_type,
    valid_array,
)
from hsvaos.kernels.device import bands, launch
from hsvaos.kernels.lab import lab_pixel, lab_tables
from hsvaos.kernels.pixels import as_value, as_vec3, is_colour
from hsvaos.rarity_model import (
    CHROMA_BINS,
    CHROMA_RANGE,
    GREY_BINS,
    LIGHTNESS_BINS,
    LIGHTNESS_FLOOR,
    RarityModel,
    model_from_counts,
)

wp.set_module_options({"enable_backward": False})

_COLOUR_BINS = LIGHTNESS_BINS * CHROMA_BINS * CHROMA_BINS


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
def _bin_function(pixel: Any) -> Any:
    if pixel in (wp.uint8, wp.uint16, wp.float32):

        @wp.func
        def bin_of(
            value: Any, scale: wp.vec3, gamma: wp.array(dtype=float), curve: wp.array(dtype=float)
        ) -> int:
            level = float(value) * scale[0] * float(GREY_BINS - 1) + 0.5
            return wp.clamp(int(level), 0, GREY_BINS - 1)

    else:

        @wp.func
        def bin_of(
            value: Any, scale: wp.vec3, gamma: wp.array(dtype=float), curve: wp.array(dtype=float)
        ) -> int:
            return colour_bin(lab_pixel(wp.cw_mul(as_vec3(value), scale), gamma, curve))

    return bin_of


@lru_cache
def _count_kernel(pixel: Any) -> Any:
    bin_of = _bin_function(pixel)

    @wp.kernel(module="unique", enable_backward=False)
    def colour_histogram_kernel(
        offset: int,
        band: int,
        scale: wp.vec3,
        gamma: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        image: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        counts: wp.array2d(dtype=wp.int64),
    ):
        i = wp.tid() + offset
        if valid[i] > wp.uint8(0) and is_colour(as_value(image[i])):
            wp.atomic_add(counts, band, bin_of(image[i], scale, gamma, curve), wp.int64(1))

    return colour_histogram_kernel


@lru_cache
def _weight_kernel(pixel: Any, scalar: Any) -> Any:
    bin_of = _bin_function(pixel)

    @wp.kernel(module="unique", enable_backward=False)
    def rarity_weight_kernel(
        offset: int,
        band: int,
        scale: wp.vec3,
        gamma: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        image: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        table: wp.array(dtype=scalar),
        weights: wp.array(dtype=scalar),
    ):
        i = wp.tid() + offset
        weight = table[bin_of(image[i], scale, gamma, curve)]
        if valid[i] < wp.uint8(255):
            weight = scalar(float(weight) * float(valid[i]) / 255.0)
        if not is_colour(as_value(image[i])):
            weight = scalar(0.0)
        weights[i] = weight

    return rarity_weight_kernel


def rarity_model(
    images: Any,
    *,
    threshold: float | None = None,
    exponent: float = 1.5,
    smoothing_bins: float = 1.0,
    valid: Any = None,
    gains: Any = None,
    device: Any = None,
) -> RarityModel:
    """Measure how rare each colour is over a flight.

    Args:
        images: Shape (N, H, W, 3) RGB or (N, H, W) grey; uint8, uint16 or float32 (0..1).
        threshold: p0, probability of a bin below which a colour has weight 1. By default 2e-4 for
            colours (1600 chroma bins) and 1.25e-3 for grey levels (256): the same share of an
            even distribution.
        exponent: Of the weight.
        smoothing_bins: Sigma of the Gaussian that smooths the histogram [bins].
        valid: Shape (H, W) or (N, H, W), uint8 or bool, pixels to use; None for all.
        gains: Shape (N, 3), factors on R, G and B of each image; see `kernels.levels`.
        device: Where to run; by default where the images lie.

    Raises:
        ValueError: If a parameter is out of range or shapes do not fit.
        TypeError: If a type is not supported.
    """
    if threshold is not None and not threshold > 0.0:
        raise ValueError(f"threshold must be a positive probability, got {threshold!r}")
    if not exponent > 0.0:
        raise ValueError(f"exponent must be positive, got {exponent!r}")
    if not 0.0 <= smoothing_bins <= CHROMA_BINS:
        raise ValueError(f"smoothing_bins must lie in 0..{CHROMA_BINS}, got {smoothing_bins!r}")
    stack = Stack(images, device_of(images, device))
    masks = valid_array(valid, stack)
    require_unit_range(stack)
    shape = counts_shape(stack.size, stack.channels, stack.device)
    counts = wp.zeros(shape, dtype=wp.int64, device=stack.device)
    tables = lab_tables(stack.device)
    scales = pixel_scales(stack, gains)
    for i in range(stack.count):
        count_photo(stack.pixels[i], masks[i % masks.shape[0]], scales[i], tables, counts)
    total = counts.numpy().sum(axis=0)
    if stack.channels == 3:
        total = total.reshape(LIGHTNESS_BINS, CHROMA_BINS, CHROMA_BINS)
    return model_from_counts(total, threshold, exponent, smoothing_bins)


def counts_shape(size: int, channels: int, device: Any) -> tuple[int, int]:
    """Return the shape of the histogram of images of a size [px]: one row a band."""
    bins = _COLOUR_BINS if channels == 3 else GREY_BINS
    return len(bands(size, device)), bins


def count_photo(pixels: Any, valid: Any, scale: Any, tables: tuple[Any, Any], counts: Any) -> None:
    """Add the colours of an image to a histogram.

    Args:
        pixels: Warp array (H * W) of pixels.
        valid: Warp array (H * W), uint8, pixels to use.
        scale: Vector that brings pixels to 0..1, see `arrays.pixel_scales`.
        tables: From `colour_tables`.
        counts: Warp array of `counts_shape`, int64, added to.
    """
    inputs = [scale, *tables, pixels, valid, counts]
    launch(_count_kernel(pixels.dtype), pixels.size, inputs, pixels.device)


def byte_table(model: RarityModel) -> NDArray[np.uint8]:
    """Return the weights of all bins, laid flat, 255 = weight 1, at least 2."""
    return np.maximum(np.rint(model.weights.reshape(-1) * 255.0), 2.0).astype(np.uint8)


def weigh_photo(
    pixels: Any, valid: Any, scale: Any, tables: tuple[Any, Any], table: Any, weights: Any
) -> None:
    """Write the weight of every pixel of an image.

    Args:
        pixels: Warp array (H * W) of pixels.
        valid: Warp array (H * W), uint8, multiplied in.
        scale: Vector that brings pixels to 0..1, see `arrays.pixel_scales`.
        tables: From `colour_tables`.
        table: Warp array of the weight of each bin, uint8 or float32.
        weights: Warp array (H * W) of that type, written.
    """
    inputs = [scale, *tables, pixels, valid, table, weights]
    launch(_weight_kernel(pixels.dtype, table.dtype), pixels.size, inputs, pixels.device)


def apply_rarity(
    images: Any,
    model: RarityModel,
    *,
    dtype: Any = "uint8",
    valid: Any = None,
    gains: Any = None,
    out: Any = None,
    device: Any = None,
) -> Any:
    """Return the weight of every pixel under a model that was measured before.

    Args:
        images: Shape (N, H, W, 3) RGB or (N, H, W) grey, as the model.
        model: From `rarity_model`.
        dtype: "uint8" (255 = weight 1; at least 2, so that every ray still counts and weights are
            never taken for a mask of 0 and 1) or "float32".
        valid: User masks that multiply in.
        gains: Shape (N, 3), factors on R, G and B of each image, as when measured.
        out: Shape (N, H, W), written in place; new if None.
        device: Where to run; by default where the images lie.

    Returns:
        Shape (N, H, W), uint8 or float32.

    Raises:
        ValueError: If the images are grey and the model is not, or the other way round.
    """
    stack = Stack(images, device_of(images, device))
    if model.is_grey != (stack.channels == 1):
        raise ValueError("model and images must both be grey or both RGB")
    scalar = scalar_type(dtype)
    if scalar is wp.uint16:
        raise TypeError('dtype must be "uint8" or "float32", got "uint16"')
    masks = valid_array(valid, stack)
    weights = byte_table(model) if scalar is wp.uint8 else model.weights.reshape(-1)
    table = wp.array(weights, dtype=scalar, device=stack.device)
    shape = (stack.count, stack.height, stack.width)
    result = output_array(out, shape, scalar, stack.device, "out")
    target = pixel_view(result, scalar, (stack.count, stack.size))
    tables = lab_tables(stack.device)
    scales = pixel_scales(stack, gains)
    for i in range(stack.count):
        valid_row = masks[i % masks.shape[0]]
        weigh_photo(stack.pixels[i], valid_row, scales[i], tables, table, target[i])
    return like_input(result, images) if out is None else out


def rarity_weights(
    images: Any,
    *,
    threshold: float | None = None,
    exponent: float = 1.5,
    smoothing_bins: float = 1.0,
    dtype: Any = "uint8",
    valid: Any = None,
    gains: Any = None,
    out: Any = None,
    device: Any = None,
) -> tuple[Any, RarityModel]:
    """Weigh every pixel by how rare its colour is over the flight.

    CIE Lab from sRGB; lightness in 10 levels; chroma (40 a / L, 40 b / L) in 40 x 40 bins over
    +-48, L floored at 8; histogram of all images, smoothed, normalised for each lightness level;
    weight = min(1, (p0 / p)^exponent).

    Args:
        images: Shape (N, H, W, 3) RGB or (N, H, W) grey; uint8, uint16 or float32 (0..1).
        threshold: p0; see `rarity_model`.
        exponent: Of the weight.
        smoothing_bins: Sigma of the Gaussian that smooths the histogram [bins].
        dtype: "uint8" (255 = weight 1; at least 2) or "float32".
        valid: Shape (H, W) or (N, H, W), uint8 or bool: user masks (0 = ignore), which multiply in
            and keep pixels out of the histogram.
        gains: Shape (N, 3), factors on R, G and B of each image; see `kernels.levels`.
        out: Shape (N, H, W), written in place; new if None.
        device: Where to run; by default where the images lie.

    Returns:
        weights, shape (N, H, W), and the `RarityModel`.

    Raises:
        ValueError: If a parameter is out of range or shapes do not fit.
        TypeError: If a type is not supported.
    """
    model = rarity_model(
        images,
        threshold=threshold,
        exponent=exponent,
        smoothing_bins=smoothing_bins,
        valid=valid,
        gains=gains,
        device=device,
    )
    weights = apply_rarity(
        images, model, dtype=dtype, valid=valid, gains=gains, out=out, device=device
    )
    return weights, model
