"""Recorded and simulated flights played back as if they were flown now."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import Flight, FlightError
from hsvaos.formats.images import photos_ahead, read_mask
from hsvaos.live.integrator import LiveIntegrator
from hsvaos.nav.log import SensorLog
from hsvaos.nav.online import OnlineFilter
from hsvaos.photos import resized

_LONGEST_PAUSE_S = 60.0
"""A longer pause between two photos is a change of battery, not a part of the flight."""


@dataclass(frozen=True)
class Pace:
    """How fast a flight is played.

    Args:
        rate_hz: Photos a second; None for the photos' own times.
        speed: Factor on that.
        minutes: How long to play, over and over; None for once.

    Raises:
        ValueError: If a number is not positive.
    """

    rate_hz: float | None = None
    speed: float = 1.0
    minutes: float | None = None

    def __post_init__(self) -> None:
        for name in ("rate_hz", "speed", "minutes"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be a positive number, got {value!r}")

    def offsets_s(self, flight: Flight) -> NDArray[np.float64]:
        """Return when each photo comes after the start, and last when the next round starts [s].

        Raises:
            FlightError: If the photos have no times, and there is no rate.
        """
        count = len(flight)
        if self.rate_hz is not None:
            return np.arange(count + 1) / (self.rate_hz * self.speed)
        times = np.array([frame.t_s for frame in flight.frames])
        if not np.isfinite(times).all() or (np.diff(times) < 0.0).any():
            raise FlightError(
                f"{flight.source}: the photos have no times to be played by: give a rate (--rate)"
            )
        steps = np.minimum(np.diff(times), _LONGEST_PAUSE_S)
        usual = float(np.median(steps)) if count > 1 else 1.0
        steps = np.concatenate([[0.0], steps, [max(usual, 1e-3)]])
        return np.asarray(np.cumsum(steps) / self.speed)


class Sensors:
    """A sensor log that comes in bit by bit.

    Args:
        log: The log.
        navigator: What it is fed to.
    """

    def __init__(self, log: SensorLog, navigator: OnlineFilter) -> None:
        self._log, self._navigator = log, navigator
        kinds = [("imu", log.imu.t_s)]
        kinds += [] if log.gnss is None else [("gnss", log.gnss.t_s)]
        kinds += [] if log.baro is None else [("baro", log.baro.t_s)]
        samples = [(float(t), kind, i) for kind, times in kinds for i, t in enumerate(times)]
        self._samples = iter(sorted(samples))
        self._next: tuple[float, str, int] | None = next(self._samples, None)

    def until(self, t_s: float) -> None:
        """Feed what was measured up to a time [s]."""
        while self._next is not None and self._next[0] <= t_s:
            self._feed(*self._next)
            self._next = next(self._samples, None)

    def _feed(self, t_s: float, kind: str, i: int) -> None:
        log = self._log
        if kind == "imu":
            self._navigator.add_imu(t_s, log.imu.gyro[i], log.imu.accel[i])
        elif kind == "baro" and log.baro is not None:
            self._navigator.add_baro(t_s, float(log.baro.height_m[i]))
        elif log.gnss is not None:
            g = log.gnss
            stds = (s if s is None else s[i] for s in (g.position_std, g.velocity_std))
            self._navigator.add_gnss(t_s, g.position[i], g.velocity[i], *stds)


class Player:
    """Brings the photos of a flight to a live integrator when their time has come.

    Args:
        flight: The flight. Photos that cannot be decoded are left out and counted.
        live: Where to bring them; its photos are those of the flight, shrunk by `scale`.
        pace: How fast.
        sensors: The flight's log, where its photos have no poses.
        scale: Factor on width and height of the photos.

    Raises:
        FlightError: If the flight cannot be played at that pace.
    """

    def __init__(
        self,
        flight: Flight,
        live: LiveIntegrator,
        pace: Pace,
        sensors: Sensors | None = None,
        scale: float = 1.0,
    ) -> None:
        self._flight, self._live, self._pace, self._sensors = flight, live, pace, sensors
        self._offsets = pace.offsets_s(flight)
        if sensors is not None and pace.minutes is not None:
            raise FlightError(
                f"{flight.source}: a sensor log can only be played once: leave --minutes away"
            )
        camera = flight.camera
        self._size = (max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        self.faults: list[FlightError] = []
        self.behind_s = 0.0

    def play(self, stop: threading.Event) -> None:
        """Play until the flight, or the time, is over, or until told to stop."""
        start = time.monotonic()
        end = None if self._pace.minutes is None else start + 60.0 * self._pace.minutes
        for due_s, index, image in self._photos():
            due = start + due_s
            if stop.wait(max(0.0, due - time.monotonic())):
                return
            if end is not None and due >= end:
                return
            self.behind_s = max(self.behind_s, time.monotonic() - due)
            frame = self._flight.frames[index]
            if self._sensors is not None:
                self._sensors.until(frame.t_s)
                self._live.push(image, None, frame.t_s)
            else:
                self._live.push(image, frame.world_from_camera, frame.t_s)

    def _photos(self) -> Iterator[tuple[float, int, Any]]:
        """Yield when each photo is due, its number, and the photo, decoded ahead."""
        lap = 0
        while True:
            whole = float(self._offsets[-1])
            photos = photos_ahead(self._flight, 1, lambda _, error: self._note(error))
            for index, photo in enumerate(photos):
                if photo is not None:
                    image = resized(photo.image, *self._size)
                    yield lap * whole + float(self._offsets[index]), index, image
            lap += 1
            if self._pace.minutes is None or len(self.faults) >= lap * len(self._flight):
                return

    def _note(self, error: FlightError) -> None:
        if len(self.faults) < 1000:
            self.faults.append(error)


def valid_pixels(flight: Flight, scale: float = 1.0) -> NDArray[np.uint8] | None:
    """Return the flight's user mask at a scale, shape (H, W); None where all pixels may be used."""
    if flight.mask is None:
        return None
    camera = flight.camera
    mask = read_mask(flight.mask, camera.width, camera.height)
    size = (max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
    return np.where(resized(mask, *size) >= 128, 255, 0).astype(np.uint8)
