"""What the network for grey images sees: contrast against far and near surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.detect.contrast import local_contrast
from hsvaos.detect.surprise import surprise_of_contrasts

GREY_CHANNELS = ("contrast", "near contrast", "surprise")
"""Channels of the network's input, in order."""

_NEAR_PX = 49
"""Side of the near surround: warm slopes and the edges of photos are flat there."""

_LIMIT = 12.0
_UNIT = 0.25
_SURPRISE_UNIT = 0.5


def grey_input(image: ArrayLike, footprint: ArrayLike | None = None) -> NDArray[np.float32]:
    """Return the input of the person network for one grey integral image.

    No value depends on the exposure of the whole image, nor on its sampling distance.

    Args:
        image: Shape (H, W), any number type; NaN where nothing was seen.
        footprint: Shape (H, W), 0 where nothing was seen. None if unknown.

    Returns:
        Shape (3, H, W), float32, see `GREY_CHANNELS`: distance from the mean of a square of 129
        pixels and of one of 49, in deviations of the square, cut off at 12; and the surprise of the
        first (see `surprise`).

    Raises:
        ValueError: If a shape does not fit.
    """
    picture = np.asarray(image, dtype=np.float32)
    if picture.ndim != 2 or 0 in picture.shape:
        raise ValueError(f"image must have shape (H, W), got {picture.shape}")
    seen = np.isfinite(picture)
    if footprint is not None:
        rays = np.asarray(footprint)
        if rays.shape != picture.shape:
            raise ValueError(
                f"footprint must have the image's size {picture.shape}, got {rays.shape}"
            )
        seen &= rays > 0.0
    known = np.where(seen, picture, np.float32(0.0))[..., None]
    whole = np.empty((len(GREY_CHANNELS), *picture.shape), dtype=np.float32)
    whole[0:1] = local_contrast(known, seen)
    whole[1:2] = local_contrast(known, seen, _NEAR_PX)
    whole[2] = surprise_of_contrasts(whole[0:1], seen)
    np.clip(whole[:2], -_LIMIT, _LIMIT, out=whole[:2])
    whole[:2] *= np.float32(_UNIT)
    whole[2] *= np.float32(_SURPRISE_UNIT)
    return whole
