"""How surprising each colour of an integral image is among all of them.

Rarity over the photos tells leaves from the rest; that rest is mostly bare ground, grass and
trunks, rare among leaves, but common on the ground. A person's colours are rare there too. So the
rarity of colours is asked for a second time, of the integral image itself.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.rarity_model import (
    CHROMA_BINS,
    GREY_BINS,
    LIGHTNESS_BINS,
    colour_bins,
    smoothed_planes,
)

MOST = 4.0
"""Powers of ten beyond which a colour is just very rare."""

_SMOOTHING_BINS = 0.7
_MEDIAN = 0.25
"""Brightness that the median pixel is brought to: no exposure is better than another."""


def surprise(
    picture: NDArray[np.float32], seen: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return how much rarer each pixel's colour is than a typical one, in powers of ten.

    With p the share of the pixels that have the colour (CIE Lab, bins as `rarity_model`), the
    surprise is log10(q / p), where q = sum(p^2) is the mean of p over the pixels; 0 where the
    colour is more frequent than that.

    Args:
        picture: Shape (H, W, 3) RGB or (H, W, 1) grey, in any unit.
        seen: Shape (H, W), the pixels that count; others get 0.

    Returns:
        Two maps, shape (H, W), 0 to 4: of colour and lightness together, and of colour among
        pixels of the same lightness (of grey levels, twice the same).
    """
    nothing = np.zeros(seen.shape, dtype=np.float32)
    if not seen.any():
        return nothing, nothing
    brightest = picture.max(axis=2) if picture.shape[2] > 1 else picture[..., 0]
    middle = float(np.median(brightest[seen]))
    if not middle > 0.0:
        middle = float(brightest[seen].max()) or 1.0
    unit = np.clip(picture * np.float32(_MEDIAN / middle), np.float32(0.0), np.float32(1.0))
    shape: tuple[int, ...]
    if picture.shape[2] == 3:
        bins = colour_bins(cv2.cvtColor(unit, cv2.COLOR_RGB2Lab))
        shape = (LIGHTNESS_BINS, CHROMA_BINS, CHROMA_BINS)
    else:
        bins = (unit[..., 0] * np.float32(GREY_BINS - 1) + np.float32(0.5)).astype(np.int32)
        shape = (GREY_BINS,)
    counts = np.bincount(bins[seen], minlength=int(np.prod(shape))).reshape(shape)
    planes = smoothed_planes(counts, _SMOOTHING_BINS)
    together = _rarer(planes / planes.sum())
    alike = np.stack([_rarer(plane / max(float(plane.sum()), 1e-12)) for plane in planes])
    known = seen.astype(np.float32)
    return together.reshape(-1)[bins] * known, alike.reshape(-1)[bins] * known


def _rarer(share: NDArray[np.float64]) -> NDArray[np.float32]:
    typical = float((share * share).sum())
    ratio = max(typical, 1e-12) / np.maximum(share, 1e-12)
    return np.clip(np.log10(ratio), 0.0, MOST).astype(np.float32)
