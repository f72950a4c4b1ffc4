"""Everything that decides what a simulated flight looks like, in one frozen object."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from hsvaos.camera import Camera
from hsvaos.nav.sensor_models import BARO_MODELS, GNSS_MODELS, IMU_MODELS
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.photo import CameraEffects


@dataclass(frozen=True)
class SensorSettings:
    """Which sensors log the flight, and what goes wrong with them.

    Args:
        imu: Name in `IMU_MODELS`.
        gnss: Name in `GNSS_MODELS`.
        baro: Name in `BARO_MODELS`.
        gnss_latency_s: How late fixes are stamped [s].
        gnss_outages_s: Spans (from, to) without fixes [s].
        gnss_outlier_share: Share of fixes that jump (0-1).
        gnss_outlier_m: Length of the jumps [m].

    Raises:
        ValueError: If a name is unknown or a number out of range.
    """

    imu: str = "adis16448"
    gnss: str = "sbas"
    baro: str = "calibrated"
    gnss_latency_s: float = 0.0
    gnss_outages_s: tuple[tuple[float, float], ...] = ()
    gnss_outlier_share: float = 0.0
    gnss_outlier_m: float = 15.0

    def __post_init__(self) -> None:
        for name, known in (("imu", IMU_MODELS), ("gnss", GNSS_MODELS), ("baro", BARO_MODELS)):
            if getattr(self, name) not in known:
                raise ValueError(
                    f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}"
                )
        if not (np.isfinite(self.gnss_latency_s) and 0.0 <= self.gnss_latency_s <= 5.0):
            raise ValueError(f"gnss_latency_s must lie in 0 to 5, got {self.gnss_latency_s!r}")
        if not 0.0 <= self.gnss_outlier_share <= 1.0:
            raise ValueError(
                f"gnss_outlier_share must lie in 0 to 1, got {self.gnss_outlier_share!r}"
            )
        if not (np.isfinite(self.gnss_outlier_m) and self.gnss_outlier_m >= 0.0):
            raise ValueError(f"gnss_outlier_m must be 0 or more, got {self.gnss_outlier_m!r}")
        for span in self.gnss_outages_s:
            if len(span) != 2 or not span[0] < span[1]:
                raise ValueError(f"an outage must be (from, to) with from < to, got {span!r}")


@dataclass(frozen=True)
class SimulationSettings:
    """What to simulate.

    Args:
        forest: The forest; its seed is the seed of everything.
        mission: The flight.
        camera: The camera.
        effects: What the camera does to the light.
        sensors: The log.
        people: How many.
        classes: Occlusion class of each in turn; None takes turns through what the forest gives.
        clothes: Colour of the top of each in turn; None for any.
        places: North and east of each person [m], or None to choose them by class.
        stakes: Survey stakes with white plates, on a grid.
        fresh_poses: Let new ragdolls fall (extra `sim`) instead of using the pose library.
        thermal: Grey pictures of the temperature instead of colour.
        jpeg_quality: 1-100; 0 writes PNG without loss.
    """

    forest: ForestSettings = field(default_factory=ForestSettings)
    mission: Mission = field(default_factory=Mission)
    camera: Camera = field(default_factory=lambda: Camera.from_fov(1024, 1024, 90.0))
    effects: CameraEffects = field(default_factory=CameraEffects)
    sensors: SensorSettings = field(default_factory=SensorSettings)
    people: int = 4
    classes: tuple[str, ...] | None = None
    clothes: tuple[str, ...] | None = None
    places: tuple[tuple[float, float], ...] | None = None
    stakes: int = 0
    fresh_poses: bool = False
    thermal: bool = False
    jpeg_quality: int = 95

    def __post_init__(self) -> None:
        for name, low, high in (
            ("people", 0, 200),
            ("stakes", 0, 400),
            ("jpeg_quality", 0, 100),
        ):
            value = getattr(self, name)
            if int(value) != value or not low <= value <= high:
                raise ValueError(f"{name} must be a whole number, {low} to {high}, got {value!r}")

    @property
    def seed(self) -> int:
        """Seed of everything."""
        return self.forest.seed

    def fitted(self) -> SimulationSettings:
        """Return the settings with the forest grown as large as the photos can see.

        The far corner of a photo taken at the edge of the mission, with some tilt, is forest too.
        """
        camera, mission = self.camera, self.mission
        corner = max(
            float(np.hypot((camera.width / 2) / camera.fx, (camera.height / 2) / camera.fy)), 0.2
        )
        reach = mission.height_m * corner * 1.15 + 4.0
        half = float(np.ceil(max(mission.half_m) + reach))
        return replace(self, forest=self.forest.replace(half_m=half))

    def fingerprint(self) -> str:
        """Return the settings as text, equal only for equal settings."""
        return json.dumps(_plain(asdict(self)), sort_keys=True)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
