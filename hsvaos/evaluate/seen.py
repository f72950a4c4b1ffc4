"""How much ground the photos of a flight see."""

from __future__ import annotations

import numpy as np

from hsvaos.flight import Flight, FlightError
from hsvaos.report.ground import surface_down
from hsvaos.surface import FocalPlane, FocalSurface
from hsvaos.viewing import ground_grid

_CELLS = 40_000
"""Cells of the grid that is counted; an outline's error is a fraction of a cell: below 1 %."""


def ground_seen_ha(flight: Flight, surface: FocalSurface) -> float:
    """Return the area of the ground that at least one photo has in its picture [ha].

    Args:
        flight: The flight, with poses.
        surface: The focal surface; it counts as level at its typical height.

    Raises:
        FlightError: If the photos see no ground.
    """
    level = surface_down(surface)
    whole = ground_grid(flight, FocalPlane(level), None)
    cell_m = whole.gsd_m * float(np.sqrt(whole.width * whole.height / _CELLS))
    grid = ground_grid(flight, FocalPlane(level), cell_m)
    pixels = np.stack(np.meshgrid(np.arange(grid.width), np.arange(grid.height)), axis=-1)
    places, _ = grid.rays(pixels.reshape(-1, 2))
    places[:, 2] = level
    camera = flight.camera
    seen = np.zeros(len(places), np.bool_)
    for pose in flight.poses:
        left = np.flatnonzero(~seen)
        there = camera.project((places[left] - pose[:3, 3]) @ pose[:3, :3])
        with np.errstate(invalid="ignore"):  # NaN: behind the camera
            inside = (there >= -0.5) & (there <= (camera.width - 0.5, camera.height - 0.5))
        seen[left] = inside.all(axis=1)
    if not seen.any():
        raise FlightError(f"{flight.source}: no photo sees the ground at down {level:g} m")
    return float(seen.sum()) * cell_m**2 / 1e4
