"""Seasons: which species stand in the forest, the colours of their leaves, sun and sky."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.textures import Tile
from hsvaos.simulate.tree import TreeShape

Rgb = tuple[float, float, float]

SEASONS = ("summer", "fall", "snow")


@dataclass(frozen=True)
class Species:
    """One kind of tree in one season.

    Args:
        name: Plain name.
        kind: "broadleaf", "conifer" or "bare" (broadleaf in winter).
        share: Relative frequency.
        heights_m: Least and greatest height [m].
        shape: Its measures.
        palette: Linear RGB leaf colours.
    """

    name: str
    kind: str
    share: float
    heights_m: tuple[float, float]
    shape: TreeShape
    palette: tuple[Rgb, ...]


@dataclass(frozen=True)
class Season:
    """Everything that a season changes.

    Args:
        name: "summer", "fall" or "snow".
        species: The trees.
        bush: Linear RGB leaf colours of bushes.
        fern: Linear RGB of ferns.
        grass: Linear RGB of grass.
        litter: Linear RGB of what covers the ground, with its share.
        snow: How much snow lies on branches (0-1).
        ground_snow: How much snow lies on the ground (0-1).
        sun: Linear RGB of direct sunlight at noon.
        sky: Linear RGB of skylight.
        bounce: Linear RGB of light that comes off neighbouring leaves and ground.
    """

    name: str
    species: tuple[Species, ...]
    bush: tuple[Rgb, ...]
    fern: tuple[Rgb, ...]
    grass: tuple[Rgb, ...]
    litter: tuple[tuple[float, Rgb], ...]
    snow: float
    ground_snow: float
    sun: Rgb
    sky: Rgb
    bounce: Rgb


_BEECH = TreeShape(0.27, 0.28, 15, 7, 5, 0.44, (0.13, 0.12, 0.11), Tile.OVATE)
_MAPLE = TreeShape(0.25, 0.30, 14, 7, 5, 0.46, (0.10, 0.085, 0.07), Tile.LOBED)
_BIRCH = TreeShape(0.19, 0.35, 14, 6, 5, 0.40, (0.32, 0.31, 0.29), Tile.SMALL)
_OAK = TreeShape(0.30, 0.30, 15, 7, 5, 0.42, (0.085, 0.07, 0.055), Tile.LOBED)
_SPRUCE = TreeShape(0.17, 0.12, 0, 0, 0, 0.50, (0.085, 0.06, 0.045), Tile.NEEDLES)
_PINE = TreeShape(0.20, 0.38, 0, 0, 0, 0.55, (0.15, 0.075, 0.045), Tile.NEEDLES)

_SPRUCE_GREEN: tuple[Rgb, ...] = (
    (0.020, 0.042, 0.020),
    (0.030, 0.056, 0.024),
    (0.026, 0.050, 0.030),
)
_PINE_GREEN: tuple[Rgb, ...] = ((0.040, 0.062, 0.028), (0.050, 0.070, 0.034))

SUMMER = Season(
    "summer",
    (
        Species(
            "beech",
            "broadleaf",
            3.0,
            (10.0, 14.0),
            _BEECH,
            ((0.050, 0.095, 0.022), (0.064, 0.112, 0.026), (0.042, 0.082, 0.020)),
        ),
        Species(
            "maple",
            "broadleaf",
            2.0,
            (9.0, 13.0),
            _MAPLE,
            ((0.058, 0.100, 0.026), (0.074, 0.118, 0.030), (0.048, 0.086, 0.024)),
        ),
        Species(
            "oak",
            "broadleaf",
            2.0,
            (9.5, 13.5),
            _OAK,
            ((0.044, 0.076, 0.022), (0.056, 0.088, 0.024), (0.050, 0.082, 0.030)),
        ),
        Species(
            "birch",
            "broadleaf",
            1.0,
            (9.0, 13.0),
            _BIRCH,
            ((0.078, 0.120, 0.034), (0.092, 0.132, 0.036)),
        ),
        Species("spruce", "conifer", 1.0, (9.0, 14.0), _SPRUCE, _SPRUCE_GREEN),
        Species("pine", "conifer", 0.6, (10.0, 13.5), _PINE, _PINE_GREEN),
    ),
    ((0.060, 0.105, 0.028), (0.080, 0.125, 0.032), (0.052, 0.090, 0.030)),
    ((0.070, 0.130, 0.028), (0.090, 0.150, 0.036)),
    ((0.090, 0.125, 0.036), (0.130, 0.140, 0.055), (0.070, 0.105, 0.030)),
    (
        (0.40, (0.068, 0.045, 0.028)),
        (0.30, (0.048, 0.036, 0.025)),
        (0.08, (0.12, 0.086, 0.052)),
        (0.22, (0.034, 0.050, 0.017)),
    ),
    0.0,
    0.0,
    (5.2, 4.75, 3.9),
    (0.40, 0.50, 0.66),
    (0.10, 0.125, 0.04),
)

FALL = Season(
    "fall",
    (
        Species(
            "beech",
            "broadleaf",
            3.0,
            (10.0, 14.0),
            _BEECH,
            ((0.27, 0.135, 0.022), (0.21, 0.090, 0.022), (0.30, 0.19, 0.030)),
        ),
        Species(
            "red maple",
            "broadleaf",
            1.6,
            (9.0, 13.0),
            _MAPLE,
            ((0.23, 0.040, 0.026), (0.27, 0.072, 0.026), (0.17, 0.030, 0.032)),
        ),
        Species(
            "gold maple",
            "broadleaf",
            1.8,
            (9.0, 13.0),
            _MAPLE,
            ((0.42, 0.25, 0.028), (0.38, 0.19, 0.024), (0.45, 0.30, 0.040)),
        ),
        Species(
            "oak",
            "broadleaf",
            1.8,
            (9.5, 13.5),
            _OAK,
            ((0.17, 0.075, 0.028), (0.13, 0.085, 0.028), (0.20, 0.090, 0.036)),
        ),
        Species(
            "birch",
            "broadleaf",
            1.2,
            (9.0, 13.0),
            _BIRCH,
            ((0.44, 0.31, 0.036), (0.36, 0.28, 0.045), (0.20, 0.20, 0.040)),
        ),
        Species(
            "late maple",
            "broadleaf",
            1.2,
            (9.0, 13.0),
            _MAPLE,
            ((0.085, 0.115, 0.028), (0.13, 0.13, 0.030), (0.22, 0.17, 0.030)),
        ),
        Species("spruce", "conifer", 0.9, (9.0, 14.0), _SPRUCE, _SPRUCE_GREEN),
    ),
    ((0.16, 0.12, 0.030), (0.24, 0.090, 0.028), (0.11, 0.12, 0.032)),
    ((0.21, 0.13, 0.045), (0.16, 0.12, 0.040)),
    ((0.16, 0.14, 0.055), (0.11, 0.115, 0.040)),
    (
        (0.34, (0.150, 0.078, 0.030)),
        (0.20, (0.21, 0.125, 0.034)),
        (0.14, (0.125, 0.038, 0.023)),
        (0.32, (0.070, 0.046, 0.028)),
    ),
    0.0,
    0.0,
    (5.1, 4.45, 3.4),
    (0.42, 0.52, 0.70),
    (0.15, 0.11, 0.05),
)

SNOW = Season(
    "snow",
    (
        Species("beech", "bare", 2.2, (10.0, 14.0), _BEECH, ((0.1, 0.08, 0.06),)),
        Species("oak", "bare", 1.8, (9.5, 13.5), _OAK, ((0.1, 0.08, 0.06),)),
        Species("birch", "bare", 1.2, (9.0, 13.0), _BIRCH, ((0.1, 0.08, 0.06),)),
        Species("spruce", "conifer", 3.4, (9.0, 14.0), _SPRUCE, _SPRUCE_GREEN),
        Species("pine", "conifer", 1.6, (10.0, 13.5), _PINE, _PINE_GREEN),
    ),
    ((0.095, 0.075, 0.055), (0.12, 0.09, 0.06)),
    ((0.17, 0.12, 0.06),),
    ((0.20, 0.16, 0.09), (0.16, 0.13, 0.08)),
    ((0.6, (0.105, 0.080, 0.055)), (0.4, (0.080, 0.060, 0.040))),
    0.72,
    0.93,
    (3.9, 3.65, 3.25),
    (0.66, 0.86, 1.20),
    (0.40, 0.46, 0.58),
)

_BY_NAME = {"summer": SUMMER, "fall": FALL, "snow": SNOW}


def season(name: str) -> Season:
    """Return a season by name.

    Raises:
        ValueError: If there is none of that name.
    """
    if name not in _BY_NAME:
        raise ValueError(f"season must be one of {', '.join(SEASONS)}, got {name!r}")
    return _BY_NAME[name]


def sun_direction(elevation_deg: float, azimuth_deg: float) -> NDArray[np.float64]:
    """Return the unit vector to the sun, NED.

    Args:
        elevation_deg: Above the horizon [deg], above 0 and at most 90.
        azimuth_deg: From north over east [deg].

    Raises:
        ValueError: If the sun is not above the horizon.
    """
    if not 5.0 <= elevation_deg <= 90.0:
        raise ValueError(f"sun elevation must lie in 5 to 90 degrees, got {elevation_deg!r}")
    if not np.isfinite(azimuth_deg):
        raise ValueError(f"sun azimuth must be finite, got {azimuth_deg!r}")
    rise, turn = np.radians(elevation_deg), np.radians(azimuth_deg)
    return np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), -np.sin(rise)])
