"""The error-state filter while the vehicle flies: samples one by one, the pose of now.

A committed state lies some moments back, where all measurements have come in, however late they
are stamped. The pose of now is that state run forward over the samples since: what a filter with a
buffer, run again for late measurements, would say. Nothing is smoothed and nothing grows.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.flight import Origin
from hsvaos.nav import attitude
from hsvaos.nav.align import align
from hsvaos.nav.epochs import MICRO, epochs_of
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.error_state_run import ErrorStateRun
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import BaroLog, GnssLog, ImuLog, Mounting, SensorLog
from hsvaos.nav.sensor_models import BARO_MODELS, GNSS_MODELS, IMU_MODELS
from hsvaos.nav.trajectory import camera_pose

Array = NDArray[np.float64]
Sample = tuple[float, Array]

_KEPT_S = 120.0
"""Of the log, until it is known where the vehicle is [s]."""

_MOVING_M_S = 1.5
_NONE3 = np.full(3, np.nan)


class NoPoseError(ValueError):
    """The pose at that time is not known, not yet or not any more."""


@dataclass(frozen=True, eq=False)
class _State:
    """The filter at one time: its state, attitude, covariance, and what its gates remember."""

    t_s: float
    x: Array
    R: Array
    C: Array
    gates: dict[str, Any]


class OnlineFilter:
    """Pose of a vehicle from its IMU, GNSS and barometer, forward only, in bounded memory.

    May be fed from one thread and asked from another.

    Args:
        ekf: The filter; noise of a typical autopilot, receiver and barometer by default.
        initial: Where the vehicle starts. By default that is found from the log, in a thread of
            its own, once the vehicle has moved for a while: heading shows in motion only.
        mounting: Camera and antenna on the vehicle.
        origin: WGS-84 place of the local frame, for its gravity.
        hold_s: How late a measurement or a question may come [s].
        ahead_s: How far beyond the newest IMU sample a pose may be asked for [s].
        align_s: Motion that it takes to find the start [s].

    Raises:
        ValueError: If a time is not positive.
    """

    def __init__(
        self,
        ekf: ErrorStateEkf | None = None,
        initial: InitialState | None = None,
        *,
        mounting: Mounting | None = None,
        origin: Origin | None = None,
        hold_s: float = 1.0,
        ahead_s: float = 0.05,
        align_s: float = 15.0,
    ) -> None:
        if not (hold_s > 0.0 and ahead_s >= 0.0 and align_s > 0.0):
            raise ValueError(
                f"hold_s and align_s must be positive, ahead_s not negative, got "
                f"{hold_s!r}, {align_s!r} and {ahead_s!r}"
            )
        self.ekf = ekf or ErrorStateEkf(
            IMU_MODELS["autopilot"], GNSS_MODELS["standalone"], BARO_MODELS["ms5611"]
        )
        gnss, baro = self.ekf.gnss, self.ekf.baro
        self._latency = {
            "gnss": 0.0 if gnss is None else gnss.latency_s,
            "baro": 0.0 if baro is None else baro.latency_s,
        }
        self._hold_s = hold_s + max(0.0, *self._latency.values())
        self._ahead_s, self._align_s = ahead_s, align_s
        self._mounting, self._origin = mounting or Mounting(), origin
        self._imu: deque[Sample] = deque()
        self._gnss: deque[Sample] = deque()
        self._baro: deque[Sample] = deque()
        self._initial, self._state = initial, None if initial is None else self._first(initial)
        self._moving_since: float | None = None
        self._aligning: threading.Thread | None = None
        self._lock = threading.RLock()
        self.refused = 0
        self.notes: tuple[str, ...] = () if initial is None else initial.notes

    @property
    def ready(self) -> bool:
        """Whether the start is known, so that there are poses."""
        return self._state is not None

    def add_imu(self, t_s: float, gyro: ArrayLike, accel: ArrayLike) -> None:
        """Take in one sample.

        Args:
            t_s: Time [s]. Samples that do not run forward in time are refused and counted.
            gyro: Shape (3,), angular rate, body axes [rad/s].
            accel: Shape (3,), specific force, body axes [m/s^2].

        Raises:
            ValueError: If it is not of three numbers each.
        """
        row = np.concatenate([_three(gyro, "gyro"), _three(accel, "accel")])
        with self._lock:
            late = bool(self._imu) and t_s <= self._imu[-1][0]
            if late or not np.isfinite(row).all() or not np.isfinite(t_s):
                self.refused += 1
                return
            self._imu.append((float(t_s), row))
            if self._state is None:
                self._forget(float(t_s) - _KEPT_S)
            elif t_s - self._state.t_s > 2.0 * self._hold_s:
                self._commit(float(t_s) - self._hold_s)

    def add_gnss(
        self,
        t_s: float,
        position: ArrayLike,
        velocity: ArrayLike | None = None,
        position_std: ArrayLike | None = None,
        velocity_std: ArrayLike | None = None,
    ) -> None:
        """Take in one fix.

        Args:
            t_s: Its stamp [s].
            position: Shape (3,), antenna, world NED [m].
            velocity: Shape (3,), antenna, world NED [m/s], or None.
            position_std: Shape (3,), as the receiver states it [m]; the model's by default.
            velocity_std: Shape (3,), as the receiver states it [m/s]; the model's by default.

        Raises:
            ValueError: If it is not of three numbers each.
        """
        moved = _NONE3 if velocity is None else _three(velocity, "velocity")
        noise = [
            _NONE3 if std is None else _three(std, name)
            for std, name in ((position_std, "position_std"), (velocity_std, "velocity_std"))
        ]
        row = np.concatenate([_three(position, "position"), moved, *noise])
        with self._lock:
            if self._keep(self._gnss, "gnss", float(t_s), row) and self._state is None:
                self._seen_moving(float(t_s), moved)

    def add_baro(self, t_s: float, height_m: float) -> None:
        """Take in one height [m], upward, about any level."""
        with self._lock:
            self._keep(self._baro, "baro", float(t_s), np.array([height_m], np.float64))

    def world_from_camera(self, t_s: float) -> Array:
        """Return the pose of the camera, through boresight and lever arm, shape (4, 4).

        Args:
            t_s: A time of the last moments [s].

        Raises:
            NoPoseError: If the start is not known yet, the time lies too far back, or the IMU has
                not got there.
        """
        state = self.at(t_s)
        return camera_pose(state.x[:3], attitude.from_matrix(state.R), self._mounting)

    def at(self, t_s: float) -> _State:
        """Return the state at a time; see `world_from_camera`."""
        with self._lock:
            if self._state is None:
                raise NoPoseError("the start is not known yet")
            newest = self._imu[-1][0] if self._imu else -np.inf
            if t_s < self._state.t_s:
                raise NoPoseError(
                    f"{t_s:.3f} s is before {self._state.t_s:.3f} s, which was committed"
                )
            if t_s > newest + self._ahead_s:
                raise NoPoseError(f"{t_s:.3f} s is after the newest IMU sample at {newest:.3f} s")
            self._commit(min(t_s, newest - self._hold_s))
            return self._run(self._state, t_s)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the start where it is being looked for; return whether it is known."""
        thread = self._aligning
        if thread is not None:
            thread.join(timeout_s)
        return self.ready

    def _keep(self, samples: deque[Sample], sensor: str, t_s: float, row: Array) -> bool:
        """Keep a measurement in order of time; refuse what speaks of a time committed."""
        about = t_s - self._latency[sensor]
        committed = self._state is not None and about < self._state.t_s
        # a fix may lack its position or its velocity, not both
        if committed or not np.isfinite(t_s) or not np.isfinite(row[:6]).any():
            self.refused += 1
            return False
        later: list[Sample] = []
        while samples and samples[-1][0] > t_s:
            later.append(samples.pop())
        samples.append((t_s, row))
        samples.extend(reversed(later))
        return True

    def _seen_moving(self, t_s: float, velocity: Array) -> None:
        """Look for the start once the vehicle has moved for long enough."""
        speed = np.hypot(velocity[0], velocity[1])
        if self._moving_since is None and (speed > _MOVING_M_S or not np.isfinite(speed)):
            self._moving_since = t_s
        if (
            self._moving_since is not None
            and t_s - self._moving_since >= self._align_s
            and self._aligning is None
        ):
            log = self._log(-np.inf, np.inf, fresh=True)
            self._aligning = threading.Thread(target=self._align, args=(log,), daemon=True)
            self._aligning.start()

    def _align(self, log: SensorLog) -> None:
        """Find the start; try again with more of the log if that cannot be."""
        try:
            initial = align(log, self.ekf)
        except Exception as error:  # a log too short or too odd: more of it may do
            with self._lock:
                self.notes = (f"start: not found yet ({error})",)
                self._moving_since = self._aligning = None
            return
        with self._lock:
            self._initial, self.notes = initial, initial.notes
            self._forget(initial.t_s)
            self._state = self._first(initial)

    def _first(self, initial: InitialState) -> _State:
        """Return the state at the start; what it makes of the barometer's zero comes with it."""
        none = np.zeros(0)
        return _State(initial.t_s, none, none, none, {})

    def _forget(self, before_s: float) -> None:
        """Drop samples; one of the IMU stays before, for what lies between."""
        while len(self._imu) > 1 and self._imu[1][0] <= before_s:
            self._imu.popleft()
        for sensor, samples in (("gnss", self._gnss), ("baro", self._baro)):
            while samples and samples[0][0] - self._latency[sensor] <= before_s - MICRO:
                samples.popleft()

    def _commit(self, t_s: float) -> None:
        """Run the state forward for good."""
        state = self._state
        if state is None or t_s - state.t_s < 2.0 * MICRO:
            return
        self._state = self._run(state, t_s)
        # what speaks of that very moment is in it
        self._forget(self._state.t_s + 2.0 * MICRO)

    def _run(self, state: _State, t_s: float) -> _State:
        """Return the state at a later time."""
        initial = self._initial
        if initial is None:
            raise NoPoseError("the start is not known yet")
        fresh = not len(state.x)
        log = self._log(state.t_s, t_s, fresh)
        stop = max(t_s, state.t_s + 2.0 * MICRO)
        epochs = epochs_of(
            log,
            state.t_s,
            stop,
            gnss_latency_s=self._latency["gnss"],
            baro_latency_s=self._latency["baro"],
            max_step_s=self.ekf.max_step_s,
        )
        run = ErrorStateRun(self.ekf, log, initial, epochs, keep=False)
        if not fresh:
            run.resume(state.x, state.R, state.C, state.gates)
        run.states(None)
        return _State(float(epochs.t_s[-1]), run.x, run.R, run.C, run.gates)

    def _log(self, after_s: float, until_s: float, fresh: bool) -> SensorLog:
        """Return the samples of a span; those at its very start belong to it if it is fresh."""
        least = after_s - MICRO if fresh else after_s + MICRO

        def inside(sensor: str, samples: deque[Sample]) -> list[Sample]:
            late = self._latency[sensor]
            return [s for s in samples if least < s[0] - late <= until_s + MICRO]

        imu: list[Sample] = []
        for sample in self._imu:
            imu.append(sample)
            if sample[0] >= until_s:
                break
        t = np.array([s[0] for s in imu])
        rows = np.array([s[1] for s in imu]).reshape(-1, 6)
        if np.isfinite(until_s) and len(t) and t[-1] < until_s:  # held until the next sample
            t, rows = np.append(t, until_s), np.vstack([rows, rows[-1:]])
        fixes, heights = inside("gnss", self._gnss), inside("baro", self._baro)
        fix = np.array([s[1] for s in fixes]).reshape(-1, 12)
        stated = bool(np.isfinite(fix[:, 6:]).all()) and len(fix) > 0
        gnss = GnssLog(
            np.array([s[0] for s in fixes]),
            fix[:, 0:3],
            fix[:, 3:6],
            fix[:, 6:9] if stated else None,
            fix[:, 9:12] if stated else None,
        )
        baro = BaroLog(np.array([s[0] for s in heights]), np.array([s[1][0] for s in heights]))
        return SensorLog(
            ImuLog(t, rows[:, :3], rows[:, 3:]),
            gnss if fixes else None,
            baro if heights else None,
            origin=self._origin,
            mounting=self._mounting,
        )


def _three(values: ArrayLike, name: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (3,):
        raise ValueError(f"{name} must be 3 numbers, got shape {array.shape}")
    return array
