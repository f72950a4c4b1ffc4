"""Which focal surface a run uses: asked for, the flight's ground, or searched by autofocus."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import Flight, FlightError
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.sweep import best_focus, focus_measure
from hsvaos.photos import Progress
from hsvaos.settings import FocusSettings
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain
from hsvaos.viewing import sized_view

_SEARCH_PX = 512
"""Longest side of the views that autofocus renders; more only costs time."""

_PLANES_AT_ONCE = 8

_MIN_SPREAD = 0.01
"""Spread of the cameras over their height below which there is no parallax to speak of."""

_WEAK = 0.5
"""Prominence below which a focus peak deserves a warning."""


def choose_surface(
    flight: Flight,
    settings: FocusSettings,
    integrators: Sequence[Integrator],
    progress: Progress | None = None,
) -> tuple[FocalSurface, tuple[str, ...]]:
    """Return the focal surface of a run, and what the user should know of the choice.

    In this order: the plane, terrain or autofocus that the settings ask for; the flight's own
    terrain; the flight's ground height; autofocus.

    Args:
        flight: The flight, with poses.
        settings: What is asked for.
        integrators: What autofocus looks at, see `autofocus`.
        progress: Told of every plane of an autofocus.

    Raises:
        FlightError: If the surface lies above all cameras, or a terrain cannot be read.
    """
    notes: list[str] = []
    surface: FocalSurface
    terrain = chosen_terrain(flight, settings)
    if settings.down_m is not None:
        surface = tilted_plane(flight, settings.down_m, settings)
    elif terrain is not None:
        origin = flight.origin
        place = (origin.lat_deg, origin.lon_deg, origin.height_m) if origin else None
        surface = shifted(FocalTerrain.from_file(Path(terrain), place), settings.offset_m)
    elif flight.ground_down_m is not None and not settings.autofocus:
        surface = tilted_plane(flight, flight.ground_down_m, settings)
    else:
        down, note = autofocus(flight, settings, integrators, progress)
        if not settings.autofocus:
            note += "; the flight does not say where its ground is: give --focus-down or --terrain"
        surface = tilted_plane(flight, down, settings)
        notes.append(note)
    notes += check_above(flight, surface)
    return surface, tuple(notes)


def chosen_terrain(flight: Flight, settings: FocusSettings) -> str | Path | None:
    """Return the terrain file that a run focuses on; None where that is a plane.

    Args:
        flight: The flight.
        settings: What is asked for.

    Raises:
        FlightError: If relief is asked for, and the flight brings a terrain of its own.
    """
    if settings.autofocus:
        return None
    if settings.terrain is not None:
        return settings.terrain
    if settings.down_m is not None or flight.terrain is None:
        return None
    if settings.relief:
        raise FlightError(
            f"{flight.source}: relief is found about a plane, but the flight brings its terrain "
            f"({flight.terrain}): expected --focus-down, --autofocus or no --relief"
        )
    return flight.terrain


def tilted_plane(flight: Flight, down_m: float, settings: FocusSettings) -> FocalPlane:
    """Return the focal plane at a depth, tilted as the settings say.

    Args:
        flight: The flight, with poses; the plane turns about the point below their middle.
        down_m: Down of that point [m].
        settings: Pitch and roll.
    """
    if settings.pitch_deg == 0.0 and settings.roll_deg == 0.0:
        return FocalPlane(down_m)
    north, east = flight.poses[:, :2, 3].mean(axis=0)
    slopes = np.tan(np.radians([settings.pitch_deg, -settings.roll_deg]))
    return FocalPlane(point=(north, east, down_m), normal=(*slopes, 1.0))


def shifted(terrain: FocalTerrain, offset_m: float) -> FocalTerrain:
    """Return a terrain moved downwards [m]."""
    if offset_m == 0.0:
        return terrain
    return replace(terrain, down_m=terrain.down_m + np.float32(offset_m))


def autofocus(
    flight: Flight,
    settings: FocusSettings,
    integrators: Sequence[Integrator],
    progress: Progress | None = None,
) -> tuple[float, str]:
    """Search the plane where small rare things are sharpest, from the centre frame's view.

    Args:
        flight: The flight.
        settings: Range and number of planes.
        integrators: What to look at, plain photos and their rarity weights: the one whose focus
            curve has the more prominent peak decides. Under thin crowns the photos themselves
            show small things best, under closed ones only what is rare gets through.
        progress: Told of every batch of planes.

    Returns:
        Down of the plane [m], and a line about it.

    Raises:
        ValueError: If the range makes no sense.
    """
    downs = search_planes(flight, settings)
    view = sized_view(flight, flight.centre_index, _SEARCH_PX)
    curves = np.zeros((len(integrators), len(downs)))
    for start in range(0, len(downs), _PLANES_AT_ONCE):
        part = slice(start, start + _PLANES_AT_ONCE)
        for curve, integrator in zip(curves, integrators, strict=True):
            curve[part] = focus_measure(*integrator.sweep(view, downs[part]))
        if progress is not None:
            progress("searching focus", min(part.stop, len(downs)), len(downs))
    down, prominence = clearest_focus(downs, curves)
    note = f"autofocus: focal plane at down = {down:.2f} m"
    if prominence < _WEAK:
        note += f" (a weak peak, {100 * prominence:.0f} % above its valleys: check it by a sweep)"
    return down, note


def clearest_focus(
    downs_m: NDArray[np.float64], curves: Iterable[NDArray[np.float64]]
) -> tuple[float, float]:
    """Return depth and prominence of the most prominent peak of several focus curves.

    Args:
        downs_m: Shape (D,), depths of the planes [m].
        curves: Shape (D,) each.
    """
    return max((best_focus(downs_m, curve) for curve in curves), key=lambda found: found[1])


def search_planes(flight: Flight, settings: FocusSettings) -> NDArray[np.float64]:
    """Return the depths of an autofocus, even in 1 / distance, as parallax is.

    The default range is 30 m around the flight's ground where that is known; else from half to
    eight times the length of the camera path below the lowest camera.

    Raises:
        ValueError: If the range is empty or lies above the cameras.
    """
    places = flight.poses[:, :3, 3]
    lowest, middle = float(places[:, 2].max()), float(places[:, 2].mean())
    length = float(np.linalg.norm(np.ptp(places, axis=0)))
    if flight.ground_down_m is not None:
        first = max(flight.ground_down_m - 30.0, 0.5 * (lowest + flight.ground_down_m))
        last = flight.ground_down_m + 30.0
    else:
        first, last = lowest + 0.5 * length, lowest + 8.0 * length
    first = first if settings.from_m is None else settings.from_m
    last = last if settings.to_m is None else settings.to_m
    if not lowest < first < last:
        raise ValueError(
            f"the search for focus must run downwards below the cameras (lowest at down = "
            f"{lowest:.2f} m), got from {first:.2f} m to {last:.2f} m"
        )
    nearness = np.linspace(1.0 / (first - middle), 1.0 / (last - middle), settings.steps)
    return np.asarray(middle + 1.0 / nearness)


def check_above(flight: Flight, surface: FocalSurface) -> list[str]:
    """Return a warning where some cameras lie below the focal surface.

    Raises:
        FlightError: If all of them do.
    """
    places = flight.poses[:, :3, 3]
    if isinstance(surface, FocalPlane):
        upwards = surface.normal if surface.normal[2] < 0.0 else -surface.normal
        heights = (places - surface.point) @ upwards
    else:
        heights = surface.lowest_m - places[:, 2]
    below = int((heights <= 0.0).sum())
    if below == len(places):
        raise FlightError(
            f"the focal surface lies above all {len(places)} cameras (they are between down = "
            f"{places[:, 2].min():.2f} m and {places[:, 2].max():.2f} m): down grows towards the "
            f"ground, give a larger one"
        )
    return [f"{below} of {len(places)} cameras lie below the focal surface"] if below else []


def without_parallax(flight: Flight, surface: FocalSurface) -> str | None:
    """Return a warning where all photos were taken from one place, else None.

    Trees are seen past only from several places: the cameras must be spread over at least a
    hundredth of their height above the surface.

    Args:
        flight: The flight, with poses.
        surface: The focal surface.
    """
    places = flight.poses[:, :3, 3]
    spread = float(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    if isinstance(surface, FocalPlane):
        height = float(np.abs((places - surface.point) @ surface.normal).max())
    else:
        height = float(np.abs(surface.lowest_m - places[:, 2]).max())
    if len(places) > 1 and spread >= _MIN_SPREAD * height:
        return None
    return (
        f"{len(places)} photo{'s' if len(places) > 1 else ''} from one place: nothing is seen past "
        f"the trees, and no finds are looked for"
    )
