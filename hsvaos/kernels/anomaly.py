"""RX anomaly detector: Mahalanobis distance of each pixel's colour from its image (Reed, Yu 1990).

d(x) = (x - mu)' C^-1 (x - mu); what lies beyond a quantile of d is an anomaly. The paper's group
applies it to integral images, JKU now to single frames, whose masks are then integrated.
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
    pixel_view,
    valid_array,
)
from hsvaos.kernels.device import ROW_GRAIN, bands, launch
from hsvaos.kernels.pixels import as_colour, as_value

wp.set_module_options({"enable_backward": False})

_REGULAR = 1e-4
"""Added to the variance of colours 0..1, so that flat or grey images can be inverted."""

_SUMS = 10
"""Count, three sums, six sums of products."""

_BINS = 4096
_BINS_PER_OCTAVE = 128.0
"""The quantile is found in a logarithmic histogram: one bin is half a percent of d."""


@lru_cache
def _sums_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def colour_sums_kernel(
        offset: int,
        band: int,
        width: int,
        white: float,
        image: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        sums: wp.array2d(dtype=wp.float64),
    ):
        row = wp.tid() + offset
        count = wp.float64(0.0)
        total = wp.vec3d()
        squares = wp.vec3d()
        mixed = wp.vec3d()
        for column in range(width):
            i = row * width + column
            if valid[i] > wp.uint8(0):
                x = wp.vec3d(as_colour(as_value(image[i])) / white)
                count += wp.float64(1.0)
                total += x
                squares += wp.vec3d(x[0] * x[0], x[1] * x[1], x[2] * x[2])
                mixed += wp.vec3d(x[0] * x[1], x[0] * x[2], x[1] * x[2])
        sums[row, 0] = count
        for c in range(3):
            sums[row, 1 + c] = total[c]
            sums[row, 4 + c] = squares[c]
            sums[row, 7 + c] = mixed[c]

    return colour_sums_kernel


@lru_cache
def _distance_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def mahalanobis_kernel(
        offset: int,
        band: int,
        white: float,
        mean: wp.vec3,
        inverse: wp.mat33,
        image: wp.array(dtype=pixel),
        distances: wp.array(dtype=float),
    ):
        i = wp.tid() + offset
        away = as_colour(as_value(image[i])) / white - mean
        distances[i] = wp.dot(away, inverse * away)

    return mahalanobis_kernel


@wp.kernel(module="unique", enable_backward=False)
def _cut(
    offset: int,
    band: int,
    threshold: float,
    distances: wp.array(dtype=float),
    valid: wp.array(dtype=wp.uint8),
    mask: wp.array(dtype=wp.uint8),
):
    i = wp.tid() + offset
    keep = valid[i]
    if distances[i] <= threshold:
        keep = wp.uint8(0)
    mask[i] = keep


@wp.kernel(module="unique", enable_backward=False)
def _row_histogram(
    offset: int,
    band: int,
    width: int,
    distances: wp.array(dtype=float),
    valid: wp.array(dtype=wp.uint8),
    counts: wp.array2d(dtype=wp.int32),
):
    row = wp.tid() + offset
    for column in range(width):
        i = row * width + column
        if valid[i] > wp.uint8(0):
            place = wp.log2(wp.max(distances[i], 1.0e-6)) * _BINS_PER_OCTAVE
            bin = wp.clamp(int(wp.floor(place)) + _BINS // 2, 0, _BINS - 1)
            wp.atomic_add(counts, band, bin, 1)


def rx_statistics(
    images: Any, *, valid: Any = None, device: Any = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and covariance of the colours of every image.

    Args:
        images: Shape (N, H, W, 3) or (N, H, W); uint8, uint16 or float32 (0..1).
        valid: Shape (H, W) or (N, H, W), uint8 or bool, pixels to use; None for all.
        device: Where to run; by default where the images lie.

    Returns:
        means, shape (N, 3), and covariances, shape (N, 3, 3), float64, of colours 0..1. Zero where
        no pixel is valid.

    Raises:
        ValueError: If images or masks have the wrong shape.
        TypeError: If their type is not supported.
    """
    stack = Stack(images, device_of(images, device))
    masks = valid_array(valid, stack)
    shape = (stack.count, stack.height, _SUMS)
    sums = wp.zeros(shape, dtype=wp.float64, device=stack.device)
    kernel = _sums_kernel(stack.pixel)
    for i in range(stack.count):
        pixels, mask = stack.pixels[i], masks[i % masks.shape[0]]
        launch(
            kernel, stack.height, [stack.width, stack.white, pixels, mask, sums[i]], stack.device
        )
    totals = sums.numpy().sum(axis=1)
    count = np.maximum(totals[:, 0], 1.0)[:, None]
    mean = totals[:, 1:4] / count
    moments = totals[:, 4:] / count
    second = moments[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
    return mean, second - mean[:, :, None] * mean[:, None, :]


def rx_distances(images: Any, *, valid: Any = None, out: Any = None, device: Any = None) -> Any:
    """Return the squared Mahalanobis distance of every pixel from the colours of its image.

    Args:
        images: Shape (N, H, W, 3) or (N, H, W); uint8, uint16 or float32 (0..1).
        valid: Shape (H, W) or (N, H, W), uint8 or bool, pixels that make the statistics.
        out: Shape (N, H, W), float32, written in place; new if None.
        device: Where to run; by default where the images lie.

    Returns:
        Shape (N, H, W), float32.

    Raises:
        ValueError: If images or masks have the wrong shape.
        TypeError: If their type is not supported.
    """
    stack = Stack(images, device_of(images, device))
    mean, covariance = rx_statistics(images, valid=valid, device=device)
    inverse = np.linalg.inv(covariance + _REGULAR * np.eye(3))
    shape = (stack.count, stack.height, stack.width)
    result = output_array(out, shape, wp.float32, stack.device, "out")
    target = pixel_view(result, wp.float32, (stack.count, stack.size))
    kernel = _distance_kernel(stack.pixel)
    for i in range(stack.count):
        model = [wp.vec3(*mean[i]), wp.mat33(*inverse[i].ravel())]
        inputs = [stack.white, *model, stack.pixels[i], target[i]]
        launch(kernel, stack.size, inputs, stack.device)
    return like_input(result, images) if out is None else out


def rx_masks(
    images: Any,
    quantile: float = 0.99,
    *,
    valid: Any = None,
    out: Any = None,
    device: Any = None,
) -> tuple[Any, NDArray[np.float64]]:
    """Keep the anomalous pixels of every image: RX distance beyond a quantile of that image.

    Args:
        images: Shape (N, H, W, 3) or (N, H, W); uint8, uint16 or float32 (0..1).
        quantile: Share of the pixels that is cut, 0 < quantile < 1.
        valid: Shape (H, W) or (N, H, W), uint8 or bool: user masks, which multiply in.
        out: Shape (N, H, W), uint8, written in place; new if None.
        device: Where to run; by default where the images lie.

    Returns:
        masks, shape (N, H, W), uint8, 255 = keep, and thresholds, shape (N,), float64: the
        distance of each cut, exact to half a percent.

    Raises:
        ValueError: If quantile is out of range or a shape is wrong.
        TypeError: If a type is not supported.
    """
    if not 0.0 < quantile < 1.0:
        raise ValueError(f"quantile must lie between 0 and 1, got {quantile!r}")
    stack = Stack(images, device_of(images, device))
    masks = valid_array(valid, stack)
    shape = (stack.count, stack.height, stack.width)
    distances = wp.empty(shape, dtype=wp.float32, device=stack.device)
    rx_distances(stack.array, valid=valid, out=distances, device=stack.device)
    flat = pixel_view(distances, wp.float32, (stack.count, stack.size))
    thresholds = _quantiles(stack, flat, masks, quantile)
    result = output_array(out, shape, wp.uint8, stack.device, "out")
    target = pixel_view(result, wp.uint8, (stack.count, stack.size))
    for i, threshold in enumerate(thresholds):
        inputs = [float(threshold), flat[i], masks[i % masks.shape[0]], target[i]]
        launch(_cut, stack.size, inputs, stack.device)
    return (like_input(result, images) if out is None else out), thresholds


def _quantiles(stack: Stack, distances: Any, masks: Any, quantile: float) -> NDArray[np.float64]:
    parts = len(bands(stack.height, stack.device, ROW_GRAIN))
    counts = wp.zeros((stack.count, parts, _BINS), dtype=wp.int32, device=stack.device)
    for i in range(stack.count):
        inputs = [stack.width, distances[i], masks[i % masks.shape[0]], counts[i]]
        launch(_row_histogram, stack.height, inputs, stack.device, ROW_GRAIN)
    cumulated = counts.numpy().sum(axis=1, dtype=np.int64).cumsum(axis=1)
    bins = (cumulated < quantile * cumulated[:, -1:]).sum(axis=1)
    return np.asarray(2.0 ** ((bins + 1 - _BINS // 2) / _BINS_PER_OCTAVE))
