"""What photos show of the ground, as contrasts that can be compared from photo to photo."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.photos import resized

MOST = 0.5
"""Contrasts are cut off at so much, either way."""

_SIGMAS = 6.0
"""So many deviations of a photo's ground are a contrast of 1."""

_SURROUND = 1.0 / 26.0
"""Radius (sigma) of what a pixel is compared with, as a share of the photo's longest side: shadows
and patches of litter are to be seen, and slow changes of light are not."""

_COARSE = 4
_LEAST = 0.01
_FLOOR = 0.01


def ground_contrast(
    photo: NDArray[Any], ground: NDArray[np.uint8], gains: NDArray[np.float64], white: float
) -> NDArray[np.float32]:
    """Return how much lighter each pixel is than the ground around it.

    The square root of lightness minus its mean over the ground around, in six standard deviations
    of that; other pixels have some value that means nothing.

    Args:
        photo: Shape (H, W, 3), RGB.
        ground: Shape (H, W), 255 = shows the ground.
        gains: Shape (3,), factors that level the photo.
        white: Value of full white.

    Returns:
        Shape (H, W), from -.5 to .5.
    """
    weight = ground.astype(np.float32) * np.float32(1.0 / 255.0)
    factors = (gains / (3.0 * white)).astype(np.float32)
    light = np.sqrt(cv2.transform(photo.astype(np.float32), factors[None]))
    lighter = light - _ground_mean(light, weight, 1.0)
    spread = np.sqrt(np.maximum(_ground_mean(lighter * lighter, weight, 2.0), 0.0))
    scale = np.float32(_SIGMAS) * (spread + np.float32(_FLOOR))
    return np.asarray(np.clip(lighter / scale, -MOST, MOST))


def _ground_mean(
    values: NDArray[np.float32], weight: NDArray[np.float32], radius: float
) -> NDArray[np.float32]:
    """Mean over the ground around each pixel; so smooth that a coarse copy is enough."""
    height, width = values.shape
    small = -(-width // _COARSE), -(-height // _COARSE)
    sigma = radius * _SURROUND * max(small)
    sums, total = (
        cv2.GaussianBlur(resized(part, *small), (0, 0), sigma) for part in (values * weight, weight)
    )
    mean = sums / np.maximum(total, np.float32(_LEAST))
    return np.asarray(cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR))
