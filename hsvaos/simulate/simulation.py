"""A simulated flight in memory: everything is decided, and any of its photos can be taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.flight import Origin
from hsvaos.geodesy import geodetic_from_ned
from hsvaos.kernels.device import resolve_device
from hsvaos.nav import attitude
from hsvaos.nav.log import Mounting, SensorLog
from hsvaos.simulate.buffers import instance_numbers, ray_table
from hsvaos.simulate.forest import Forest, grow_forest
from hsvaos.simulate.mission import Flown, fly
from hsvaos.simulate.occlusion import person_pixels
from hsvaos.simulate.photo import expose, expose_thermal
from hsvaos.simulate.placement import Cast, add_stakes, place_people
from hsvaos.simulate.scene import Scene
from hsvaos.simulate.sensors import log_flight
from hsvaos.simulate.settings import SimulationSettings

Array = NDArray[np.float64]

ORIGIN = Origin(47.5, 11.5, 700.0)
"""Where the simulated world is tied to the Earth: a wooded place, of no meaning."""
MOUNTING = Mounting(
    camera_lever_arm=np.array([0.08, 0.0, 0.06]), antenna_lever_arm=np.array([-0.05, 0.0, -0.14])
)
"""How camera and antenna sit on the vehicle; the camera looks straight down."""
_METER_SIZE = 96
_MIDDLE_GREY = 0.20


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo and what it truly shows.

    Args:
        image: Shape (H, W, 3) RGB, or (H, W) grey of a thermal camera; uint8.
        people: For each person (pixels that show it, pixels that would without anything else).
        kind: Shape (H, W), uint8, `Kind` of what each pixel shows; 255 for nothing.
    """

    image: NDArray[np.uint8]
    people: list[tuple[int, int]]
    kind: NDArray[np.uint8]


class Simulation:
    """A flight whose photos are taken on demand, each bit-identical from the seed.

    Args:
        settings: What to simulate.
        device: Warp device that draws.
        measure: Whether to measure before the flight how visible people at given places are.

    Raises:
        ValueError: If the settings cannot be met, or there is no such device.
    """

    def __init__(
        self, settings: SimulationSettings, device: str = "cpu", *, measure: bool = True
    ) -> None:
        self.device = str(resolve_device(device))
        self.settings = settings.fitted()
        self.camera: Camera = self.settings.camera
        self.forest: Forest = grow_forest(self.settings.forest)
        self.flown: Flown = fly(self.settings.mission, self.settings.seed)
        self.poses = camera_poses(self.flown)
        self.cast: Cast = place_people(
            self.forest,
            self.camera,
            self.poses,
            self.settings.mission.half_m,
            self.settings.people,
            classes=self.settings.classes,
            tops=self.settings.clothes,
            places=self.settings.places,
            fresh=self.settings.fresh_poses,
            measure=measure,
            device=self.device,
        )
        self.forest = self.cast.forest
        instances = self.cast.instances.copy()
        self.stakes = add_stakes(instances, self.forest, self._stake_places())
        self.scene: Scene = self.forest.scene(instances, device=self.device)
        self.rays = ray_table(self.camera, self.device)
        self.log: SensorLog = log_flight(
            self.settings.sensors, self.flown, self.settings.seed, MOUNTING
        )
        self._gain = 0.0
        self._span = (0.0, 1.0)

    def _stake_places(self) -> Array:
        count = self.settings.stakes
        rng = np.random.default_rng([self.settings.seed, 95])
        half = np.array(self.settings.mission.half_m) + 2.0
        return rng.uniform(-half, half, (count, 2))

    def prepare(self) -> None:
        """Draw shadow maps and meter the exposure; the first photo does it otherwise."""
        if self._gain > 0.0:
            return
        small = self.camera.without_distortion().scaled(_METER_SIZE, _METER_SIZE)
        rays = ray_table(small, self.device)
        chosen = np.unique(np.linspace(0, len(self.poses) - 1, 5).round().astype(int))
        views = []
        for pose in self.poses[chosen]:
            keys = self.scene.keys(small, pose, rays)
            views.append(self.scene.radiance(small, pose, rays, keys))
        light = np.stack(views)
        luminance = light[..., :3] @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
        bright = float(np.quantile(luminance, 0.99))
        mean = float(np.mean(np.minimum(luminance, bright)))
        # Middle grey (more over snow, as a careful pilot sets it), but nothing may burn out.
        grey = _MIDDLE_GREY * (1.0 + self.forest.season.ground_snow)
        self._gain = min(grey / mean, 2.4 / bright)
        heat = light[..., 3]
        self._span = (float(np.quantile(heat, 0.002)) - 0.5, max(float(heat.max()), 32.0) + 0.5)

    def photo(self, index: int) -> Photo:
        """Take a photo.

        Args:
            index: From 0 to `len(poses) - 1`.
        """
        self.prepare()
        pose = self.poses[index]
        keys = self.scene.keys(self.camera, pose, self.rays)
        people = (
            person_pixels(self.scene, self.camera, pose, self.rays, keys, self.cast.number)
            if self.cast.number
            else []
        )
        shown = instance_numbers(keys, self.camera)
        kind = np.where(shown < 0, 255, self.scene.kind[shown]).astype(np.uint8)
        light = self.scene.radiance(self.camera, pose, self.rays, keys)
        rng = np.random.default_rng([self.settings.seed, 96, index])
        motion = self._motion_px(index)
        effects = self.settings.effects
        if self.settings.thermal:
            heat = np.ascontiguousarray(light[..., 3])
            return Photo(expose_thermal(heat, effects, self._span, motion, rng), people, kind)
        rgb = np.ascontiguousarray(light[..., :3])
        return Photo(expose(rgb, effects, self._gain, motion, rng), people, kind)

    def _motion_px(self, index: int) -> Array:
        """Return the motion of the picture of the ground during the exposure, x and y [px]."""
        exposure = self.settings.effects.exposure_s
        at = self.flown.triggers_s[index]
        ends = camera_poses(self.flown, np.array([at - exposure / 2, at + exposure / 2]))
        middle = self.poses[index]
        ground = middle[:3, 3] + middle[:3, 2] * (self.settings.mission.height_m / middle[2, 2])
        pixels = [self.camera.project((ground - pose[:3, 3]) @ pose[:3, :3]) for pose in ends]
        return np.asarray(pixels[1] - pixels[0])

    def names(self) -> list[str]:
        """Return the file names of the photos."""
        ending = "png" if self.settings.jpeg_quality == 0 else "jpg"
        return [f"photo_{k:03d}.{ending}" for k in range(len(self.poses))]

    def tables(self) -> dict[str, dict[str, Any]]:
        """Return the sensor log as columns by file kind, in the units of the native format."""
        log = self.log
        tables: dict[str, dict[str, Any]] = {
            "imu": _columns(
                "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2",
                log.imu.t_s,
                log.imu.gyro,
                log.imu.accel,
            ),
            "triggers": {"file": np.array(self.names()), "t_s": self.flown.triggers_s},
        }
        if log.gnss is not None:
            place = np.stack(geodetic_from_ned(log.gnss.position, ORIGIN), axis=-1)
            tables["gnss"] = _columns(
                "t_s,lat_deg,lon_deg,alt_m,vn_m_s,ve_m_s,vd_m_s",
                log.gnss.t_s,
                place,
                log.gnss.velocity,
            )
        if log.baro is not None:
            tables["baro"] = _columns("t_s,height_m", log.baro.t_s, log.baro.height_m)
        return tables


def camera_poses(flown: Flown, times_s: Array | None = None) -> Array:
    """Return world_from_camera at the triggers or at other times, shape (N, 4, 4)."""
    times = flown.triggers_s if times_s is None else times_s
    position, _, q = flown.motion.at(times)
    body = attitude.matrix(q)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = body @ attitude.matrix(MOUNTING.body_from_camera_q)
    poses[:, :3, 3] = position + body @ MOUNTING.camera_lever_arm
    return poses


_DIGITS = {
    "lat_deg": 9, "lon_deg": 9, "alt_m": 3, "height_m": 3,
    "gx_rad_s": 5, "gy_rad_s": 5, "gz_rad_s": 5,
    "ax_m_s2": 4, "ay_m_s2": 4, "az_m_s2": 4,
    "vn_m_s": 3, "ve_m_s": 3, "vd_m_s": 3,
}  # fmt: skip
"""Decimals far below the noise of the sensors; they keep the files small."""


def _columns(names: str, *parts: Array) -> dict[str, Array]:
    flat = np.concatenate([np.reshape(p, (len(parts[0]), -1)) for p in parts], axis=1)
    keys = names.split(",")
    return {key: np.round(flat[:, k], _DIGITS.get(key, 6)) for k, key in enumerate(keys)}
