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
from hsvaos.kernels.device import in_vectors, launch
from hsvaos.kernels.pixels import as_value, is_colour
from hsvaos.kernels.rarity_bins import Tables, bin_function, bin_tables, count_photo, counts_shape
from hsvaos.kernels.rarity_chunks import weigh_bytes
from hsvaos.rarity_model import CHROMA_BINS, LIGHTNESS_BINS, RarityModel, model_from_counts

wp.set_module_options({"enable_backward": False})


@lru_cache
def _weight_kernel(pixel: Any, scalar: Any) -> Any:
    bin_of = bin_function(pixel)

    @wp.kernel(module="unique", enable_backward=False)
    def rarity_weight_kernel(
        offset: int,
        band: int,
        scale: wp.vec3,
        light: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        image: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        table: wp.array(dtype=scalar),
        weights: wp.array(dtype=scalar),
    ):
        i = wp.tid() + offset
        weight = table[bin_of(image[i], scale, light, curve)]
        if valid[i] < wp.uint8(255):
            weight = scalar(float(weight) * float(valid[i]) / 255.0)
        if not is_colour(as_value(image[i])):
            weight = scalar(0.0)
        weights[i] = weight

    return rarity_weight_kernel


@wp.kernel(module="unique", enable_backward=False)
def _kept_kernel(
    offset: int,
    band: int,
    valid: wp.array(dtype=wp.uint8),
    table: wp.array(dtype=float),
    weights: wp.array(dtype=float),
):
    i = wp.tid() + offset
    bin = int(weights[i])
    weight = float(0.0)
    if bin >= 0:
        weight = table[bin]
        if valid[i] < wp.uint8(255):
            weight = weight * float(valid[i]) / 255.0
    weights[i] = weight


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
    _check_parameters(threshold, exponent, smoothing_bins)
    stack = Stack(images, device_of(images, device))
    masks = valid_array(valid, stack)
    return _measured(stack, masks, gains, (threshold, exponent, smoothing_bins))


def _check_parameters(threshold: float | None, exponent: float, smoothing_bins: float) -> None:
    if threshold is not None and not threshold > 0.0:
        raise ValueError(f"threshold must be a positive probability, got {threshold!r}")
    if not exponent > 0.0:
        raise ValueError(f"exponent must be positive, got {exponent!r}")
    if not 0.0 <= smoothing_bins <= CHROMA_BINS:
        raise ValueError(f"smoothing_bins must lie in 0..{CHROMA_BINS}, got {smoothing_bins!r}")


def _measured(
    stack: Stack,
    masks: Any,
    gains: Any,
    parameters: tuple[float | None, float, float],
    kept: Any = None,
) -> RarityModel:
    """Return the model of images; `kept`, one row an image, takes the bins, see `count_photo`."""
    require_unit_range(stack)
    scales = pixel_scales(stack, gains)
    tables = bin_tables(stack, scales)
    shape = counts_shape(stack.size, stack.channels, stack.device)
    counts = wp.zeros(shape, dtype=wp.int64, device=stack.device)
    for i in range(stack.count):
        row = None if kept is None else kept[i]
        valid = masks[i % masks.shape[0]]
        count_photo(stack.pixels[i], valid, scales[i], tables[i], counts, row)
    total = counts.numpy().sum(axis=0)
    if stack.channels == 3:
        total = total.reshape(LIGHTNESS_BINS, CHROMA_BINS, CHROMA_BINS)
    return model_from_counts(total, *parameters)


def byte_table(model: RarityModel) -> NDArray[np.uint8]:
    """Return the weights of all bins, laid flat, 255 = weight 1, at least 2."""
    return np.maximum(np.rint(model.weights.reshape(-1) * 255.0), 2.0).astype(np.uint8)


def weigh_photo(
    pixels: Any, valid: Any, scale: Any, tables: Tables, table: Any, weights: Any
) -> None:
    """Write the weight of every pixel of an image.

    Args:
        pixels: Warp array (H * W) of pixels.
        valid: Warp array (H * W), uint8, multiplied in.
        scale: Vector that brings pixels to 0..1, see `arrays.pixel_scales`.
        tables: From `bin_tables`.
        table: Warp array of the weight of each bin, uint8 or float32.
        weights: Warp array (H * W) of that type, written.
    """
    inputs = [*tables, pixels, valid, table, weights]
    if pixels.dtype is wp.vec3ub and in_vectors(pixels.device):
        weigh_bytes(pixels, table, inputs)
    else:
        kernel = _weight_kernel(pixels.dtype, table.dtype)
        launch(kernel, pixels.size, [scale, *inputs], pixels.device)


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
    scales = pixel_scales(stack, gains)
    tables = bin_tables(stack, scales)
    for i in range(stack.count):
        valid_row = masks[i % masks.shape[0]]
        weigh_photo(stack.pixels[i], valid_row, scales[i], tables[i], table, target[i])
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
    _check_parameters(threshold, exponent, smoothing_bins)
    parameters = (threshold, exponent, smoothing_bins)
    stack = Stack(images, device_of(images, device))
    masks = valid_array(valid, stack)
    if scalar_type(dtype) is not wp.float32:  # bins do not fit into such weights
        model = _measured(stack, masks, gains, parameters)
        weights = apply_rarity(
            images, model, dtype=dtype, valid=valid, gains=gains, out=out, device=device
        )
        return weights, model
    shape = (stack.count, stack.height, stack.width)
    result = output_array(out, shape, wp.float32, stack.device, "out")
    target = pixel_view(result, wp.float32, (stack.count, stack.size))
    model = _measured(stack, masks, gains, parameters, kept=target)
    table: Any = wp.array(model.weights.reshape(-1), dtype=float, device=stack.device)
    for i in range(stack.count):
        inputs = [masks[i % masks.shape[0]], table, target[i]]
        launch(_kept_kernel, stack.size, inputs, stack.device)
    return like_input(result, images) if out is None else out, model
