"""What the person network sees: contrast against the surroundings, colour by colour.

The same lines prepare integral images for training and for finding people.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

CHANNELS = ("red", "green", "blue", "plain red", "plain green", "plain blue", "rarity", "rays")
"""Channels of the network's input, in order."""

TRAINED_GSD_M = (0.045, 0.09)
"""Ground sampling distances [m/px] between which the network was trained."""

_SURROUND_PX = 129
"""Side of the surround: some three times a lying person at the finest sampling trained for."""

_CLIP = 3.0
"""Deviations beyond which a value counts no more in its own surround."""

_CLIPPINGS = 2

_LIMIT = 8.0
"""Contrast is cut off there: a lamp must not drown a person beside it."""

_UNIT = 0.25
"""Brings contrast to about the range -1..1 that networks like."""

_LEAST_DEVIATION = 0.1
"""In medians of the deviation over the image: flat surroundings must not show noise as contrast."""


def network_input(
    image: ArrayLike,
    footprint: ArrayLike | None = None,
    rarity: ArrayLike | None = None,
    plain: ArrayLike | None = None,
) -> NDArray[np.float32]:
    """Return the input of the person network for one integral image.

    Every pixel becomes its distance from the mean of its surround, a square of 129 pixels, in
    deviations of that surround, one deviation for the three colours together so that hue stays.
    Mean and deviation are those of the values clipped at 3 deviations. No value depends on the
    exposure of the whole image. What is not known is 0.

    Args:
        image: Shape (H, W, 3) RGB or (H, W) grey, any number type; NaN where nothing was seen. The
            integral image, weighted by rarity, hue or not at all.
        footprint: Shape (H, W), how many rays each pixel has seen; 0 where none. None if unknown.
        rarity: Shape (H, W), the rarity map. None if unknown.
        plain: Shape (H, W, 3) or (H, W), the plain mean of all rays. By default the image.

    Returns:
        Shape (8, H, W), float32, see `CHANNELS`.

    Raises:
        ValueError: If a shape does not fit.
    """
    picture, seen = _picture(image, "image")
    size = picture.shape[:2]
    rays = _fitting(footprint, size, "footprint")
    if rays is not None:
        seen &= rays > 0.0
    whole = np.zeros((len(CHANNELS), *size), dtype=np.float32)
    whole[0:3] = _contrast(picture, seen)
    if plain is None:
        whole[3:6] = whole[0:3]
    else:
        second, known = _picture(plain, "plain")
        if second.shape[:2] != size:
            raise ValueError(f"plain must have the image's size {size}, got {second.shape[:2]}")
        whole[3:6] = _contrast(second, known if rays is None else known & (rays > 0.0))
    rare = _fitting(rarity, size, "rarity")
    if rare is not None:
        known = np.isfinite(rare) & (seen if rays is None else rays > 0.0)
        whole[6] = _contrast(np.where(known, rare, 0.0)[..., None], known)[0]
    if rays is not None:
        whole[7] = np.log1p(np.maximum(np.nan_to_num(rays, nan=0.0), 0.0)) / 4.0
    return whole


def _picture(values: Any, name: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return (H, W, 3), or (H, W, 1) of grey, without NaN, and where it was seen."""
    picture = np.asarray(values, dtype=np.float32)
    if picture.ndim == 2:
        picture = picture[..., None]
    if picture.ndim != 3 or picture.shape[2] not in (1, 3) or 0 in picture.shape:
        raise ValueError(
            f"{name} must have shape (H, W, 3) or (H, W), got {np.asarray(values).shape}"
        )
    seen = np.asarray(np.isfinite(picture).all(axis=2))
    kept = np.where(seen[..., None], picture, np.float32(0.0))
    return np.asarray(kept, dtype=np.float32), seen


def _fitting(values: Any, size: tuple[int, ...], name: str) -> NDArray[np.float32] | None:
    if values is None:
        return None
    plane = np.asarray(values, dtype=np.float32)
    if plane.shape != size:
        raise ValueError(f"{name} must have the image's size {size}, got {plane.shape}")
    return plane


def _contrast(picture: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the local contrast of (H, W, C) as (C, H, W), or of grey as (1, H, W)."""
    if not seen.any():
        return np.zeros((picture.shape[2], *picture.shape[:2]), dtype=np.float32)
    known = seen.astype(np.float32)
    # a shift of the origin keeps the sums of squares exact
    offset = picture[seen].mean(axis=0)
    values = (picture - offset) * known[..., None]
    share = np.maximum(_mean(known), 1e-6)

    def moments(part: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        centre = np.asarray(_mean(part) / share[..., None], dtype=np.float32)
        square = _mean(np.square(part).sum(axis=2)) / share
        variance = (square - np.square(centre).sum(axis=2)) / part.shape[2]
        return centre, np.sqrt(np.maximum(variance, 0.0), dtype=np.float32)

    centre, deviation = moments(values)
    for _ in range(_CLIPPINGS):
        reach = (_CLIP * deviation)[..., None]
        clipped = np.clip(values, centre - reach, centre + reach) * known[..., None]
        centre, deviation = moments(clipped)
    typical = float(np.median(deviation[seen]))
    least = max(_LEAST_DEVIATION * typical, 1e-6 * float(np.abs(offset).max()), 1e-12)
    z = (values - centre) / np.maximum(deviation, least)[..., None]
    z = np.clip(z, -_LIMIT, _LIMIT) * (known[..., None] * np.float32(_UNIT))
    return np.ascontiguousarray(np.moveaxis(z, 2, 0), dtype=np.float32)


def _mean(part: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return box means; what lies outside the picture counts as 0."""
    box = (_SURROUND_PX, _SURROUND_PX)
    mean = cv2.boxFilter(part, cv2.CV_32F, box, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(mean, dtype=np.float32).reshape(part.shape)
