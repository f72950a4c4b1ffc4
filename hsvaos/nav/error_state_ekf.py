"""Error-state extended Kalman filter on the manifold: 15 states and up to 4 more.

Nominal state: position, velocity (world NED), attitude as a rotation matrix, biases of gyroscope
and accelerometer; optionally the offset of the barometer and a slow GNSS position error. The error
of the attitude is a rotation vector in world axes, R_true = exp(phi) R, so attitude covariance
reads directly as roll-about-north, pitch-about-east, yaw. One step goes from measurement to
measurement by preintegrated IMU increments (`strapdown`), exact in rotation, with

    phi' = phi + R J dbg,   dv' = dv - [R dv_k]x phi + R (Jv dbg + J dba),   dp' likewise,

and white noise integrated over the step. Flat, not turning Earth: over a flight the Earth's rate
(15 deg/h) is taken up by the gyroscope bias.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from hsvaos.nav.chi_square import chi_square_quantile
from hsvaos.nav.epochs import epochs_of
from hsvaos.nav.error_state_run import ErrorStateRun
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import SensorLog
from hsvaos.nav.measurements import Layout
from hsvaos.nav.sensor_models import BaroModel, GnssModel, ImuModel
from hsvaos.nav.states import States


class ErrorStateEkf:
    """Error-state EKF with gates, latencies, lever arm and optional slow sensor errors.

    Args:
        imu: Noise of the inertial sensor.
        gnss: Noise of the receiver, used where the log states none. A `wander_std` above zero
            makes the slow position error a state; `latency_s` is taken off the stamps.
        baro: Noise of the barometer. A `bias_std` or `bias_walk` above zero makes its offset a
            state; `latency_s` is taken off the stamps.
        gate: Probability that a good measurement is refused; 0 turns the gates off.
        recovery_s: A sensor that was refused for this long is let in again, and the state that
            disagrees with it made as uncertain as the disagreement is large [s].
        max_step_s: Longest step between epochs [s].

    Raises:
        ValueError: If a parameter is out of its range.
    """

    def __init__(
        self,
        imu: ImuModel,
        gnss: GnssModel | None = None,
        baro: BaroModel | None = None,
        *,
        gate: float = 1e-4,
        recovery_s: float = 5.0,
        max_step_s: float = 0.1,
    ) -> None:
        if not (0.0 <= gate < 0.5):
            raise ValueError(f"gate must be a probability from 0 to below 0.5, got {gate!r}")
        if not (recovery_s > 0.0 and max_step_s > 0.0):
            raise ValueError(
                f"recovery_s and max_step_s must be positive, got {recovery_s!r}, {max_step_s!r}"
            )
        self.imu, self.gnss, self.baro = imu, gnss, baro
        self.recovery_s, self.max_step_s = recovery_s, max_step_s
        self.layout = Layout(
            baro_bias=baro is not None and (baro.bias_std > 0.0 or baro.bias_walk > 0.0),
            wander=gnss is not None and max(gnss.wander_std) > 0.0,
        )
        self._limits = [
            math.inf if gate == 0.0 or rows == 0 else chi_square_quantile(1.0 - gate, rows)
            for rows in range(4)
        ]

    def run(
        self,
        log: SensorLog,
        initial: InitialState | None = None,
        *,
        keep_history: bool = True,
        stop_s: float | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> States:
        """Filter a log.

        Args:
            log: The log, checked (`checks.check_log`) if it comes from a file.
            initial: Where to start; found from the log (`align.align`) if not given.
            keep_history: Whether to keep what `smooth` needs.
            stop_s: Where to stop [s]; at the end of the IMU log by default.
            progress: Called with the share done, 0..1, now and then.

        Returns:
            States at every epoch.

        Raises:
            ValueError: If there is nothing to filter.
        """
        if initial is None:
            from hsvaos.nav.align import align

            initial = align(log, self)
        stop = float(log.imu.t_s[-1]) if stop_s is None else min(stop_s, float(log.imu.t_s[-1]))
        if not (log.imu.t_s[0] <= initial.t_s < stop):
            raise ValueError(
                f"{log.name}: the filter must start within the IMU log "
                f"({log.imu.t_s[0]:.3f} s to {stop:.3f} s), got {initial.t_s:.3f} s"
            )
        epochs = epochs_of(
            log,
            initial.t_s,
            stop,
            gnss_latency_s=self.gnss.latency_s if self.gnss is not None else 0.0,
            baro_latency_s=self.baro.latency_s if self.baro is not None else 0.0,
            max_step_s=self.max_step_s,
        )
        return ErrorStateRun(self, log, initial, epochs, keep_history).states(progress)

    def limit(self, rows: int) -> float:
        """Return the gate of the NIS of a measurement of up to three rows."""
        return self._limits[rows]
