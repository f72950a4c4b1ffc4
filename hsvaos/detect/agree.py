"""One opinion out of two looks at the same view: of two networks, or at two sizes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.detections import Detections
from hsvaos.detect.overlap import overlaps
from hsvaos.detect.suppress import suppress

_SAME = 0.1
"""Overlap from which boxes of the two mean the same: they place half hidden people differently."""

_SILENT = 0.35
"""What the second look counts as having said of a box that it does not give: doubt."""

_AT_A_LOSS = 0.5
"""The same for the first one, whose silence says nothing: the network for all images knows thermal
photos from simulated flights only, and at full size real ones are softer than anything drawn."""

_LENIENCE = 0.2
"""Added to the mean, in logits: two that half agree are surer than each alone. All of these were
chosen on one simulated thermal flight and on real ones (train/README.md)."""

_SUREST = 0.99


def agreed(first: Detections, second: Detections, iou: float, most: int) -> Detections:
    """Return the finds of two looks, their scores averaged as logits.

    Args:
        first: Finds of the one in a view, down to weak ones. Where both give a box, this one's is
            taken. What it does not give may be all the same.
        second: Finds of the other. What it does not give is doubted.
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
            _mean(first.scores, _partners(share, second.scores, _SILENT)),
            _mean(second.scores, _partners(share.T, first.scores, _AT_A_LOSS)),
        ]
    )
    return suppress(np.concatenate([first.boxes_xyxy, boxes]), scores, iou, most)


def _partners(
    share: NDArray[np.bool_], scores: NDArray[np.float32], silent: float
) -> NDArray[np.float64]:
    """Best score of the other's boxes that mean the same, or what its silence counts as."""
    best = np.where(share, scores, 0.0).max(axis=1, initial=0.0)
    return np.asarray(np.maximum(best, silent), dtype=np.float64)


def _mean(scores: NDArray[np.float32], partners: NDArray[np.float64]) -> NDArray[np.float64]:
    mean = 0.5 * (_logit(scores) + _logit(partners)) + _LENIENCE
    return np.asarray(1.0 / (1.0 + np.exp(-mean)))


def _logit(scores: NDArray[np.floating]) -> NDArray[np.float64]:
    inside = np.clip(np.asarray(scores, dtype=np.float64), 1.0 - _SUREST, _SUREST)
    return np.asarray(np.log(inside / (1.0 - inside)))
