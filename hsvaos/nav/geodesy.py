"""Normal gravity of WGS-84. Coordinates are in `hsvaos.geodesy`."""

from __future__ import annotations

import numpy as np

from hsvaos.geodesy import FLATTENING

_E2 = FLATTENING * (2.0 - FLATTENING)


def gravity(lat_deg: float, height_m: float = 0.0) -> float:
    """Return the normal gravity [m/s^2] by Somigliana's formula and its free-air gradient.

    Args:
        lat_deg: Geodetic latitude [deg].
        height_m: Height above the ellipsoid [m].
    """
    sin2 = float(np.sin(np.radians(lat_deg)) ** 2)
    surface = 9.7803253359 * (1.0 + 0.00193185265241 * sin2) / np.sqrt(1.0 - _E2 * sin2)
    return float(surface - 3.0877e-6 * (1.0 - 0.00142 * sin2) * height_m)
