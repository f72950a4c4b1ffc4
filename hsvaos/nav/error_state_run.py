"""One pass of the error-state filter over a log."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.attitude import rotation_of
from hsvaos.nav.epochs import Epochs
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import SensorLog
from hsvaos.nav.measurements import (
    BA,
    BG,
    PHI,
    P,
    Rows,
    V,
    baro_height,
    gnss_position,
    gnss_velocity,
)
from hsvaos.nav.process import Process, Steps, bare_steps, gravity_of
from hsvaos.nav.sensor_models import GnssModel
from hsvaos.nav.states import History, InnovationLog, States
from hsvaos.nav.strapdown import ImuTimeline

if TYPE_CHECKING:
    from hsvaos.nav.error_state_ekf import ErrorStateEkf

Array = NDArray[np.float64]

_BLOCK = 512
_WIDEST = np.repeat([100.0, 20.0, 0.5], 3)
"""Spreads beyond which a recovery does not widen position [m], velocity [m/s], attitude [rad]."""


@dataclass
class _Gate:
    """Refusals of one sensor: its threshold by rows, and since when it is refused."""

    refused_since: float = math.inf


class ErrorStateRun:
    """One pass of a filter over a log."""

    def __init__(
        self, ekf: ErrorStateEkf, log: SensorLog, initial: InitialState, epochs: Epochs, keep: bool
    ) -> None:
        self.ekf, self.log, self.epochs, self.keep = ekf, log, epochs, keep
        self.layout = ekf.layout
        n = self.layout.size
        self.x = np.zeros(n)
        self.x[P], self.x[V] = initial.position, initial.velocity
        self.x[BG], self.x[BA] = initial.gyro_bias, initial.accel_bias
        self.R = attitude.matrix(initial.quaternion)
        std = np.zeros(n)
        std[:15] = initial.std
        self.notes = initial.notes
        if self.layout.baro_bias and ekf.baro is not None:
            self.x[15], std[15] = self._baro_zero(ekf.baro.bias_std, initial)
        if self.layout.wander and ekf.gnss is not None:
            std[self.layout.wander_at] = ekf.gnss.wander_axes
        self.C = np.diag(std**2)
        self.lever = np.asarray(log.mounting.antenna_lever_arm, dtype=np.float64)
        self.gates: dict[str, _Gate] = {}
        self.innovations = InnovationLog()
        self.gnss_std = gnss_noise(log, ekf.gnss)

    def resume(self, x: Array, R: Array, C: Array, gates: dict[str, _Gate]) -> None:
        """Go on from where another run ended, which stays as it is.

        Args:
            x: Shape (n,), its state.
            R: Shape (3, 3), its attitude.
            C: Shape (n, n), its covariance.
            gates: What its gates remember.
        """
        self.x, self.R, self.C = x, R, C
        self.gates = {name: replace(gate) for name, gate in gates.items()}

    def _baro_zero(self, bias_std: float, initial: InitialState) -> tuple[float, float]:
        """Return the offset of the barometer to begin with and how sure it is [m]."""
        baro = self.log.baro
        if baro is None or not len(baro.t_s):
            return 0.0, bias_std
        near = int(np.argmin(np.abs(baro.t_s - initial.t_s)))
        apart = float(baro.height_m[near]) + float(initial.position[2])
        unsure = float(np.hypot(bias_std, initial.position_std[2]))
        if abs(apart) < 5.0 * unsure:
            return 0.0, bias_std
        # it counts from another level (the sea, the standard atmosphere)
        note = f"baro: its zero is {apart:+.1f} m off that of the local frame: taken as its offset"
        self.notes = (*self.notes, note)
        return apart, 3.0 * unsure

    def states(self, progress: Callable[[float], None] | None) -> States:
        """Run over all epochs."""
        epochs, n = self.epochs, self.layout.size
        count = len(epochs.t_s)
        timeline = ImuTimeline(self.log.imu, epochs.t_s)
        ekf = self.ekf
        process = Process(ekf.imu, ekf.gnss, ekf.baro, self.layout, gravity_of(self.log))
        vector, rotation = np.empty((count, n)), np.empty((count, 3, 3))
        covariance = np.empty((count, n, n))
        kept = count if self.keep else 1
        before = History(
            np.empty((kept, n)),
            np.empty((kept, 3, 3)),
            np.empty((kept, n, n)),
            np.zeros((kept, n, n)),
        )
        first, steps, size = 0, bare_steps(), 64
        for k in range(count):
            if k > 0:
                if k > first + len(steps.duration):
                    first, last = k - 1, min(k - 1 + size, count - 1)
                    steps = process.steps(timeline, first, last, self.x[9:15].copy())
                    size = min(2 * size, _BLOCK)
                    if progress is not None:
                        progress(k / count)
                transition = self._propagate(steps, k - 1 - first)
                if self.keep:
                    before.transition[k] = transition
            if self.keep:
                before.vector[k], before.rotation[k] = self.x, self.R
                before.covariance[k] = self.C
            if epochs.gnss[k] >= 0:
                self._use_gnss(epochs.t_s[k], int(epochs.gnss[k]), timeline.gyro_at(k))
            if epochs.baro[k] >= 0:
                self._use_baro(epochs.t_s[k], int(epochs.baro[k]))
            vector[k], rotation[k], covariance[k] = self.x, self.R, self.C
        if progress is not None:
            progress(1.0)
        return States(
            t_s=epochs.t_s,
            vector=vector,
            rotation=rotation,
            covariance=covariance,
            layout=self.layout,
            innovations=self.innovations.result(),
            notes=self.notes + self._left_out(),
            history=before if self.keep else None,
        )

    def _left_out(self) -> tuple[str, ...]:
        """Say which measurements could not be used."""
        return tuple(
            f"{number} {sensor} measurements before or after the span of the filter were left out"
            for sensor, number in self.epochs.left_out.items()
            if number
        )

    def _propagate(self, steps: Steps, i: int) -> Array:
        """Take one step; return the transition of the error."""
        x, R = self.x, self.R
        bias = x[9:15] - steps.bias
        turn, push, shift = (steps.by_bias[i] @ bias).reshape(3, 3)
        T = steps.duration[i]
        new = x.copy()
        fall = steps.gravity * T
        new[0:3] += x[3:6] * T + R @ (steps.position[i] + shift)
        new[2] += 0.5 * fall * T
        new[3:6] += R @ (steps.velocity[i] + push)
        new[5] += fall
        if self.layout.wander:
            new[self.layout.wander_at] *= steps.keep_wander[i]
        self.x, self.R = new, R @ rotation_of(turn) @ steps.rotation[i]
        # body axes at the start -> world axes, for the three parts that have axes
        A = steps.axes
        A[0:3, 0:3] = A[3:6, 3:6] = A[6:9, 6:9] = R
        transition = A @ steps.transition[i] @ A.T
        self.C = transition @ self.C @ transition.T + A @ steps.noise[i] @ A.T
        return np.asarray(transition)

    def _use_gnss(self, t: float, index: int, rate: Array) -> None:
        """Update with one fix: position, then velocity."""
        gnss: Any = self.log.gnss
        std = self.gnss_std[0][index]
        rows = gnss_position(gnss.position[index], std, self.x, self.R, self.lever, self.layout)
        self._update("gnss position", t, rows)
        std = self.gnss_std[1][index]
        rows = gnss_velocity(
            gnss.velocity[index], std, self.x, self.R, self.lever, rate, self.layout
        )
        self._update("gnss velocity", t, rows)

    def _use_baro(self, t: float, index: int) -> None:
        """Update with one height."""
        baro, model = self.log.baro, self.ekf.baro
        if baro is None or model is None:
            return
        rows = baro_height(float(baro.height_m[index]), model.noise_std, self.x, self.layout)
        self._update("baro", t, rows)

    def _update(self, sensor: str, t: float, rows: Rows) -> None:
        """Correct by one measurement, if it passes its gate (Joseph form)."""
        residual, H, variance = rows
        if not len(residual):
            return
        HC = H @ self.C
        S = HC @ H.T
        S.flat[:: len(residual) + 1] += variance
        inverse = _inverse(S)
        nis = math.inf if inverse is None else float(residual @ inverse @ residual)
        accepted = nis <= self.ekf.limit(len(residual))
        gate = self.gates.setdefault(sensor, _Gate())
        self.innovations.add(sensor, t, residual, np.sqrt(S.diagonal()), nis, accepted)
        if not accepted:
            gate.refused_since = min(gate.refused_since, t)
            if inverse is None or t - gate.refused_since < self.ekf.recovery_s:
                return
            # The state is wrong, not the sensor. Widening position, velocity and attitude alike
            # keeps how their errors hang together: a wrong velocity may come from a wrong heading.
            self.innovations.recovered(sensor)
            wider = np.ones(self.layout.size)
            room = _WIDEST / np.sqrt(self.C.diagonal()[:9])
            wider[:9] = np.minimum(math.sqrt(max(1.0, nis / len(residual))), room).clip(1.0)
            self.C = self.C * np.outer(wider, wider)
            HC = H @ self.C
            S = HC @ H.T
            S.flat[:: len(residual) + 1] += variance
            inverse = _inverse(S)
        if inverse is None:
            return
        gate.refused_since = math.inf
        K = HC.T @ inverse
        A = self.C - K @ HC
        C = A - (A @ H.T) @ K.T + (K * variance) @ K.T
        self.C = 0.5 * (C + C.T)
        self._inject(K @ residual)

    def _inject(self, error: Array) -> None:
        """Move the nominal state by an estimated error."""
        phi = error[PHI].copy()
        self.x = self.x + error
        self.x[PHI] = 0.0
        self.R = rotation_of(phi) @ self.R
        if 1e-6 < phi @ phi < 1.0:
            # the error that is left is measured from the turned attitude: phi' = (1 + [phi]x/2) phi
            G = np.eye(3) + 0.5 * attitude.skew(phi)
            self.C[PHI] = G @ self.C[PHI]
            self.C[:, PHI] = self.C[:, PHI] @ G.T


def gnss_noise(log: SensorLog, model: GnssModel | None) -> tuple[Array, Array]:
    """Return the noise of each fix, position and velocity: the receiver's word, else the model's.

    Returns:
        Shapes (M, 3) [m] and (M, 3) [m/s].

    Raises:
        ValueError: If neither says.
    """
    gnss, out = log.gnss, []
    for name in ("position", "velocity"):
        std = np.zeros((0, 3)) if gnss is None else getattr(gnss, f"{name}_std")
        if std is None:
            if gnss is None or model is None:
                raise ValueError(
                    f"{log.name}: the GNSS log states no {name} noise: expected a GnssModel or "
                    "std columns, got neither"
                )
            level = model.position_axes if name == "position" else model.velocity_axes
            std = np.tile(level, (len(gnss.t_s), 1))
        out.append(std)
    return out[0], out[1]


def _inverse(S: Array) -> Array | None:
    """Inverse of an innovation's covariance; None where rounding left it singular.

    That is where an estimate is lost: the measurement counts as refused, and whoever asked for the
    estimate is told by how many were.
    """
    if len(S) == 1:
        return np.asarray(1.0 / S)  # what most updates need, faster
    try:
        return np.asarray(np.linalg.inv(S))
    except np.linalg.LinAlgError:
        return None
