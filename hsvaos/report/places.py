"""Where persons are in a picture, and which of them a box shows there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Person

Matrix = NDArray[np.float64]


def places_of(view: VirtualCamera, persons: Sequence[Person]) -> Matrix:
    """Return the pixels at which persons are in a view.

    Args:
        view: The view.
        persons: On the ground.

    Returns:
        Shape (N, 2); NaN for whom the view does not hold.
    """
    world = [(one.north_m, one.east_m, one.down_m) for one in persons]
    places = view.project(np.array(world, dtype=np.float64).reshape(-1, 3))
    with np.errstate(invalid="ignore"):
        held = (places >= -0.5) & (places < np.array([view.width, view.height]) - 0.5)
    return np.where(held.all(axis=1, keepdims=True), places, np.nan)


def box_around(places: Matrix, boxes: NDArray[Any]) -> NDArray[np.int64]:
    """Return the first box in which each place is, -1 where there is none.

    Args:
        places: Shape (N, 2) [px].
        boxes: Shape (M, 4), corners [px].
    """
    found = np.full(len(places), -1, dtype=np.int64)
    for number, (left, top, right, bottom) in reversed(list(enumerate(boxes.tolist()))):
        x, y = places[:, 0], places[:, 1]
        found[(x >= left) & (x <= right) & (y >= top) & (y <= bottom)] = number
    return found
