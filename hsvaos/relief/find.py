"""The relief of the ground under a flight: from a focal plane to a focal terrain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.flight import Flight, FlightError
from hsvaos.photos import Photos, Progress
from hsvaos.relief.agreement import CELL, measure_agreement
from hsvaos.relief.fit import fit_heights
from hsvaos.settings import FocusSettings
from hsvaos.surface import FocalPlane, FocalTerrain
from hsvaos.viewing import ground_grid, sees_horizon

_REACH = 0.065
"""Heights are looked for this far above and below the plane, as a share of the flight's height."""

_PLANES = 27

_POINT = 0.005
"""Distance of the grid's points, as a share of the flight's height: 10 cm from 20 m."""

_MOST_POINTS = 4_000_000

_SEEN = 0.02
"""Share of the ground whose height must be measured, or the plane is kept."""

_BEYOND = 6
"""Cells by which the terrain goes on beyond what the photos see of the plane."""


def wants_relief(settings: FocusSettings) -> bool:
    """Whether the relief is to be found about a plane, where the photos are looked into.

    Args:
        settings: How the focal surface is chosen.
    """
    return settings.down_m is None if settings.relief is None else settings.relief


def find_relief(
    photos: Photos,
    ground: NDArray[np.uint8],
    gains: NDArray[np.float64] | None,
    plane: FocalPlane,
    progress: Progress | None = None,
) -> tuple[FocalTerrain | None, str]:
    """Find how high the ground is above and below a focal plane.

    A plane sweep over the rays of the ground alone: where those of many photos agree, there the
    ground is. What too few rays reach is drawn through smoothly. The error on simulated flights of
    .25 m of relief is 3 to 7 cm in the median.

    Args:
        photos: RGB photos with poses.
        ground: Shape (N, h, w), how likely pixels show the ground, 255 = surely, from
            `FragmentNet.evidence`.
        gains: Shape (N, 3), factors that level the photos; None for none.
        plane: The focal plane, near the ground.
        progress: Told of photos and planes.

    Returns:
        The terrain, None where the plane is to be kept; and a line about it.
    """
    flight = photos.flight
    heights_m = (flight.poses[:, :3, 3] - plane.point) @ -_down(plane)
    height_m = float(np.median(heights_m))
    if height_m <= 0.0 or sees_horizon(flight):
        return None, "the relief of the ground is not looked for: photos look to the horizon"
    try:
        grid = _whole_cells(_grid(flight, plane, _POINT * height_m))
    except FlightError:
        return None, "the relief of the ground is not looked for: no photo looks down at it"
    offsets = np.linspace(-_REACH * height_m, _REACH * height_m, _PLANES)
    planes = [
        FocalPlane(point=plane.point + np.array([0, 0, d]), normal=plane.normal) for d in offsets
    ]
    agreement = measure_agreement(photos, ground, gains, grid, planes, offsets, progress)
    heights, sure = fit_heights(agreement)
    seen = agreement.power[_PLANES // 2] > 0.0
    share = float((sure[seen] > 0.5).mean()) if seen.any() else 0.0
    if share < _SEEN:
        return None, (
            f"the relief of the ground is not known: enough rays agree on only {100 * share:.1f} % "
            f"of it, the focal plane stands for it"
        )
    terrain = _terrain(grid, heights, plane)
    of_ground = heights[seen]
    return terrain, (
        f"relief of the ground: {-of_ground.max():+.2f} to {-of_ground.min():+.2f} m about the "
        f"focal plane, measured on {100 * share:.0f} % of what photos see of it"
    )


def _down(plane: FocalPlane) -> NDArray[np.float64]:
    return plane.normal if plane.normal[2] > 0.0 else -plane.normal


def _grid(flight: Flight, plane: FocalPlane, point_m: float) -> VirtualCamera:
    coarse = ground_grid(flight, plane, 8.0 * point_m)  # so coarse that no flight is too large
    points = 64.0 * coarse.width * coarse.height
    return ground_grid(flight, plane, point_m * max(1.0, float(np.sqrt(points / _MOST_POINTS))))


def _whole_cells(grid: VirtualCamera) -> VirtualCamera:
    width, height = (-(-side // CELL) * CELL for side in grid.size)
    north, east = grid.world_from_camera[:2, 3]
    return VirtualCamera.ortho(float(north), float(east), grid.gsd_m, width, height)


def _terrain(grid: VirtualCamera, heights: NDArray[np.float32], plane: FocalPlane) -> FocalTerrain:
    """Heights of cells about a plane as a terrain, going on level beyond them."""
    rows, columns = (np.arange(-_BEYOND, size + _BEYOND) for size in heights.shape)
    north0, east0 = grid.world_from_camera[:2, 3]
    middle = 0.5 * (CELL - 1)
    north = north0 - grid.gsd_m * (CELL * rows + middle)
    east = east0 + grid.gsd_m * (CELL * columns + middle)
    away = np.stack(np.meshgrid(north, east, indexing="ij"), axis=-1) - plane.point[:2]
    base = plane.point[2] - away @ plane.normal[:2] / plane.normal[2]
    return FocalTerrain.from_arrays(north, east, base + np.pad(heights, _BEYOND, mode="edge"))
