"""Rays to a plane and to a height field against the NumPy twin."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.harness import Contenders, size
from hsvaos import FocalPlane, FocalTerrain, reference
from hsvaos.benchmark.scenes import lawnmower
from hsvaos.kernels.rays import focal_points


def plane() -> Contenders:
    _, _, view = lawnmower(1, size(1024))
    surface = FocalPlane(0.0)
    return {
        "hsvaos kernel": lambda: focal_points(view, surface),
        "NumPy twin": lambda: reference.focal_points(view, surface),
    }


def hills() -> FocalTerrain:
    axis = np.arange(-40.0, 40.5, 0.5)
    return FocalTerrain.from_arrays(axis, axis, np.sin(axis / 5.0)[:, None] * np.cos(axis / 7.0))


def terrain() -> Contenders:
    _, _, view = lawnmower(1, size(1024))
    surface, flat = hills(), FocalPlane(0.0)
    return {
        "hsvaos kernel": lambda: focal_points(view, surface),
        "  to a plane instead": lambda: focal_points(view, flat),
    }


def small_terrain() -> Contenders:
    _, _, view = lawnmower(1, size(96, 32))  # the twin's brute force allows no more
    surface = hills()
    return {
        "hsvaos kernel": lambda: focal_points(view, surface),
        "NumPy twin": lambda: reference.focal_points(view, surface),
    }


RACES = {
    "rays to a plane, 1 view": plane,
    "rays to a terrain, 1 view": terrain,
    "rays to a terrain, 96 x 96 px": small_terrain,
}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark(RACES[contender[0]]()[contender[1]])
