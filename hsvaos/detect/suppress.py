"""One box an object."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.detections import Detections

Array = NDArray[Any]

_MOST_CANDIDATES = 3000


def suppress(boxes: Array, scores: Array, iou: float | None, most: int) -> Detections:
    """Return people, strongest first; weaker boxes that overlap a stronger one are dropped.

    Args:
        boxes: Shape (N, 4), corners [px].
        scores: Shape (N,), 0..1.
        iou: Overlap (intersection over union) from which two boxes are one; None: never.
        most: People kept.
    """
    order = np.argsort(-scores, kind="stable")[: _MOST_CANDIDATES if iou is not None else most]
    boxes, scores = boxes[order].astype(np.float32), scores[order].astype(np.float32)
    if iou is not None and len(boxes):
        sizes = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)
        # as lists: OpenCV copies them anyway; it takes no score of 0
        found = cv2.dnn.NMSBoxes(sizes.tolist(), np.maximum(scores, 1e-6).tolist(), 0.0, iou)
        kept = np.asarray(found, np.int64).ravel()[:most]
        boxes, scores = boxes[kept], scores[kept]
    return Detections(boxes, scores, np.zeros(len(scores), np.int64))


def usable(boxes: Array, scores: Array, least: float) -> NDArray[np.bool_]:
    """Return which boxes are finite, not turned inside out, and score enough.

    Args:
        boxes: Shape (..., 4), corners [px].
        scores: Shape (...).
        least: Least score.
    """
    with np.errstate(invalid="ignore"):
        whole = np.isfinite(boxes).all(axis=-1) & np.isfinite(scores)
        straight = (boxes[..., 2] > boxes[..., 0]) & (boxes[..., 3] > boxes[..., 1])
        return np.asarray(whole & straight & (scores >= least))


def clipped(boxes: Array, scores: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Cut boxes off at the border of a view; those wholly beyond are dropped.

    Args:
        boxes: Shape (N, 4), corners with pixel k covering k to k + 1 [px].
        scores: Shape (N,).
        size: Height and width of the view [px].
    """
    sides = np.array([size[1], size[0]] * 2, np.float32)
    inside = np.clip(boxes, 0.0, sides)
    kept = (inside[:, 2] > inside[:, 0]) & (inside[:, 3] > inside[:, 1])
    return inside[kept], scores[kept]
