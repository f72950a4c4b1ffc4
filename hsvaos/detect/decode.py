"""From the outputs of networks to boxes and scores of people, one function a layout.

Each takes the outputs by name, height and width of the input, and the numbers of the classes that
are people. It returns boxes, shape (B, N, 4), left, top, right, bottom in pixels of the input with
pixel k covering k to k + 1; and scores, shape (B, N), 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Decoded = tuple[Array, Array]
Decoder = Callable[[Mapping[str, Array], tuple[int, int], tuple[int, ...]], Decoded]

STRIDES = ((8, 16, 32), (8, 16, 32, 64))
"""Strides of the grids that YOLO heads have."""


def cells(size: tuple[int, int], strides: tuple[int, ...]) -> int:
    """Return the number of grid cells of a head.

    Args:
        size: Height and width of the input [px].
        strides: Of the grids [px].
    """
    return sum(-(-size[0] // s) * -(-size[1] // s) for s in strides)


def single(outputs: Mapping[str, Array]) -> Array:
    """Return the output that holds the boxes: the first of three dimensions."""
    return next(value for value in outputs.values() if value.ndim == 3)


def yolov8(outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]) -> Decoded:
    """Decode (B, 4 + classes, N): centre, size and class scores. Ultralytics v8 and v11."""
    raw = np.swapaxes(single(outputs), 1, 2)
    return from_centres(raw[..., :4]), _best(raw[..., 4:], people)


def yolov5(outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]) -> Decoded:
    """Decode (B, N, 5 + classes): centre, size, objectness and class scores. v5 and v7."""
    raw = single(outputs)
    return from_centres(raw[..., :4]), raw[..., 4] * _best(raw[..., 5:], people)


def end2end(
    outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]
) -> Decoded:
    """Decode (B, N, 6): corners, score and class, duplicates already removed."""
    raw = single(outputs)
    return raw[..., :4], _of_class(raw[..., 4], raw[..., 5], people)


def yolox(outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]) -> Decoded:
    """Decode YOLOX's raw grids (B, N, 5 + classes): offsets in cells and logarithms of sizes."""
    raw = single(outputs)
    strides = next((s for s in STRIDES if cells(size, s) == raw.shape[1]), None)
    if strides is None:
        raise ValueError(
            f"YOLOX: expected {cells(size, STRIDES[0])} boxes, one a cell of 8, 16 and 32 px, for "
            f"an input of {size[1]} x {size[0]} px, got {raw.shape[1]}"
        )
    corners, steps = [], []
    for s in strides:
        rows, columns = np.mgrid[0 : -(-size[0] // s), 0 : -(-size[1] // s)]
        corners.append(np.stack([columns.ravel(), rows.ravel()], axis=1))
        steps.append(np.full((rows.size, 1), s, np.float32))
    corner, step = np.concatenate(corners), np.concatenate(steps)
    sides = np.exp(np.minimum(raw[..., 2:4], 20.0)) * step
    boxes = from_centres(np.concatenate([(raw[..., :2] + corner) * step, sides], axis=-1))
    return boxes, raw[..., 4] * _best(raw[..., 5:], people)


def yolov4(outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]) -> Decoded:
    """Decode boxes (B, N, 1, 4), corners as shares of the input, and confs (B, N, classes)."""
    boxes = outputs["boxes"].reshape(*outputs["boxes"].shape[:2], 4)
    return boxes * _sides(size), _best(outputs["confs"], people)


def rfdetr(outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]) -> Decoded:
    """Decode RF-DETR's dets (B, N, 4), centre and size as shares, and labels, logits."""
    scores = 1.0 / (1.0 + np.exp(-outputs["labels"]))
    return from_centres(outputs["dets"]) * _sides(size), _best(scores, people)


def dfine(outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]) -> Decoded:
    """Decode D-FINE's boxes (B, N, 4), scores and labels; its sizes were those of the input."""
    return outputs["boxes"], _of_class(outputs["scores"], outputs["labels"], people)


def hsvaos(outputs: Mapping[str, Array], size: tuple[int, int], people: tuple[int, ...]) -> Decoded:
    """Decode our own boxes (B, N, 4), pixel centres at integers, and scores (B, N)."""
    return outputs["boxes"] + 0.5, outputs["scores"]


def from_centres(boxes: Array) -> Array:
    """Return corners of boxes that are given by centre and size.

    Args:
        boxes: Shape (..., 4), x and y of the centre, width and height.
    """
    half = boxes[..., 2:] / 2.0
    return np.concatenate([boxes[..., :2] - half, boxes[..., :2] + half], axis=-1)


def _sides(size: tuple[int, int]) -> Array:
    return np.array([size[1], size[0]] * 2, np.float32)


def _best(scores: Array, people: tuple[int, ...]) -> Array:
    best: Array = scores[..., list(people)].max(axis=-1)
    return best


def _of_class(scores: Array, labels: Array, people: tuple[int, ...]) -> Array:
    return np.where(np.isin(np.rint(labels), people), scores, 0.0)
