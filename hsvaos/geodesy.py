"""WGS-84 and the local north-east-down frame, exactly, by way of Earth-centred coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.flight import Origin

Array = NDArray[np.float64]

SEMI_MAJOR_M = 6378137.0
"""Equatorial radius of the WGS-84 ellipsoid [m]."""
FLATTENING = 1.0 / 298.257223563
"""Flattening of the WGS-84 ellipsoid."""

_SEMI_MINOR_M = SEMI_MAJOR_M * (1.0 - FLATTENING)
_E2 = FLATTENING * (2.0 - FLATTENING)
_E2_PRIME = _E2 / (1.0 - _E2)
_BOWRING_STEPS = 4
"""One step is good to a micrometre near the ground; four serve any height of an aircraft."""


def ecef_from_geodetic(lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Array:
    """Return Earth-centred, Earth-fixed coordinates.

    Args:
        lat_deg: Geodetic latitude [deg], any shape that broadcasts with the others.
        lon_deg: Longitude [deg].
        height_m: Height above the ellipsoid [m].

    Returns:
        Shape (..., 3), float64 [m].
    """
    lat, lon, height = np.broadcast_arrays(
        np.radians(np.asarray(lat_deg, dtype=np.float64)),
        np.radians(np.asarray(lon_deg, dtype=np.float64)),
        np.asarray(height_m, dtype=np.float64),
    )
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (normal + height) * np.cos(lat) * np.cos(lon),
            (normal + height) * np.cos(lat) * np.sin(lon),
            (normal * (1.0 - _E2) + height) * np.sin(lat),
        ],
        axis=-1,
    )


def geodetic_from_ecef(ecef_m: ArrayLike) -> tuple[Array, Array, Array]:
    """Return latitude, longitude and height of Earth-centred points (Bowring 1976, iterated).

    Args:
        ecef_m: Shape (..., 3) [m].

    Returns:
        Latitude [deg], longitude [deg] and height above the ellipsoid [m], each shape (...).
    """
    ecef = np.asarray(ecef_m, dtype=np.float64)
    x, y, z = ecef[..., 0], ecef[..., 1], ecef[..., 2]
    p = np.hypot(x, y)
    beta = np.arctan2(z * SEMI_MAJOR_M, p * _SEMI_MINOR_M)
    lat = beta
    for _ in range(_BOWRING_STEPS):
        lat = np.arctan2(
            z + _E2_PRIME * _SEMI_MINOR_M * np.sin(beta) ** 3,
            p - _E2 * SEMI_MAJOR_M * np.cos(beta) ** 3,
        )
        beta = np.arctan2((1.0 - FLATTENING) * np.sin(lat), np.cos(lat))
    # This form of the height has no division by cos(lat) or sin(lat): it holds at the poles too.
    height = (
        p * np.cos(lat) + z * np.sin(lat) - SEMI_MAJOR_M * np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    )
    return np.degrees(lat), np.degrees(np.arctan2(y, x)), height


def _ned_from_ecef_rotation(origin: Origin) -> Array:
    lat, lon = np.radians(origin.lat_deg), np.radians(origin.lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array(
        [
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [-sin_lon, cos_lon, 0.0],
            [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat],
        ]
    )


def ned_from_geodetic(
    lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike, origin: Origin
) -> Array:
    """Return local north, east, down of geodetic points.

    Args:
        lat_deg: Latitude [deg].
        lon_deg: Longitude [deg].
        height_m: Height [m], of the same kind as `origin.height_m`.
        origin: Where the local frame is tied to the Earth.

    Returns:
        Shape (..., 3), float64, world NED [m].
    """
    offset = ecef_from_geodetic(lat_deg, lon_deg, height_m) - ecef_from_geodetic(
        origin.lat_deg, origin.lon_deg, origin.height_m
    )
    return offset @ _ned_from_ecef_rotation(origin).T


def ned_from_llh(places: ArrayLike, origin: Origin) -> Array:
    """Return local north, east, down of rows of latitude [deg], longitude [deg] and height [m].

    Args:
        places: Shape (..., 3).
        origin: Where the local frame is tied to the Earth.
    """
    llh = np.asarray(places, dtype=np.float64)
    return ned_from_geodetic(llh[..., 0], llh[..., 1], llh[..., 2], origin)


def geodetic_from_ned(ned_m: ArrayLike, origin: Origin) -> tuple[Array, Array, Array]:
    """Return latitude, longitude and height of local points.

    Args:
        ned_m: Shape (..., 3), world NED [m].
        origin: Where the local frame is tied to the Earth.

    Returns:
        Latitude [deg], longitude [deg] and height [m], each shape (...).
    """
    ned = np.asarray(ned_m, dtype=np.float64)
    centre = ecef_from_geodetic(origin.lat_deg, origin.lon_deg, origin.height_m)
    return geodetic_from_ecef(centre + ned @ _ned_from_ecef_rotation(origin))
