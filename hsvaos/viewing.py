"""Which virtual cameras a run renders."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.flight import Flight, FlightError
from hsvaos.settings import ViewSettings
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain

SEVERAL = "all", "cover"
"""What `view.frame` calls several views."""

_MAX_GRID_PX = 120_000_000
_DEFAULT_GRID_PX = 16_000_000
"""Pixels to which a grid is coarsened where no sampling distance is asked for."""

_REACH = 4.0
"""Ground farther away than this many heights is left out of the grid: a horizon has no end."""


_SQUARE_M = 1.0
_MOST_SQUARES = 20_000
"""More would take seconds in flights of hundreds of frames."""

_MARGIN_M = 0.9
"""Half a person: who lies at a border is not seen whole."""

_NOT_HELD = 0.02
"""Share of the ground that may be in none of the views: strips at the border of all."""


def choose_views(
    flight: Flight, settings: ViewSettings, surface: FocalSurface
) -> tuple[list[tuple[str, VirtualCamera]], int]:
    """Return names and virtual cameras to render, and the number of the one that pictures show.

    Args:
        flight: The flight, with poses.
        settings: What is asked for.
        surface: The focal surface, for the extent of the ground grid.

    Raises:
        FlightError: If a frame is not there or the grid would be too large.
    """
    if settings.frame == "ortho":
        return [("ortho", ground_grid(flight, surface, settings.gsd_m))], 0
    if settings.frame == "all":
        views = [(frame.name, flight.view(i)) for i, frame in enumerate(flight.frames)]
        return views, flight.centre_index
    if settings.frame == "cover":
        middle = flight.centre_index
        chosen = sorted([middle, *covering_poses(flight, surface, (middle,))])
        return [(flight.frames[i].name, flight.view(i)) for i in chosen], chosen.index(middle)
    centre = settings.frame in ("centre", "center")
    index = flight.centre_index if centre else flight.index(settings.frame)
    return [(flight.frames[index].name, flight.view(index))], 0


def sized_view(flight: Flight, index: int, longest_px: int) -> VirtualCamera:
    """Return the view at a frame's pose, shrunk to a longest side.

    Args:
        flight: The flight, with poses.
        index: Number of the frame.
        longest_px: Longest side; photos that are smaller keep their size [px].
    """
    view = flight.view(index)
    camera = flight.camera.without_distortion()
    factor = min(1.0, longest_px / max(camera.width, camera.height))
    size = (max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))
    return VirtualCamera(camera.scaled(*size), view.world_from_camera)


def ground_grid(flight: Flight, surface: FocalSurface, gsd_m: float | None) -> VirtualCamera:
    """Return the grid that covers what the photos see of the ground.

    Args:
        flight: The flight, with poses.
        surface: The focal surface; a terrain counts as level at its middle.
        gsd_m: Ground sampling distance [m]; by default the median one of the photos' centres,
            or coarser where the grid would have more than 16 million pixels.

    Raises:
        FlightError: If the photos see no ground, or the grid would have too many pixels.
    """
    level = _level(surface)
    outlines, heights = [], []
    for pose, slopes in zip(flight.poses, _border_slopes(flight), strict=True):
        height = level - pose[2, 3]
        if height <= 0.0:
            continue
        heights.append(height)
        away = slopes[np.isfinite(slopes).all(axis=1)]
        length = np.linalg.norm(away, axis=1, keepdims=True)
        away = height * away * np.minimum(1.0, _REACH / np.maximum(length, 1e-9))
        outlines.append(pose[:2, 3] + away)
    places = np.concatenate(outlines) if outlines else np.zeros((0, 2))
    if len(places) == 0:
        raise FlightError(f"{flight.source}: no photo looks down at the focal surface")
    (south, west), (north, east) = places.min(axis=0), places.max(axis=0)
    finest = float(np.median(heights)) / flight.camera.fx
    coarse = float(np.sqrt((north - south) * (east - west) / _DEFAULT_GRID_PX))
    gsd = gsd_m or max(finest, coarse)
    width, height_px = (int(np.ceil(side / gsd)) + 1 for side in (east - west, north - south))
    if width * height_px > _MAX_GRID_PX:
        raise FlightError(
            f"a ground grid of {north - south:.0f} m x {east - west:.0f} m at {gsd:.3f} m a pixel "
            f"has {width * height_px / 1e6:.0f} million pixels, more than "
            f"{_MAX_GRID_PX / 1e6:.0f} million: give a larger --gsd"
        )
    return VirtualCamera.ortho(float(north), float(west), gsd, width, height_px)


def covering_poses(flight: Flight, surface: FocalSurface, first: Sequence[int] = ()) -> list[int]:
    """Return the frames whose views, with some chosen before, hold what any frame's view holds.

    Greedily, each the one that adds most, until 98 % of the square metres of ground are held, half
    a person from a view's border. One view sees as much of a place as another: more add nothing.

    Args:
        flight: The flight, with poses.
        surface: The focal surface; a terrain counts as level at its middle.
        first: Numbers of frames chosen before.

    Returns:
        Numbers of the other frames, those that add most first.

    Raises:
        FlightError: If the photos see no ground.
    """
    places = _squares(flight, surface)
    held = np.array([_holds(flight.view(index), places) for index in range(len(flight))])
    whole = held.any(axis=0)
    missing = whole & ~held[list(first)].any(axis=0)
    others: list[int] = []
    while missing.sum() > _NOT_HELD * whole.sum():
        others.append(int((held & missing).sum(axis=1).argmax()))
        missing &= ~held[others[-1]]
    return others


def share_held(
    flight: Flight, surface: FocalSurface, views: Iterable[VirtualCamera]
) -> float | None:
    """Return the share of the ground in the views of all frames that some views hold, 0 to 1.

    Args:
        flight: The flight, with poses.
        surface: The focal surface; a terrain counts as level at its middle.
        views: The views; a ground grid holds everything.

    Returns:
        The share; None where the frames see no ground.
    """
    chosen = list(views)
    if any(view.is_ortho for view in chosen):
        return 1.0
    try:
        places = _squares(flight, surface)
    except FlightError:
        return None
    seen, held = (
        np.any([_holds(view, places) for view in some], axis=0)
        for some in ([flight.view(index) for index in range(len(flight))], chosen)
    )
    return float((seen & held).sum() / seen.sum()) if seen.any() else None


def _squares(flight: Flight, surface: FocalSurface) -> NDArray[np.float64]:
    """Shape (K, 3): places a metre apart, or more where that were too many, on the ground [m]."""
    fine = ground_grid(flight, surface, None)
    side = fine.gsd_m * np.sqrt(fine.width * fine.height / _MOST_SQUARES)
    grid = ground_grid(flight, surface, max(_SQUARE_M, float(side)))
    corner = grid.world_from_camera[:2, 3]
    rows, columns = (k.ravel().astype(np.float64) for k in np.indices((grid.height, grid.width)))
    north, east = corner[0] - grid.gsd_m * rows, corner[1] + grid.gsd_m * columns
    return np.stack([north, east, np.full(rows.size, _level(surface))], axis=1)


def _holds(view: VirtualCamera, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which places a view holds, with some distance to its border."""
    if view.camera is None:
        raise ValueError("expected the view of a frame, got a ground grid")
    ahead = (places - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, 2]
    margin = _MARGIN_M * view.camera.fx / np.maximum(ahead, 1e-6)
    u, v = view.project(places).T
    inside = (u >= margin) & (u <= view.width - 1.0 - margin)
    return np.asarray(inside & (v >= margin) & (v <= view.height - 1.0 - margin) & (ahead > 0.0))


def sees_horizon(flight: Flight) -> bool:
    """Whether a photo looks farther to the side than four times its height.

    Args:
        flight: The flight, with poses.
    """
    slopes = _border_slopes(flight)
    return not bool((np.linalg.norm(slopes, axis=2) <= _REACH).all())


def _border_slopes(flight: Flight) -> NDArray[np.float64]:
    """Shape (N, K, 2): metres north and east a metre of fall, of the rays of the photos' borders.

    NaN where a ray does not fall, or the lens knows none.
    """
    edge = _border(flight.camera.width, flight.camera.height)
    rays = flight.camera.back_project(edge) @ flight.poses[:, :3, :3].transpose(0, 2, 1)
    falling = np.isfinite(rays).all(axis=2) & (rays[..., 2] > 1e-3)
    return rays[..., :2] / np.where(falling, rays[..., 2], np.nan)[..., None]


def photo_sampling(flight: Flight, surface: FocalSurface) -> float | None:
    """Return the ground sampling distance of a flight's photos [m/px], the median of their centres.

    Args:
        flight: The flight, with poses.
        surface: The focal surface; a terrain counts as level at its middle.

    Returns:
        The distance; None where the surface has no level or no photo is above it.
    """
    try:
        heights = _level(surface) - flight.poses[:, 2, 3]
    except FlightError:
        return None
    above = heights[heights > 0.0]
    return float(np.median(above)) / flight.camera.fx if above.size else None


def _level(surface: FocalSurface) -> float:
    if isinstance(surface, FocalTerrain):
        return float(np.nanmedian(surface.down_m))
    if not isinstance(surface, FocalPlane) or abs(surface.normal[2]) < 1e-6:
        raise FlightError("a ground grid needs a focal surface that is not vertical")
    return float(surface.point @ surface.normal / surface.normal[2])


def _border(width: int, height: int) -> NDArray[np.float64]:
    x, y = np.linspace(-0.5, width - 0.5, 33), np.linspace(-0.5, height - 0.5, 33)
    left, top = np.full(33, -0.5), np.full(33, -0.5)
    right, bottom = np.full(33, width - 0.5), np.full(33, height - 0.5)
    sides = [(x, top), (x, bottom), (left, y), (right, y)]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])
