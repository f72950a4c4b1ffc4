"""What a filter leaves behind: its states epoch by epoch, and how well the sensors agreed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav import attitude
from hsvaos.nav.chi_square import mean_bounds
from hsvaos.nav.log import TrueMotion
from hsvaos.nav.measurements import BA, BG, Layout, P, V

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Innovations:
    """How the measurements of one sensor fell against their prediction.

    Args:
        t_s: Shape (M,), time the measurement speaks of, latency removed [s].
        residual: Shape (M, m), measured less predicted, NaN where a row did not arrive.
        std: Shape (M, m), predicted spread of the residual.
        nis: Shape (M,), normalised innovation squared, r' S^-1 r.
        dof: Shape (M,), rows that arrived.
        accepted: Shape (M,), bool, False where the gate refused it.
        recoveries: How often the sensor was let in again after refusals without end.
    """

    t_s: Array
    residual: Array
    std: Array
    nis: Array
    dof: NDArray[np.int64]
    accepted: NDArray[np.bool_]
    recoveries: int = 0

    @property
    def mean_nis(self) -> float:
        """Mean NIS of the accepted measurements for each degree of freedom; 1 if consistent."""
        dof = int(self.dof[self.accepted].sum())
        return float(self.nis[self.accepted].sum() / dof) if dof else float("nan")

    @property
    def gated(self) -> int:
        """Number of measurements refused."""
        return int((~self.accepted).sum())

    @property
    def bounds(self) -> tuple[float, float]:
        """Where `mean_nis` lies with 95 % probability if the models hold and noise is white."""
        dof = int(self.dof[self.accepted].sum())
        return mean_bounds(0.95, 1.0, dof) if dof else (float("nan"), float("nan"))


@dataclass(frozen=True, eq=False)
class States:
    """States at epochs, and their uncertainty.

    The attitude error is a rotation vector in world axes: true R = exp(error) R.

    Args:
        t_s: Shape (K,) [s].
        vector: Shape (K, n): position [m], velocity [m/s] (world NED), three unused numbers,
            gyroscope [rad/s] and accelerometer [m/s^2] bias, then the optional parts of `layout`.
        rotation: Shape (K, 3, 3), world_from_body.
        covariance: Shape (K, n, n), of the error state.
        layout: The parts of the state.
        innovations: By sensor: "gnss position", "gnss velocity", "baro".
        notes: What was assumed, repaired or left out, one line each.
        smoothed: Whether later measurements are in it.
        history: What the smoother needs, or None: predictions and transitions.
    """

    t_s: Array
    vector: Array
    rotation: Array
    covariance: Array
    layout: Layout = field(default_factory=Layout)
    innovations: dict[str, Innovations] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    smoothed: bool = False
    history: History | None = None

    @property
    def position(self) -> Array:
        """Shape (K, 3), world NED [m]."""
        return self.vector[:, P]

    @property
    def velocity(self) -> Array:
        """Shape (K, 3), world NED [m/s]."""
        return self.vector[:, V]

    @property
    def quaternion(self) -> Array:
        """Shape (K, 4), world_from_body, w first."""
        return attitude.from_matrix(self.rotation)

    @property
    def gyro_bias(self) -> Array:
        """Shape (K, 3), body axes [rad/s]."""
        return self.vector[:, BG]

    @property
    def accel_bias(self) -> Array:
        """Shape (K, 3), body axes [m/s^2]."""
        return self.vector[:, BA]

    def nees(self, truth: TrueMotion) -> Array:
        """Return the normalised estimation error squared of position, velocity and attitude.

        Args:
            truth: The true path; epochs must lie within it.

        Returns:
            Shape (K,): e' P^-1 e over the first nine errors; 9 on average if consistent.
        """
        position, velocity, q = truth.at(self.t_s)
        error = np.concatenate(
            [
                position - self.position,
                velocity - self.velocity,
                attitude.log(attitude.multiply(q, attitude.conjugate(self.quaternion))),
            ],
            axis=1,
        )
        weighted = np.linalg.solve(self.covariance[:, :9, :9], error[..., None])[..., 0]
        return np.asarray(np.sum(error * weighted, axis=1))


@dataclass(frozen=True, eq=False)
class History:
    """Predictions at each epoch, before its measurements; row k predicts epoch k from k - 1.

    Args:
        vector: Shape (K, n).
        rotation: Shape (K, 3, 3).
        covariance: Shape (K, n, n).
        transition: Shape (K, n, n), error at k from error at k - 1.
    """

    vector: Array
    rotation: Array
    covariance: Array
    transition: Array


class InnovationLog:
    """Collects innovations while a filter runs."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[Any, ...]]] = {}
        self._recoveries: dict[str, int] = {}

    def add(
        self, sensor: str, t: float, residual: Array, std: Array, nis: float, accepted: bool
    ) -> None:
        """Note one measurement of a sensor."""
        self._rows.setdefault(sensor, []).append((t, residual, std, nis, accepted))

    def recovered(self, sensor: str) -> None:
        """Note that a sensor was let in again."""
        self._recoveries[sensor] = self._recoveries.get(sensor, 0) + 1

    def result(self) -> dict[str, Innovations]:
        """Return the innovations of each sensor as arrays."""
        out = {}
        for sensor, rows in self._rows.items():
            width = max(len(row[1]) for row in rows)
            residual = np.full((len(rows), width), np.nan)
            std = residual.copy()
            for i, row in enumerate(rows):
                residual[i, : len(row[1])] = row[1]
                std[i, : len(row[2])] = row[2]
            out[sensor] = Innovations(
                t_s=np.array([row[0] for row in rows]),
                residual=residual,
                std=std,
                nis=np.array([row[3] for row in rows]),
                dof=np.array([len(row[1]) for row in rows], dtype=np.int64),
                accepted=np.array([row[4] for row in rows], dtype=bool),
                recoveries=self._recoveries.get(sensor, 0),
            )
        return out
