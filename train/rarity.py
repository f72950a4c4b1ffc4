"""How rare colours are in training flights, where people are many and photos few."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.kernels.rarity import rarity_model
from hsvaos.photos import Photos
from hsvaos.rarity_model import RarityModel, model_from_counts
from hsvaos.settings import Settings
from train.flights import by_visibility
from train.truth import outlines

_LEFT_OUT = 0.75
"""Share of the people whose colours are not counted as colours of the flight, in the first flights:
they become rarer than anybody is in a search."""

_SEARCH_PHOTOS = 117
_AS_COMMON = (0.35, 0.8)
"""How many people share a colour in a search, to those in a training flight; one of it drawn."""


def training_rarity(
    photos: Photos,
    truth: dict[str, Any],
    rng: np.random.Generator,
    gains: NDArray[np.float64] | None,
) -> RarityModel:
    """Return how rare colours are in a training flight.

    Training flights are short and crowded: counted whole, clothes would be as common as flowers. In
    a search there are few people on much more ground. In the first flights some people are not
    counted at all; in later ones (`train.flights.by_visibility`) each counts as in a search.

    Args:
        photos: The photos.
        truth: Of the flight.
        rng: Fresh from `train.truth.flight_truth`.
        gains: Factors that level the photos.
    """
    # drawn for later flights too: what rng gives next is that of the shipped weights' maps
    left_out = [outline for outline in outlines(truth) if rng.uniform() < _LEFT_OUT]
    seed = int(truth["settings"]["forest"]["seed"])
    if not by_visibility(seed):
        return rarity_without(photos, left_out, gains)
    share = len(photos.flight.poses) / _SEARCH_PHOTOS
    share *= float(np.random.default_rng([seed, 307]).uniform(*_AS_COMMON))
    whole, without = (rarity_without(photos, some, gains) for some in ([], outlines(truth)))
    counts = without.counts + share * (whole.counts - without.counts)
    return model_from_counts(np.rint(counts).astype(np.int64), **_rule(photos))


def rarity_without(
    photos: Photos, left_out: list[NDArray[np.float64]], gains: NDArray[np.float64] | None
) -> RarityModel:
    """Return the histogram of a flight that some people's outlines are kept out of.

    Args:
        photos: The photos.
        left_out: The outlines.
        gains: Factors that level the photos.
    """
    flight = photos.flight
    valid = np.full((len(flight.poses), *photos.images.shape[1:3]), 255, dtype=np.uint8)
    for pose, mask in zip(flight.poses, valid, strict=True):
        for outline in left_out:
            pixels = flight.camera.project((outline - pose[:3, 3]) @ pose[:3, :3])
            if np.isfinite(pixels).all():
                cv2.fillConvexPoly(mask, np.rint(pixels).astype(np.int32), 0)
    return rarity_model(photos.images, valid=valid, gains=gains, **_rule(photos))


def _rule(photos: Photos) -> dict[str, float]:
    rule = Settings().mask
    return {
        "threshold": rule.rarity_threshold if photos.is_colour else rule.grey_rarity_threshold,
        "exponent": rule.rarity_exponent,
        "smoothing_bins": rule.rarity_smoothing_bins,
    }
