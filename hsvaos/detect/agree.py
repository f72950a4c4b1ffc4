"""One opinion out of two networks that look at the same view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.detections import Detections
from hsvaos.detect.overlap import overlaps
from hsvaos.detect.suppress import suppress

_SAME = 0.1
"""Overlap from which boxes of the two mean the same: they place half hidden people differently."""

_SILENT = 0.35
"""What a network counts as having said of a box that it does not give: no more than doubt."""

_LENIENCE = 0.2
"""Added to the mean, in logits: two that half agree are surer than each alone. This and the two
above were chosen on one simulated thermal flight (train/README.md)."""

_SUREST = 0.99


def agreed(first: Detections, second: Detections, iou: float, most: int) -> Detections:
    """Return the finds of two networks, their scores averaged as logits.

    Args:
        first: Finds of the one in a view, down to weak ones. Where both give a box, this one's is
            taken.
        second: Finds of the other.
        iou: Overlap from which two boxes are one person.
        most: People kept.

    Returns:
        Strongest first.
    """
    share = overlaps(first.boxes_xyxy, second.boxes_xyxy) > _SAME
    boxes = second.boxes_xyxy.copy()
    shared = share.any(axis=0)
    if shared.any():
        best = np.where(share, first.scores[:, None], -1.0).argmax(axis=0)
        boxes[shared] = first.boxes_xyxy[best[shared]]
    scores = np.concatenate(
        [
            _mean(first.scores, _partners(share, second.scores)),
            _mean(second.scores, _partners(share.T, first.scores)),
        ]
    )
    return suppress(np.concatenate([first.boxes_xyxy, boxes]), scores, iou, most)


def _partners(share: NDArray[np.bool_], scores: NDArray[np.float32]) -> NDArray[np.float64]:
    """Best score of the other network's boxes that mean the same."""
    best = np.where(share, scores, 0.0).max(axis=1, initial=0.0)
    return np.asarray(np.maximum(best, _SILENT), dtype=np.float64)


def _mean(scores: NDArray[np.float32], partners: NDArray[np.float64]) -> NDArray[np.float64]:
    mean = 0.5 * (_logit(scores) + _logit(partners)) + _LENIENCE
    return np.asarray(1.0 / (1.0 + np.exp(-mean)))


def _logit(scores: NDArray[np.floating]) -> NDArray[np.float64]:
    inside = np.clip(np.asarray(scores, dtype=np.float64), 1.0 - _SUREST, _SUREST)
    return np.asarray(np.log(inside / (1.0 - inside)))
