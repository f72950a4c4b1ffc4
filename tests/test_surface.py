from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hsvaos.surface import FocalTerrain

DOWN = np.zeros((3, 2))


@pytest.mark.parametrize(
    ("corner", "kind", "message"),
    [
        ((math.nan, 0, 1), ValueError, "^north0_m must be finite, got nan"),
        ((0, math.inf, 1), ValueError, "^east0_m must be finite, got inf"),
        ((0, 0, math.nan), ValueError, "^spacing_m must be finite, got nan"),
        ((0, 0, 0), ValueError, "^spacing_m must be a positive distance, got 0"),
        (("0", 0, 1), TypeError, "^north0_m must be a number, got '0'"),
    ],
)
def test_bad_corners_are_named(corner: Any, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        FocalTerrain(*corner, DOWN)


@pytest.mark.parametrize(
    ("north", "east", "message"),
    [
        ([0, 1, 0], [0, 1], r"^north_m must rise or fall all along, got \[0"),
        ([0, 0, 0], [0, 0], "^north_m must rise or fall all along"),
        ([0, 1, math.nan], [0, 1], "^north_m must hold finite metres"),
        ([0, 1, 2], [0, math.inf], "^east_m must hold finite metres"),
        ([0, 1, 3], [0, 1], "^north_m and east_m must be evenly spaced"),
        ([0, 1, 2], [0, 2], "^north_m and east_m must be evenly spaced"),
    ],
)
def test_bad_axes_are_named(north: Any, east: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FocalTerrain.from_arrays(north, east, DOWN)


def test_falling_axes_are_turned() -> None:
    terrain = FocalTerrain.from_arrays([4, 2, 0], [1, 3], [[4, 5], [2, 3], [0, 1]])
    assert (terrain.north0_m, terrain.east0_m, terrain.spacing_m) == (0.0, 1.0, 2.0)
    np.testing.assert_array_equal(terrain.down_m, [[0, 1], [2, 3], [4, 5]])
