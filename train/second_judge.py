"""How well people are found after the second look, on tuning flights."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from hsvaos.detect.second_look import moved
from hsvaos.detect.suppress import clipped, suppress
from hsvaos.evaluate.detection import Matches
from train.judge import IOUS, NMS_IOU, matched_finds
from train.looks import Look, patches_of

PRECISION = 0.95
"""At the threshold, in a search."""

SEARCHED_SHARE = 0.6
"""People in a search, in those of a tuning flight."""

DOUBT = 0.05
"""Of the number of false finds, one-sided."""


def looked_again(net: nn.Module, look: Look) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return boxes and scores of a map's candidates after the second look, doubles dropped.

    Args:
        net: The network.
        look: The map.
    """
    logits, shifts = [np.zeros(0, np.float32)], [np.zeros((0, 4), np.float32)]
    for views, facts in patches_of(look):
        with torch.no_grad():
            found = net(torch.from_numpy(views), torch.from_numpy(facts))
        logits.append(found[0].numpy())
        shifts.append(found[1].numpy())
    scores = 1.0 / (1.0 + np.exp(-np.concatenate(logits)))
    placed = moved(look.boxes, np.concatenate(shifts))
    placed, scores = clipped(placed + np.float32(0.5), scores, look.rays.shape)
    kept = suppress(placed - np.float32(0.5), scores, NMS_IOU, len(scores))
    return kept.boxes_xyxy, kept.scores


def matched_again(net: nn.Module, looks: Sequence[Look]) -> dict[float, Matches]:
    """Return what is found after the second look, matched with the truth, by IoU threshold.

    Args:
        net: The network.
        looks: Of tuning flights.
    """
    parts: dict[float, list[Matches]] = {iou: [] for iou in IOUS}
    for look in looks:
        found = looked_again(net.eval(), look)
        rays = look.rays.astype(np.float32)
        for iou, own in matched_finds(*found, rays, look.people, look.reach, IOUS).items():
            parts[iou].append(own)
    return {iou: Matches.join(own) for iou, own in parts.items()}


def threshold_shift(matches: dict[float, Matches], threshold: float) -> float:
    """Return what to add to logits, so that a threshold gives a precision of .95 at IoU .25.

    Tuning flights hold more people than a search; false finds come with the forest, so with fewer
    people the same threshold has less precision. And they are few: their number is taken at the
    upper end of what it may be.

    Args:
        matches: From `matched_again`.
        threshold: The first network's, 0..1.
    """
    own = matches[0.25]
    best, least = -1.0, 0.5
    for score in np.unique(own.curve().scores)[::-1].tolist():
        counts = own.counts(score)
        right = SEARCHED_SHARE * counts.tp
        precision = right / max(right + most_expected(counts.fp), 1e-9)
        if precision >= min(best, PRECISION):
            best, least = precision, score
    return float(np.log(threshold / (1.0 - threshold)) - np.log(least / (1.0 - least)))


def most_expected(count: int, doubt: float = DOUBT) -> float:
    """Return the largest mean of which no more than so many events still come by chance.

    The upper limit of a Poisson mean (Garwood 1936), found by halving.

    Args:
        count: Events seen.
        doubt: Probability that no more come, one-sided.
    """
    low, high = 0.0, 10.0 * (count + 2.0)
    for _ in range(60):
        mean = 0.5 * (low + high)
        terms = [k * math.log(mean) - mean - math.lgamma(k + 1.0) for k in range(count + 1)]
        low, high = (mean, high) if sum(map(math.exp, terms)) > doubt else (low, mean)
    return 0.5 * (low + high)
