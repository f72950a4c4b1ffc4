"""Persons on the ground against those who lie there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.detect.detections import Person
from hsvaos.evaluate.detection import Matches
from hsvaos.evaluate.truth import TruthPerson

Array = NDArray[np.float64]


def match_persons(
    persons: Sequence[Person],
    people: Sequence[TruthPerson],
    radius_m: float,
    ignore: ArrayLike | None = None,
) -> tuple[Matches, Array]:
    """Match the persons found in one flight with the true ones, one to one.

    From the strongest down, each takes the nearest free true person within the radius; one that is
    to be ignored only where no other is there, and then counts neither way. A second find of the
    same person is a false alarm.

    Args:
        persons: What was found.
        people: Who lies there; the middle of the outline is the place.
        radius_m: Greatest horizontal distance of a match [m].
        ignore: Shape (T,), bool, true persons that need not be found.

    Returns:
        The matches, strongest first, and the horizontal distance [m] of each, NaN without one.

    Raises:
        ValueError: If the radius is not positive or a score or place is NaN.
    """
    if not radius_m > 0.0:
        raise ValueError(f"radius_m must be a positive length, got {radius_m!r}")
    skip = np.zeros(len(people), np.bool_) if ignore is None else np.asarray(ignore, np.bool_)
    if skip.shape != (len(people),):
        raise ValueError(f"ignore must have {len(people)} flags, got shape {skip.shape}")
    ranked = sorted(persons, key=lambda person: -person.score)
    scores = np.array([person.score for person in ranked], dtype=np.float64)
    found = np.array([[p.north_m, p.east_m] for p in ranked], dtype=np.float64).reshape(-1, 2)
    if np.isnan(scores).any() or np.isnan(found).any():
        raise ValueError("persons must have scores and places, got NaN")
    true = np.array([person.place for person in people], dtype=np.float64).reshape(-1, 2)
    away = np.linalg.norm(found[:, None] - true[None], axis=-1)
    truth = np.full(len(ranked), -1, np.int64)
    distance = np.full(len(ranked), np.nan)
    free = np.ones(len(people), np.bool_)
    for k in range(len(ranked)):
        near = free & (away[k] <= radius_m)
        if (near & ~skip).any():
            near &= ~skip
        if near.any():
            best = int(np.argmin(np.where(near, away[k], np.inf)))
            free[best] = False
            truth[k], distance[k] = best, away[k, best]
    ignored = np.zeros(len(ranked), np.bool_)
    ignored[truth >= 0] = skip[truth[truth >= 0]]
    return Matches(scores, truth, ignored, int((~skip).sum())), distance
