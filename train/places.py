"""Where people lie in training flights: anywhere, or by how much of the ground photos see there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hsvaos.simulate.clothes import OUTFITS
from hsvaos.simulate.forest import grow_forest
from hsvaos.simulate.mission import fly
from hsvaos.simulate.occlusion import smooth, visibility_map
from hsvaos.simulate.settings import SimulationSettings
from hsvaos.simulate.simulation import camera_poses

_PEOPLE = 26
_APART_M = 2.7

_CLASSES = {"bush": 0.4, "half": 0.3, "full": 0.15, "open": 0.15}
"""Share of each occlusion class that is asked for; bushes and crowns take many of the reached."""

_SEEN = {"bush": (0.45, 1.0), "half": (0.15, 0.7), "full": (0.06, 0.13), "open": (0.85, 1.0)}
"""Share of the photos' pixels that show the ground there."""

_SMOOTHED_M = 0.55
_FROM_STEMS_M = 0.8
_PHOTOS_LOOKED_AT = 27


def blind_places(rng: np.random.Generator, half: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Return places drawn without a look at the forest, north and east [m].

    Args:
        rng: Draws them.
        half: Half sides of the ground, north and east [m].
    """
    chosen: list[np.ndarray] = []
    for place in rng.uniform(-half, half, (40 * _PEOPLE, 2)):
        if all(np.hypot(*(place - other)) > _APART_M for other in chosen):
            chosen.append(place)
        if len(chosen) == _PEOPLE:
            break
    return tuple((float(n), float(e)) for n, e in chosen)


def placed_by_visibility(drawn: SimulationSettings) -> SimulationSettings:
    """Lay people where as much of the ground is seen as their classes ask for.

    Args:
        drawn: Settings of a flight; who lies where in them does not count.
    """
    settings = drawn.fitted()
    rng = np.random.default_rng([settings.seed, 306])
    forest = grow_forest(settings.forest)
    poses = camera_poses(fly(settings.mission, settings.seed))
    some = np.unique(np.linspace(0, len(poses) - 1, _PHOTOS_LOOKED_AT).round().astype(int))
    half = np.array(settings.mission.half_m) + 3.0
    chart = visibility_map(forest.scene(), settings.camera, poses[some], float(half.max()) + 3.0)
    seen = smooth(chart, _SMOOTHED_M)
    axis = (np.arange(len(seen)) + 0.5) * chart.cell_m - chart.half_m
    north, east = np.meshgrid(axis, axis, indexing="ij")
    free = (np.abs(north) <= half[0]) & (np.abs(east) <= half[1]) & np.isfinite(seen)
    for stem_north, stem_east, _ in forest.stems:
        free &= np.hypot(north - stem_north, east - stem_east) > _FROM_STEMS_M
    classes, places = [], []
    for name in rng.choice(list(_CLASSES), _PEOPLE, p=list(_CLASSES.values())):
        if not free.any():
            break
        low, high = _SEEN[name]
        away = np.where(free, np.maximum(np.maximum(low - seen, seen - high), 0.0), np.inf)
        fit = np.flatnonzero(away.reshape(-1) <= away.min() + 0.002)
        pick = int(fit[rng.integers(fit.size)])
        place = float(north.flat[pick]), float(east.flat[pick])
        free &= np.hypot(north - place[0], east - place[1]) > _APART_M
        classes.append("bush" if name == "bush" else "half")
        places.append(place)
    clothes = tuple(str(rng.choice(OUTFITS)) for _ in places)
    return replace(
        drawn, people=len(places), classes=tuple(classes), clothes=clothes, places=tuple(places)
    )
