"""Exposure and white balance levelled across the frames of a flight: per-channel gains."""

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.kernels.arrays import Stack, device_of, require_unit_range, valid_array
from hsvaos.kernels.device import bands, in_vectors, launch
from hsvaos.kernels.pixels import as_vec3

wp.set_module_options({"enable_backward": False})

_LEVELS = 1024
_QUANTILES = (0.25, 0.5, 0.75)
_MAX_GAIN = 2.0
"""A frame that would need more has another subject, not another exposure."""


@lru_cache
def _levels_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def channel_histogram_kernel(
        offset: int,
        band: int,
        white: float,
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        counts: wp.array3d(dtype=wp.int32),
    ):
        i = wp.tid() + offset
        if valid[i] == wp.uint8(0):
            return
        colour = as_vec3(rgb[i]) * (float(_LEVELS - 1) / white) + wp.vec3(0.5, 0.5, 0.5)
        for c in range(3):
            level = wp.clamp(int(colour[c]), 0, _LEVELS - 1)
            wp.atomic_add(counts, band, c, level, 1)

    return channel_histogram_kernel


def channel_quantiles(images: Any, *, valid: Any = None, device: Any = None) -> NDArray[np.float64]:
    """Return the quartiles of each channel of every image.

    Args:
        images: Shape (N, H, W, 3), RGB; uint8, uint16 or float32 (0..1).
        valid: Shape (H, W) or (N, H, W), uint8 or bool, pixels to use; None for all.
        device: Where to run; by default where the images lie.

    Returns:
        Shape (N, 3 quartiles, 3 channels), float64, 0..1; NaN where no pixel is valid.

    Raises:
        ValueError: If images or masks have the wrong shape.
        TypeError: If their type is not supported.
    """
    stack = Stack(images, device_of(images, device))
    stack.require_colour()
    require_unit_range(stack)
    masks = valid_array(valid, stack)
    counted = _count_bytes if stack.scalar is wp.uint8 and in_vectors(stack.device) else _count
    cumulated = counted(stack, masks).cumsum(axis=-1)
    total = cumulated[..., -1]
    rows = [(cumulated < q * total[..., None]).sum(axis=-1) for q in _QUANTILES]
    quartiles = np.stack(rows, axis=1) / (_LEVELS - 1.0)
    return np.where(total[:, None, :] > 0, quartiles, np.nan)


def _count(stack: Stack, masks: Any) -> NDArray[np.int64]:
    """Return how often each level occurs, shape (N, 3, 1024)."""
    shape = (stack.count, len(bands(stack.size, stack.device)), 3, _LEVELS)
    counts = wp.zeros(shape, dtype=wp.int32, device=stack.device)
    kernel = _levels_kernel(stack.pixel)
    for i in range(stack.count):
        inputs = [stack.white, stack.pixels[i], masks[i % masks.shape[0]], counts[i]]
        launch(kernel, stack.size, inputs, stack.device)
    return counts.numpy().sum(axis=1, dtype=np.int64)


def _count_bytes(stack: Stack, masks: Any) -> NDArray[np.int64]:
    """The same for bytes on the CPU, where OpenCV counts."""
    levels = (np.arange(256) * ((_LEVELS - 1.0) / 255.0) + 0.5).astype(int)
    counts = np.zeros((stack.count, 3, _LEVELS), np.int64)
    for i in range(stack.count):
        image = stack.array[i].numpy()
        valid = masks[i % masks.shape[0]].numpy().reshape(image.shape[:2])
        for c in range(3):
            counts[i, c, levels] = cv2.calcHist([image], [c], valid, [256], [0, 256]).ravel()
    return counts


def level_gains(quantiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the gains that bring every frame to the flight's exposure and white balance.

    For each channel the gain is the median, over the quartiles, of flight / frame, where the
    flight's quartile is the median of those of its frames; limited to [1/2, 2].

    Args:
        quantiles: Shape (N, Q, 3), from `channel_quantiles`.

    Returns:
        Shape (N, 3), float64.
    """
    usable = np.isfinite(quantiles).all(axis=(1, 2))
    gains = np.ones((len(quantiles), 3))
    if usable.any():
        flight = np.median(quantiles[usable], axis=0)
        ratios = np.maximum(flight, 1e-3) / np.maximum(quantiles[usable], 1e-3)
        gains[usable] = np.clip(np.median(ratios, axis=1), 1.0 / _MAX_GAIN, _MAX_GAIN)
    return gains
