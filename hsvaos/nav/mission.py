"""A true path for trials: a lawnmower flown by something that tilts like a quadrotor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.log import TrueMotion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lawnmower:
    """Strips over a square, photos at even spacing, a stop at the end of each strip.

    The defaults are the mission of the paper: 64 m x 64 m, 9 strips of 13 photos, 20 m above the
    ground, 5 m/s, the nose to the north; acceleration and jerk are PX4's defaults (3 m/s^2 and
    4 m/s^3).

    Args:
        size_m: Side of the square [m].
        strips: Number of strips, one after the other to the east.
        photos: Photos on each strip.
        height_m: Height above the ground, down = 0 [m].
        speed_m_s: Cruise speed [m/s].
        acceleration_m_s2: Acceleration at the ends of a strip [m/s^2].
        smoothing_s: Length of the window that rounds the corners of the speed [s]; twice.
        wait_s: Hover before the first strip and at each stop [s].
        sway_m: Spread of the slow wandering about the path that gusts cause [m].
        drag_1_s: Air drag by mass and speed, so that the vehicle leans into its speed [1/s].
        rate_hz: Samples a second of the path.
        nose: "north" keeps the nose to the north, "track" turns it along the way, with a quarter
            turn at each corner.
        gravity: Acceleration of gravity [m/s^2].

    Raises:
        ValueError: If `nose` is neither.
    """

    size_m: float = 64.0
    strips: int = 9
    photos: int = 13
    height_m: float = 20.0
    speed_m_s: float = 5.0
    acceleration_m_s2: float = 3.0
    smoothing_s: float = 0.75
    wait_s: float = 2.5
    sway_m: float = 0.1
    drag_1_s: float = 0.2
    rate_hz: float = 200.0
    nose: str = "north"
    gravity: float = 9.80665

    def __post_init__(self) -> None:
        if self.nose not in ("track", "north"):
            raise ValueError(f"nose must be 'track' or 'north', got {self.nose!r}")

    def fly(self, seed: int = 0) -> tuple[TrueMotion, Array]:
        """Return the true path and the times of the photos.

        Args:
            seed: Draws the sway.

        Returns:
            The path, and shape (strips * photos,) [s].
        """
        dt = 1.0 / self.rate_hz
        hover = np.zeros((round(self.wait_s * self.rate_hz), 2))
        wait = len(hover)
        pieces, spans, count = [np.repeat(hover, 3, axis=0)], [], 3 * wait
        yaw = [np.zeros(count)]
        for strip in range(self.strips):
            sign = 1.0 if strip % 2 == 0 else -1.0
            speed = self._leg(self.size_m)
            pieces += [np.stack([sign * speed, 0 * speed], axis=1), hover]
            heading, last = 0.5 * (1.0 - sign), strip + 1 == self.strips
            yaw += [np.full(len(speed), heading), _ramp(heading, heading if last else 0.5, wait)]
            spans.append((count, count + len(speed) + wait))
            count += len(speed) + wait
            if strip + 1 < self.strips:
                speed = self._leg(self.size_m / (self.strips - 1))
                pieces += [np.stack([0 * speed, speed], axis=1), hover]
                yaw += [np.full(len(speed), 0.5), _ramp(0.5, 1.0 - heading, wait)]
                count += len(speed) + wait
        velocity = np.zeros((count, 3))
        velocity[:, :2] = np.concatenate(pieces)
        window = round(self.smoothing_s * self.rate_hz)
        velocity = _smooth(velocity, window)
        turn = np.pi * _smooth(np.concatenate(yaw)[:, None], window)[:, 0]
        along = np.cumsum(velocity[:, 0]) * dt
        triggers = []
        for strip, (start, stop) in enumerate(spans):
            places = np.linspace(0.0, self.size_m, self.photos)
            # photos just inside the ends, where the smoothed path surely passes
            places = np.clip(places, 0.02, self.size_m - 0.02)
            path = along[start:stop] if strip % 2 == 0 else self.size_m - along[start:stop]
            triggers.append(np.interp(places, np.maximum.accumulate(path), np.arange(start, stop)))
        velocity += self._sway(count, np.random.default_rng(seed))
        position = np.zeros((count, 3))
        position[1:] = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]), axis=0) * dt
        position += [-self.size_m / 2, -self.size_m / 2, -self.height_m]
        t = np.asarray(np.arange(count) * dt, dtype=np.float64)
        heading_rad = turn if self.nose == "track" else 0.0
        motion = lean(t, position, velocity, heading_rad, self.drag_1_s, self.gravity)
        return motion, np.concatenate(triggers) * dt

    def _leg(self, length: float) -> Array:
        """Return the speed over a straight leg from rest to rest: a trapezoid [m/s]."""
        top = min(self.speed_m_s, np.sqrt(length * self.acceleration_m_s2))
        ramp = top / self.acceleration_m_s2
        total = ramp + length / top
        t = np.arange(round(total * self.rate_hz)) / self.rate_hz
        speed = np.minimum(top, self.acceleration_m_s2 * np.minimum(t, total - t)).clip(0.0)
        return np.asarray(speed * length * self.rate_hz / speed.sum())

    def _sway(self, count: int, rng: np.random.Generator) -> Array:
        """Return the velocity of a few slow sines of random phase, shape (count, 3) [m/s]."""
        t = np.arange(count)[:, None] / self.rate_hz
        out = np.zeros((count, 3))
        for hertz in (0.07, 0.16, 0.31, 0.5):
            phase = rng.uniform(0.0, 2.0 * np.pi, 3)
            rate = 2.0 * np.pi * hertz
            out += self.sway_m * np.sqrt(0.5) * rate * np.cos(rate * t + phase)
        return out * [1.0, 1.0, 0.3]


def lean(
    t_s: Array,
    position: Array,
    velocity: Array,
    yaw: Array | float,
    drag_1_s: float = 0.2,
    gravity: float = 9.80665,
) -> TrueMotion:
    """Return the path of a rotorcraft that follows positions: it leans so that thrust fits.

    Thrust acts along body -z and air drag against the velocity:
    `thrust = acceleration - g + drag velocity`; body -z points along it, the nose along yaw.
    Acceleration and angular rate are central differences, consistent to second order in the step.

    Args:
        t_s: Shape (N,), evenly spaced [s].
        position: Shape (N, 3), world NED [m].
        velocity: Shape (N, 3), its derivative [m/s].
        yaw: Shape (N,) or one number [rad].
        drag_1_s: Drag by mass and speed [1/s].
        gravity: Acceleration of gravity [m/s^2].
    """
    acceleration = np.gradient(velocity, t_s, axis=0)
    force = acceleration - [0.0, 0.0, gravity]
    thrust = force + drag_1_s * velocity
    down = -thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
    heading = np.broadcast_to(np.asarray(yaw, dtype=np.float64), t_s.shape)
    # left of the nose, level; body y = down x nose is level only to first order, so build from it
    nose = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=1)
    right = np.cross(down, nose)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    axes = np.stack([np.cross(right, down), right, down], axis=-1)
    q = attitude.from_matrix(axes)
    # one sign along the path, so that interpolation never crosses the sphere
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    step = attitude.log(attitude.multiply(attitude.conjugate(q[:-1]), q[1:]))
    step /= np.diff(t_s)[:, None]
    rate = np.empty_like(position)
    rate[1:-1] = 0.5 * (step[1:] + step[:-1])
    rate[0], rate[-1] = step[0], step[-1]
    return TrueMotion(
        t_s, position, velocity, q, rate, attitude.rotate(attitude.conjugate(q), force)
    )


def _ramp(start: float, stop: float, count: int) -> Array:
    """Return numbers that run evenly from start to stop."""
    return start + (stop - start) * np.arange(count) / count


def _smooth(values: Array, window: int) -> Array:
    """Return columns averaged twice over a centred window, ends held."""
    kernel = np.ones(window) / window
    kernel = np.convolve(kernel, kernel)
    half = len(kernel) // 2
    padded = np.pad(values, ((half, len(kernel) - 1 - half), (0, 0)), mode="edge")
    return np.stack([np.convolve(c, kernel, mode="valid") for c in padded.T], axis=1)
