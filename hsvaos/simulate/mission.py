"""The paper's mission: a lawnmower of straight strips, a photo every few metres."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.log import TrueMotion
from hsvaos.simulate.vehicle import GRAVITY, STEP_S, Airframe, Quadrotor, Wind

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mission:
    """Straight strips to the north and back, side by side to the east.

    Args:
        photos: How many; 117 gives the paper's 9 strips of 13.
        height_m: Above the mean ground [m].
        photo_distance_m: Along a strip [m].
        strip_distance_m: Between strips [m].
        speed_m_s: Along a strip [m/s].
        wind: What blows.
        hover_s: Hover before the start [s].

    Raises:
        ValueError: If a size is not positive.
    """

    photos: int = 117
    height_m: float = 20.0
    photo_distance_m: float = 5.0
    strip_distance_m: float = 8.0
    speed_m_s: float = 5.0
    wind: Wind = field(default_factory=Wind)
    hover_s: float = 6.0

    def __post_init__(self) -> None:
        if int(self.photos) != self.photos or self.photos < 1:
            raise ValueError(f"photos must be a whole number of at least 1, got {self.photos!r}")
        for name in ("height_m", "photo_distance_m", "strip_distance_m", "speed_m_s", "hover_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, got {value!r}")
        if self.speed_m_s > 12.0:
            raise ValueError(f"speed_m_s must be 12 at most for this vehicle, got {self.speed_m_s}")

    @property
    def strips(self) -> int:
        """Number of strips: as square an area as the photos allow."""
        share = self.photos * self.photo_distance_m / self.strip_distance_m
        return max(round(float(np.sqrt(share))), 1)

    @property
    def per_strip(self) -> int:
        """Photos on a full strip."""
        return -(-self.photos // self.strips)

    @property
    def half_m(self) -> tuple[float, float]:
        """Half the extent of the photo places, north and east [m]."""
        return (
            (self.per_strip - 1) * self.photo_distance_m / 2,
            (self.strips - 1) * self.strip_distance_m / 2,
        )

    def places(self) -> Array:
        """Return the planned photo places in order, shape (photos, 3), NED [m]."""
        north = (np.arange(self.per_strip) - (self.per_strip - 1) / 2) * self.photo_distance_m
        east = (np.arange(self.strips) - (self.strips - 1) / 2) * self.strip_distance_m
        rows = [
            np.stack([north[:: 1 if k % 2 == 0 else -1], np.full(self.per_strip, e)], axis=1)
            for k, e in enumerate(east)
        ]
        flat = np.concatenate(rows)[: self.photos]
        return np.concatenate([flat, np.full((self.photos, 1), -self.height_m)], axis=1)

    def poses(self) -> Array:
        """Return the planned nadir poses, world_from_camera, shape (photos, 4, 4)."""
        poses = np.tile(np.eye(4), (self.photos, 1, 1))
        poses[:, :3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
        poses[:, :3, 3] = self.places()
        return poses


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight as it truly was.

    Args:
        motion: True path.
        triggers_s: Shape (photos,), times of the photos [s].
    """

    motion: TrueMotion
    triggers_s: Array


def fly(mission: Mission, seed: int, airframe: Airframe | None = None) -> Flown:
    """Fly the mission.

    The wanted point runs along the strips with limited acceleration; the camera is triggered when
    the vehicle truly passes a planned place along its strip.

    Args:
        mission: Where to fly.
        seed: Of wind and heading.
        airframe: The vehicle; a small quadrotor if None.

    Raises:
        ValueError: If the wind carries the vehicle away from its mission.
    """
    rng = np.random.default_rng([seed, 81])
    places = mission.places()
    targets, speeds, strip = _profile(mission, places)
    wind = mission.wind.series(len(targets), rng)
    sway = np.radians(2.0) * np.sin(
        2.0 * np.pi * 0.03 * STEP_S * np.arange(len(targets)) + rng.uniform(0.0, 6.0)
    )
    vehicle = Quadrotor(airframe or Airframe(), targets[0])
    position = np.empty((len(targets), 3))
    velocity = np.empty_like(position)
    quaternion = np.empty((len(targets), 4))
    for k in range(len(targets)):
        position[k], velocity[k] = vehicle.position, vehicle.velocity
        quaternion[k] = vehicle.quaternion
        vehicle.step(targets[k], speeds[k], float(sway[k]), wind[k])
    if float(np.abs(position - targets).max()) > 10.0:
        raise ValueError(
            f"the wind of {np.linalg.norm(mission.wind.mean):.1f} m/s with gusts of "
            f"{mission.wind.gust_std:.1f} m/s carries the vehicle away from its mission"
        )
    motion = _consistent(position, velocity, quaternion)
    return Flown(motion, _triggers(mission, places, position, strip))


def _profile(mission: Mission, places: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return wanted positions and velocities at every step, and the strip flown (-1 between)."""
    run_up = mission.speed_m_s**2 / 2.0 / 1.8 + 3.0
    low, high = float(places[:, 0].min()), float(places[:, 0].max())
    east = places[:: mission.per_strip, 1]
    corners, kinds = [], []
    for k, e in enumerate(east):
        ends = (low - run_up, high + run_up)
        start, stop = ends if k % 2 == 0 else ends[::-1]
        corners += [(start, e), (stop, e)]
        kinds += [-1, k]
    points = np.array(corners)
    hover = round(mission.hover_s / STEP_S)
    targets = [np.tile(points[0], (hover, 1))]
    speeds = [np.zeros((hover, 2))]
    strips = [np.full(hover, -1)]
    for k in range(1, len(points)):
        leg = points[k] - points[k - 1]
        length = float(np.hypot(*leg))
        along, speed = _leg(length, mission.speed_m_s, 1.8)
        targets.append(points[k - 1] + leg / length * along[:, None])
        speeds.append(leg / length * speed[:, None])
        strips.append(np.full(len(along), kinds[k]))
        # Wait a moment at the end, so that the vehicle catches up with the wanted point.
        rest = round(1.0 / STEP_S)
        targets.append(np.tile(points[k], (rest, 1)))
        speeds.append(np.zeros((rest, 2)))
        strips.append(np.full(rest, kinds[k]))
    flat, flat_speed = np.concatenate(targets), np.concatenate(speeds)
    down = np.full((len(flat), 1), -mission.height_m)
    still = np.zeros((len(flat), 1))
    return (
        np.concatenate([flat, down], axis=1),
        np.concatenate([flat_speed, still], axis=1),
        np.concatenate(strips),
    )


def _leg(length: float, speed: float, acceleration: float) -> tuple[Array, Array]:
    """Return way and speed over a leg from rest to rest, a trapezoid of speed."""
    top = min(speed, float(np.sqrt(length * acceleration)))
    ramp, total = top / acceleration, top / acceleration + length / top
    t = np.arange(0.0, total, STEP_S)
    v = np.minimum(top, acceleration * np.minimum(t, total - t))
    way = np.where(
        t < ramp,
        0.5 * acceleration * t**2,
        np.where(
            t < total - ramp,
            top * (t - 0.5 * ramp),
            length - 0.5 * acceleration * (total - t) ** 2,
        ),
    )
    return way, v


def _triggers(mission: Mission, places: Array, position: Array, strip: NDArray[np.int64]) -> Array:
    times = np.empty(len(places))
    for k in range(mission.strips):
        steps = np.flatnonzero(strip == k)
        sign = 1.0 if k % 2 == 0 else -1.0
        way = np.maximum.accumulate(sign * position[steps, 0])
        first = k * mission.per_strip
        last = min(first + mission.per_strip, len(places))
        # Passing a place: the wanted time lies between two steps.
        rising = np.concatenate([[True], np.diff(way) > 0.0])
        times[first:last] = np.interp(
            sign * places[first:last, 0], way[rising], steps[rising] * STEP_S
        )
    return times


def _consistent(position: Array, velocity: Array, quaternion: Array) -> TrueMotion:
    """Return the motion with rates and forces that integrate back to it (central differences)."""
    flips = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0, -1.0, 1.0))
    q = quaternion.copy()
    q[1:] *= flips[:, None]
    turn = attitude.log(attitude.multiply(attitude.conjugate(q[:-1]), q[1:])) / STEP_S
    rate = np.empty_like(position)
    rate[1:-1] = 0.5 * (turn[1:] + turn[:-1])
    rate[0], rate[-1] = turn[0], turn[-1]
    force = np.gradient(velocity, STEP_S, axis=0) - (0.0, 0.0, GRAVITY)
    body = attitude.rotate(attitude.conjugate(q), force)
    t = np.asarray(np.arange(len(q)) * STEP_S, dtype=np.float64)
    return TrueMotion(t, position, velocity, q, rate, body)
