from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hsvaos
from hsvaos.camera import Camera, VirtualCamera, check_pose
from hsvaos.flight import FlightError

EYE = np.eye(4)
INF, NAN = math.inf, math.nan


def moved(north_m: float) -> Any:
    pose = np.eye(4)
    pose[0, 3] = north_m
    return pose


BAD: dict[str, tuple[Callable[[], Any], type[Exception], str]] = {
    "infinite width": (lambda: Camera(INF, 4, 5, 5, 2, 2), ValueError, "^width must be .* got inf"),
    "NaN width": (lambda: Camera(NAN, 4, 5, 5, 2, 2), ValueError, "^width must be .* got nan"),
    "half a row": (lambda: Camera(4, 3.5, 5, 5, 2, 2), ValueError, "^height must be .* got 3.5"),
    "width of text": (lambda: Camera("4", 4, 5, 5, 2, 2), TypeError, "^width must be .* got '4'"),
    "focal length of text": (lambda: Camera(4, 4, "5", 5, 2, 2), TypeError, "^fx must be a num"),
    "no focal length": (lambda: Camera(4, 4, 0, 5, 2, 2), ValueError, "^fx must be a positive"),
    "NaN centre": (lambda: Camera(4, 4, 5, 5, NAN, 2), ValueError, "^cx must be finite, got nan"),
    "no distortion": (lambda: Camera(4, 4, 5, 5, 2, 2, None), ValueError, "^distortion must be 5"),
    "fov of text": (lambda: Camera.from_fov(4, 4, "50"), TypeError, "^fov_deg must be a number"),
    "fov too wide": (lambda: Camera.from_fov(4, 4, 180), ValueError, "^fov_deg must lie between"),
    "width of a fov": (lambda: Camera.from_fov("4", 4, 50), TypeError, "^width must be"),
    "view by text": (lambda: VirtualCamera("x", EYE), TypeError, "^camera must be a Camera, got"),
    "view by nothing": (lambda: VirtualCamera(None, EYE), ValueError, "^gsd_m of a view without"),
    "view without size": (lambda: VirtualCamera(None, EYE, 0.1), ValueError, "^width must be"),
    "pose of text": (
        lambda: VirtualCamera(Camera.from_fov(4, 4, 50), "x"),
        ValueError,
        "^world_from_camera must be a 4x4 matrix of numbers, got 'x'",
    ),
    "grid of 3.7": (lambda: VirtualCamera.ortho(0, 0, 1, 3.7, 3), ValueError, "^width .* got 3.7"),
    "grid at NaN": (lambda: VirtualCamera.ortho(NAN, 0, 1, 3, 3), ValueError, "^north0 must be"),
    "gsd of text": (lambda: VirtualCamera.ortho(0, 0, "1", 3, 3), TypeError, "^gsd_m must be a"),
    "gsd of 0": (lambda: VirtualCamera.ortho(0, 0, 0, 3, 3), ValueError, "^gsd_m must be a pos"),
    "far away": (
        lambda: check_pose(moved(1e12), "p"),
        ValueError,
        "within 10000 km .*1e.09 km",
    ),
    "farther": (
        lambda: check_pose(moved(1e300), "p"),
        ValueError,
        "within 10000 km of the origin",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_are_named(case: str) -> None:
    call, kind, message = BAD[case]
    with pytest.raises(kind, match=message):
        call()


def test_numbers_of_numpy_are_taken() -> None:
    camera = Camera(np.int64(4), 4.0, np.float32(5), 5, 2, 2, np.zeros(5))
    assert (type(camera.width), type(camera.height), type(camera.fx)) == (int, int, float)
    assert VirtualCamera.ortho(0, 0, 1, np.int32(3), 2).size == (3, 2)
    np.testing.assert_array_equal(check_pose(moved(-9.9e6), "pose"), moved(-9.9e6))


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"camera": "x"}, TypeError, "^camera must be a Camera, got 'x'"),
        ({"fov_deg": "50"}, TypeError, "^fov_deg must be a number, got '50'"),
        ({"fov_deg": NAN}, FlightError, "^fov_deg must be finite, got nan"),
        ({"fov_deg": 200}, FlightError, "^fov_deg must lie between 0 and 180 degrees, got 200"),
        ({"ground_down_m": NAN}, FlightError, "^ground_down_m must be finite, got nan"),
    ],
)
def test_bad_arguments_of_open_flight(
    tmp_path: Path, options: dict[str, Any], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        hsvaos.open_flight(tmp_path, **options)
