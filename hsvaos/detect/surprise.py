"""How surprising each colour of an integral image is among all of them.

Rarity over the photos tells leaves from the rest; that rest is mostly bare ground, grass and
trunks, rare among leaves, but common on the ground. A person's colours are rare there too. So the
rarity of colours is asked for a second time, of the integral image itself: of its colours, and of
its contrasts, which no exposure changes. The one finds more of those few rays reach, the other more
of those in half shade.

With p the share of the pixels that are alike, the surprise of a pixel is log10(q / p), where
q = sum(p^2) is the mean of p over the pixels; 0 where p is greater.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.rarity_model import (
    CHROMA_BINS,
    LIGHTNESS_BINS,
    colour_bins,
    smoothed_planes,
)

MOST = 4.0
"""Powers of ten beyond which a colour is just very rare."""

_SMOOTHING_BINS = 0.7
_MEDIAN = 0.25
"""Brightness that the median pixel is brought to: no exposure is better than another."""

_CONTRAST_BINS = (16, 32, 32)
"""Of lightness, red against green, and yellow against blue."""

_HALF_WAY = 2.0
"""Contrast, in deviations, in the middle of the bins of one sign: greater ones lie ever closer."""


def surprise_of_colours(
    picture: NDArray[np.float32], seen: NDArray[np.bool_], *, among_alike: bool = False
) -> NDArray[np.float32]:
    """Return how much rarer each pixel's colour is than a typical one, in powers of ten.

    CIE Lab, bins as `rarity_model`.

    Args:
        picture: Shape (H, W, 3), RGB in any unit.
        seen: Shape (H, W), the pixels that count; others get 0.
        among_alike: Whether among pixels of the same lightness only.

    Returns:
        Shape (H, W), 0 to 4.
    """
    if not seen.any():
        return np.zeros(seen.shape, dtype=np.float32)
    # not max(axis=2): over a last axis of three that takes ten times as long
    brightest = np.maximum(np.maximum(picture[..., 0], picture[..., 1]), picture[..., 2])
    middle = float(np.median(brightest[seen])) or float(brightest[seen].max()) or 1.0
    unit = np.clip(picture * np.float32(_MEDIAN / middle), np.float32(0.0), np.float32(1.0))
    bins = colour_bins(cv2.cvtColor(unit, cv2.COLOR_RGB2Lab))
    planes = _counted(bins, seen, (LIGHTNESS_BINS, CHROMA_BINS, CHROMA_BINS))
    rare = np.stack([_rarer(plane) for plane in planes]) if among_alike else _rarer(planes)
    return np.asarray(rare.reshape(-1)[bins] * seen, dtype=np.float32)


def surprise_of_contrasts(
    contrast: NDArray[np.float32], seen: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return how much rarer each pixel's contrast is than a typical one, in powers of ten.

    Args:
        contrast: Shape (3, H, W), or (1, H, W) of grey, deviations from the surround in units of
            its standard deviation.
        seen: Shape (H, W), the pixels that count; others get 0.

    Returns:
        Shape (H, W), 0 to 4.
    """
    if not seen.any():
        return np.zeros(seen.shape, dtype=np.float32)
    if len(contrast) == 1:
        parts, sizes = [contrast[0]], (1, 1, 4 * _CONTRAST_BINS[1])
    else:
        red, green, blue = contrast
        yellow = np.float32(0.5) * (red + green)
        lightness = (red + green + blue) * np.float32(1.0 / 3.0)
        parts, sizes = [lightness, red - green, yellow - blue], _CONTRAST_BINS
    bins = np.zeros(seen.shape, dtype=np.int32)
    for part, size in zip(parts, sizes[-len(parts) :], strict=True):
        share = part / (np.float32(_HALF_WAY) + np.abs(part))
        bins = bins * size + ((share + np.float32(1.0)) * np.float32(0.5 * size)).astype(np.int32)
    rare = _rarer(_counted(bins, seen, sizes))
    return np.asarray(rare.reshape(-1)[bins] * seen, dtype=np.float32)


def _counted(
    bins: NDArray[np.int32], seen: NDArray[np.bool_], shape: tuple[int, int, int]
) -> NDArray[np.float64]:
    counts = np.bincount(bins[seen], minlength=int(np.prod(shape))).reshape(shape)
    return smoothed_planes(counts, _SMOOTHING_BINS)


def _rarer(counts: NDArray[np.float64]) -> NDArray[np.float32]:
    share = counts / max(float(counts.sum()), 1e-12)
    typical = max(float((share * share).sum()), 1e-12)
    return np.clip(np.log10(typical / np.maximum(share, 1e-12)), 0.0, MOST).astype(np.float32)
