"""The focal terrain of a run: a picture of its heights, and a file that a run can start from."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np

from hsvaos.report import figures
from hsvaos.report.atomic import atomic_path
from hsvaos.report.draw import draw_scale_and_north
from hsvaos.report.figures import Rgba
from hsvaos.surface import FocalTerrain

_SHOWN_PX = 640
"""Longest side of the picture, about: heights are coarse, and more pixels show no more."""


def height_picture(terrain: FocalTerrain) -> tuple[Rgba, float, float]:
    """Return a map of heights, north up, in the colours of "viridis", and their range.

    Args:
        terrain: The terrain.

    Returns:
        Shape (H, W, 4), uint8 RGBA, transparent where the height is unknown; least and greatest
        height above down = 0 [m].
    """
    heights = -terrain.down_m[::-1]
    known = np.isfinite(heights)
    low, high = -terrain.lowest_m, -terrain.highest_m
    painted = figures.colour_map(np.where(known, heights, low), known, low, high, "viridis")
    factor = max(1, _SHOWN_PX // max(heights.shape))
    size = (factor * heights.shape[1], factor * heights.shape[0])
    large = np.asarray(cv2.resize(painted, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    return draw_scale_and_north(large, terrain.spacing_m / factor), low, high


def write_terrain(terrain: FocalTerrain, path: Path) -> Path:
    """Write north_m, east_m and down_m as .npz, which `--terrain` reads.

    Args:
        terrain: The terrain.
        path: The file.
    """
    rows, columns = terrain.down_m.shape
    north = terrain.north0_m + terrain.spacing_m * np.arange(rows)
    east = terrain.east0_m + terrain.spacing_m * np.arange(columns)
    with atomic_path(path) as temporary, io.FileIO(temporary, "w") as file:
        np.savez(file, north_m=north, east_m=east, down_m=terrain.down_m)
    return path
