"""What forest to grow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hsvaos.simulate.seasons import SEASONS, sun_direction

CARDS = {"light": 5500, "heavy": 26000}
"""Leaf cards a tree by detail."""


@dataclass(frozen=True)
class ForestSettings:
    """What forest to grow.

    Args:
        season: "summer", "fall" or "snow".
        density: Stems a hectare.
        seed: Of everything.
        half_m: Trees stand within [-half_m, half_m] both ways [m].
        leaf_density: Factor on the number of leaf cards a tree.
        relief_m: Standard deviation of the ground's heights [m].
        glades: Share of the area kept free of trees, in patches of about 12 m (0-0.8).
        bushes: Bushes and ferns a hectare.
        sun_elevation_deg: Above the horizon [deg].
        sun_azimuth_deg: From north over east [deg].
        cloud: 0 for clear sky, 1 for closed cover.
        detail: "light" or "heavy" trees.

    Raises:
        ValueError: If a value is out of its range.
    """

    season: str = "summer"
    density: float = 450.0
    seed: int = 0
    half_m: float = 66.0
    leaf_density: float = 1.0
    relief_m: float = 0.25
    glades: float = 0.08
    bushes: float = 160.0
    sun_elevation_deg: float = 48.0
    sun_azimuth_deg: float = 150.0
    cloud: float = 0.0
    detail: str = "light"

    def __post_init__(self) -> None:
        if self.season not in SEASONS:
            raise ValueError(f"season must be one of {', '.join(SEASONS)}, got {self.season!r}")
        if self.detail not in CARDS:
            raise ValueError(f"detail must be one of {', '.join(CARDS)}, got {self.detail!r}")
        checks = (
            ("density", self.density, 0.0, 5000.0, "stems a hectare"),
            ("half_m", self.half_m, 2.0, 500.0, "metres"),
            ("leaf_density", self.leaf_density, 0.05, 8.0, "a factor"),
            ("relief_m", self.relief_m, 0.0, 3.0, "metres"),
            ("glades", self.glades, 0.0, 0.8, "a share"),
            ("bushes", self.bushes, 0.0, 2000.0, "a hectare"),
            ("cloud", self.cloud, 0.0, 1.0, "a share"),
        )
        for name, value, low, high, unit in checks:
            if not (np.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} must lie in {low:g} to {high:g} ({unit}), got {value!r}")
        if self.seed < 0:
            raise ValueError(f"seed must be 0 or more, got {self.seed!r}")
        sun_direction(self.sun_elevation_deg, self.sun_azimuth_deg)

    def replace(self, **changes: object) -> ForestSettings:
        """Return the settings with some changed."""
        return replace(self, **changes)  # type: ignore[arg-type]
