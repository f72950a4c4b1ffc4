"""WGS-84: geodetic coordinates to a local north-east-down frame and back, and gravity.

The local frame is the tangent plane at its origin (a rigid turn and shift of Earth-centred
Earth-fixed coordinates), not a map projection: distances are true, and points far away sink below
the plane by the curvature of the Earth (8 cm at 1 km). Constants: NGA.STND.0036, 2014.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from hsvaos.flight import Origin

Array = NDArray[np.float64]

SEMI_MAJOR_M = 6378137.0
"""Equatorial radius of WGS-84 [m]."""
FLATTENING = 1.0 / 298.257223563
"""Flattening of WGS-84."""
_E2 = FLATTENING * (2.0 - FLATTENING)


def ecef_from_geodetic(lat_lon_height: ArrayLike) -> Array:
    """Return Earth-centred coordinates [m] of latitude [deg], longitude [deg], height [m].

    Args:
        lat_lon_height: Shape (..., 3).

    Returns:
        Shape (..., 3).
    """
    llh = np.asarray(lat_lon_height, dtype=np.float64)
    lat, lon, height = np.radians(llh[..., 0]), np.radians(llh[..., 1]), llh[..., 2]
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (normal + height) * np.cos(lat) * np.cos(lon),
            (normal + height) * np.cos(lat) * np.sin(lon),
            (normal * (1.0 - _E2) + height) * np.sin(lat),
        ],
        axis=-1,
    )


def geodetic_from_ecef(xyz: ArrayLike) -> Array:
    """Return latitude [deg], longitude [deg], height [m] of Earth-centred coordinates [m].

    Iterates on the latitude (Bowring's start); five rounds are exact to rounding for heights
    between the sea floor and orbit.
    """
    p = np.asarray(xyz, dtype=np.float64)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    flat = np.hypot(x, y)
    lat = np.arctan2(z, flat * (1.0 - _E2))
    for _ in range(5):
        normal = SEMI_MAJOR_M / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + _E2 * normal * np.sin(lat), flat)
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    # Both forms of the height are exact; this mix stays so at the equator and at the poles.
    height = flat * np.cos(lat) + z * np.sin(lat) - SEMI_MAJOR_M**2 / normal
    return np.stack([np.degrees(lat), np.degrees(np.arctan2(y, x)), height], axis=-1)


def ned_axes(lat_deg: float, lon_deg: float) -> Array:
    """Return the rotation ned_from_ecef, shape (3, 3): rows are north, east and down."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array(
        [
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [-sin_lon, cos_lon, 0.0],
            [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat],
        ]
    )


def ned_from_geodetic(lat_lon_height: ArrayLike, origin: Origin) -> Array:
    """Return local north, east, down [m] of latitude [deg], longitude [deg], height [m].

    Args:
        lat_lon_height: Shape (..., 3); heights in the same system as the origin's.
        origin: Origin of the local frame.

    Returns:
        Shape (..., 3).
    """
    home = ecef_from_geodetic([origin.lat_deg, origin.lon_deg, origin.height_m])
    axes = ned_axes(origin.lat_deg, origin.lon_deg)
    return np.asarray((ecef_from_geodetic(lat_lon_height) - home) @ axes.T)


def geodetic_from_ned(ned: ArrayLike, origin: Origin) -> Array:
    """Return latitude [deg], longitude [deg], height [m] of local north, east, down [m].

    Args:
        ned: Shape (..., 3).
        origin: Origin of the local frame.

    Returns:
        Shape (..., 3).
    """
    home = ecef_from_geodetic([origin.lat_deg, origin.lon_deg, origin.height_m])
    axes = ned_axes(origin.lat_deg, origin.lon_deg)
    return geodetic_from_ecef(home + np.asarray(ned, dtype=np.float64) @ axes)


def gravity(lat_deg: float, height_m: float = 0.0) -> float:
    """Return the normal gravity [m/s^2] by Somigliana's formula and its free-air gradient.

    Args:
        lat_deg: Geodetic latitude [deg].
        height_m: Height above the ellipsoid [m].
    """
    sin2 = float(np.sin(np.radians(lat_deg)) ** 2)
    surface = 9.7803253359 * (1.0 + 0.00193185265241 * sin2) / np.sqrt(1.0 - _E2 * sin2)
    return float(surface - 3.0877e-6 * (1.0 - 0.00142 * sin2) * height_m)
