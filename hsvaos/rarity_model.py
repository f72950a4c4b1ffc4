"""The colour histogram of a flight, and the weight of each of its colours."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

LIGHTNESS_BINS = 10
CHROMA_BINS = 40
CHROMA_RANGE = 48.0
"""Chroma coordinates 40 a / L and 40 b / L beyond this fall into the outermost bins."""

LIGHTNESS_FLOOR = 8.0
"""L below which chroma is not scaled up further: what is nearly black has noise for a colour."""

GREY_BINS = 256


@dataclass(frozen=True, eq=False)
class RarityModel:
    """The colour histogram of a flight and the weight of each of its bins.

    Args:
        counts: Shape (10, 40, 40) of lightness, a and b bins, or (256,) of grey levels; int64.
        probability: Same shape, float64, smoothed; p(chroma | lightness), or p(grey level).
        weights: Same shape, float32, min(1, (p0 / p)^exponent), 0..1.
        threshold: p0, in the probability of one bin.
        exponent: Of the weight.
    """

    counts: NDArray[np.int64]
    probability: NDArray[np.float64]
    weights: NDArray[np.float32]
    threshold: float
    exponent: float

    @property
    def is_grey(self) -> bool:
        """Whether the model is one of grey levels."""
        return self.counts.ndim == 1


def colour_bins(lab: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the bin of colours in a histogram of shape (10, 40, 40), laid flat.

    Args:
        lab: Shape (..., 3), CIE Lab, L 0..100.
    """
    scale = np.float32(40.0) / np.maximum(lab[..., 0], np.float32(LIGHTNESS_FLOOR))
    per_bin = np.float32(CHROMA_BINS / (2.0 * CHROMA_RANGE))
    middle = np.float32(0.5 * CHROMA_BINS)
    level = (lab[..., 0] * np.float32(LIGHTNESS_BINS / 100.0)).astype(np.int32)
    bins = np.clip(level, 0, LIGHTNESS_BINS - 1)
    for channel in (1, 2):
        chroma = (lab[..., channel] * (scale * per_bin) + middle).astype(np.int32)
        bins = bins * CHROMA_BINS + np.clip(chroma, 0, CHROMA_BINS - 1)
    return np.asarray(bins, dtype=np.int32)


def model_from_counts(
    counts: NDArray[np.int64], threshold: float | None, exponent: float, smoothing_bins: float
) -> RarityModel:
    """Return the model of a histogram: smoothed, normalised for each lightness, made a weight.

    Args:
        counts: Shape (10, 40, 40) or (256,), int64.
        threshold: See `rarity_model`.
        exponent: See `rarity_model`.
        smoothing_bins: See `rarity_model`.
    """
    if threshold is None:
        threshold = 2e-4 if counts.ndim == 3 else 2e-4 * CHROMA_BINS**2 / GREY_BINS
    planes = smoothed_planes(counts, smoothing_bins)
    total = planes.sum(axis=(1, 2), keepdims=True)
    probability = (planes / np.maximum(total, 1.0)).reshape(counts.shape)
    ratio = threshold / np.maximum(probability, threshold)
    weights = (ratio**exponent).astype(np.float32)
    return RarityModel(counts, probability, weights, threshold, exponent)


def smoothed_planes(counts: NDArray[np.int64], smoothing_bins: float) -> NDArray[np.float64]:
    """Return a histogram as planes of equal lightness, each smoothed in chroma.

    Args:
        counts: Shape (10, 40, 40), or (256,) of grey levels, which make one plane of one row.
        smoothing_bins: Sigma of the Gaussian [bins].

    Returns:
        Shape (10, 40, 40) or (1, 1, 256), float64.
    """
    planes = counts.astype(np.float64).reshape(-1, *(counts.shape[1:] or (1, counts.size)))
    if smoothing_bins <= 0.0:
        return planes
    border = cv2.BORDER_REPLICATE
    return np.stack(
        [cv2.GaussianBlur(p, (0, 0), smoothing_bins, borderType=border) for p in planes]
    )
