"""A second look at what the person network gives as boxes.

The first network looks everywhere, at pictures of every kind. This one looks only at its boxes, at
a few metres around each, and only at views of which everything is known; it was trained on nothing
but what the first took for people, right or wrong, on flights that neither had seen. It says how
sure it is, and puts the box right.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.levels import LEVEL_CHANNELS
from hsvaos.detect.network import PERSON_SCORE, Network
from hsvaos.detect.network_input import CHANNELS
from hsvaos.detect.suppress import suppress, usable

Array = NDArray[Any]
Stacks = tuple[Array, ...]
"""Planes one after another, (C, H, W) each: those of the first network, and what comes to them."""

PACKAGED_SECOND_LOOK = Path(__file__).with_name("second_look.onnx")
"""Our own weights."""

SECOND_CHANNELS = (*CHANNELS, *LEVEL_CHANNELS)
"""What it sees: all that the first network may see, and the colours themselves."""

LOOK_PX = 80
"""Side of what is looked at [px]: 4 m at 5 cm a pixel."""

FLOOR = 0.12
"""Score of the first network from which a box gets a second look."""

SAME = 0.35
"""Overlap from which two of its boxes get one look."""

MOST = 150
"""Looks at a view."""

_BATCH = 32
_SIZE_UNIT_PX = 32.0


class SecondLook:
    """Scores boxes of the person network anew.

    Attributes:
        person_score: Score from which one counts for a person over all views of a flight; None: the
            one that the person network has.

    Args:
        model: ONNX file; by default our own weights.
        provider: "cuda", "tensorrt" or "cpu"; by default the first one that is here.
        threads: CPU threads that the network uses; by default one a core.

    Raises:
        ValueError: If the network cannot be read, or is none for a second look.
    """

    def __init__(
        self,
        model: str | Path | None = None,
        provider: str | None = None,
        threads: int | None = None,
    ) -> None:
        path = PACKAGED_SECOND_LOOK if model is None else model
        self._network = Network(path, provider, threads)
        named = self._network.metadata.get("channels", "")
        if named != ",".join(SECOND_CHANNELS):
            raise ValueError(
                f"{self._network.name}: expected a network for a second look, with the channels "
                f"SECOND_CHANNELS in its metadata, got {named or 'none'}"
            )
        self.person_score = self._network.threshold(PERSON_SCORE)

    def at(self, planes: Stacks, boxes: Array, scores: Array) -> tuple[Array, Array]:
        """Return what remains of the first network's boxes, put right, with new scores.

        Args:
            planes: Shapes (C, H, W), float32, together the 34 of `SECOND_CHANNELS`.
            boxes: Shape (N, 4), corners with pixel k covering k to k + 1 [px].
            scores: Shape (N,), of the first network, 0..1.

        Returns:
            Shape (M, 4) and (M,), float32.
        """
        good = usable(boxes, scores, FLOOR)
        weak = suppress(boxes[good] - 0.5, scores[good], SAME, MOST)
        placed, sure = self(planes, weak.boxes_xyxy, weak.scores)
        return placed + np.float32(0.5), sure

    def __call__(self, planes: Stacks, boxes: Array, scores: Array) -> tuple[Array, Array]:
        """Return boxes put right, and new scores.

        Args:
            planes: Shapes (C, H, W), float32, together the 34 of `SECOND_CHANNELS`.
            boxes: Shape (N, 4), corners, pixel centres at integers [px].
            scores: Shape (N,), of the first network, 0..1.

        Returns:
            Shape (N, 4) and (N,), float32.
        """
        placed = [np.zeros((0, 4), np.float32)]
        sure = [np.zeros(0, np.float32)]
        for first in range(0, len(boxes), _BATCH):
            some = slice(first, first + _BATCH)
            views = np.stack([patch(planes, box) for box in boxes[some]])
            found = self._network.run(
                {
                    self._network.picture.name: views,
                    "facts": facts_of(boxes[some], scores[some]),
                }
            )
            placed.append(moved(boxes[some], found["shifts"]))
            sure.append(found["scores"])
        return np.concatenate(placed), np.concatenate(sure)


def patch(planes: Stacks, box: Array, side: int = LOOK_PX) -> NDArray[np.float32]:
    """Return what lies around a box, and which pixels of it are in the box.

    Args:
        planes: Shapes (C, H, W), one after another; with zeros below and to the right or without.
        box: Corners, pixel centres at integers [px].
        side: Of the patch [px].

    Returns:
        Shape (C + 1, side, side); beyond the view everything is 0.
    """
    channels = sum(len(stack) for stack in planes)
    left, top = corner_of(box, side)
    out = np.zeros((channels + 1, side, side), dtype=np.float32)
    first = 0
    for stack in planes:
        height, width = stack.shape[1:]
        rows = slice(max(0, top), min(height, top + side))
        columns = slice(max(0, left), min(width, left + side))
        if rows.start < rows.stop and columns.start < columns.stop:
            part = stack[:, rows, columns]
            y, x = rows.start - top, columns.start - left
            own = slice(first, first + len(stack))
            out[own, y : y + part.shape[1], x : x + part.shape[2]] = part
        first += len(stack)
    at = np.arange(side, dtype=np.float32)
    inside_x = (at >= box[0] - left) & (at <= box[2] - left)
    inside_y = (at >= box[1] - top) & (at <= box[3] - top)
    out[channels] = inside_y[:, None] & inside_x[None, :]
    return out


def corner_of(box: Array, side: int) -> tuple[int, int]:
    """Return column and row at which a box's patch begins.

    Args:
        box: Corners [px].
        side: Of the patch [px].
    """
    middle = 0.5 * (np.asarray(box[:2]) + np.asarray(box[2:])) - 0.5 * (side - 1)
    left, top = np.rint(middle).astype(int).tolist()
    return left, top


def facts_of(boxes: Array, scores: Array) -> NDArray[np.float32]:
    """Return what else the network is told of boxes: logit of the score, and logarithms of sides.

    Args:
        boxes: Shape (N, 4) [px].
        scores: Shape (N,), 0..1.

    Returns:
        Shape (N, 3), float32.
    """
    inside = np.clip(scores, 1e-4, 1.0 - 1e-4)
    sides = np.maximum(boxes[:, 2:] - boxes[:, :2], 1.0) / _SIZE_UNIT_PX
    return np.column_stack([np.log(inside / (1.0 - inside)), np.log(sides)]).astype(np.float32)


def moved(boxes: Array, shifts: Array) -> NDArray[np.float32]:
    """Return boxes moved and scaled as the network says.

    Args:
        boxes: Shape (N, 4), corners [px].
        shifts: Shape (N, 4): of the centre, in sides of the box, and logarithms of the factors of
            the sides.
    """
    sides = boxes[:, 2:] - boxes[:, :2]
    middle = 0.5 * (boxes[:, :2] + boxes[:, 2:]) + shifts[:, :2] * sides
    half = 0.5 * sides * np.exp(np.clip(shifts[:, 2:], -1.5, 1.5))
    return np.concatenate([middle - half, middle + half], axis=1).astype(np.float32)
