"""Which sensors wrote a log, and how late its fixes are: found by what foresees the log best.

Each hypothesis runs a fast filter over a piece of the log; the likelihood of its innovations
decides. Chosen are presets of `sensor_models`, not free numbers, so that a short log cannot be
explained by a model that no sensor has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav.align import coarse_start, first_state, refine, score, scout, window_end
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import BaroLog, SensorLog
from hsvaos.nav.sensor_models import (
    BARO_MODELS,
    GNSS_MODELS,
    IMU_MODELS,
    BaroModel,
    GnssModel,
    ImuModel,
)

Array = NDArray[np.float64]

_LATENCIES_S = np.arange(-1, 11) * 0.05
_PIECE_S = 80.0
_DECISIVE = 8.0
"""Difference of log-likelihood below which the plain hypothesis stays."""


@dataclass(frozen=True, eq=False)
class Models:
    """The models to filter a log with.

    Args:
        imu: Inertial sensor.
        gnss: Receiver, latency included.
        baro: Barometer.
        log: The log; without the receiver's own noise figures where a preset explains it better.
        prior: The first guess of the start and its uncertainty.
        start: Where to start.
        notes: What was chosen, one line each.
    """

    imu: ImuModel
    gnss: GnssModel
    baro: BaroModel
    log: SensorLog
    prior: InitialState
    start: InitialState
    notes: tuple[str, ...]


def fit_models(
    log: SensorLog,
    imu: ImuModel | None = None,
    gnss: GnssModel | None = None,
    baro: BaroModel | None = None,
    *,
    gnss_latency_s: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Models:
    """Return models for a log: those given, and for the rest the presets that fit best.

    Args:
        log: The log, checked.
        imu: Inertial sensor, or None to choose.
        gnss: Receiver, or None to choose. If given, noise stated in the log still comes first.
        baro: Barometer, or None for "ms5611".
        gnss_latency_s: How late fixes are stamped, or None to estimate it [s].
        progress: Called with the share done, 0..1.
    """
    done = progress or (lambda share: None)
    first_imu, first_gnss = imu or IMU_MODELS["autopilot"], gnss or GNSS_MODELS["standalone"]
    if gnss_latency_s is not None:
        first_gnss = replace(first_gnss, latency_s=gnss_latency_s)
    baro = baro or BARO_MODELS["ms5611"]
    bare = _thinned(log if gnss is not None else _without_noise(log))
    first_ekf = ErrorStateEkf(first_imu, first_gnss, baro)
    prior = coarse_start(bare, first_ekf)
    start = refine(bare, first_ekf, prior, stop_s=window_end(log, prior.t_s), rounds=1)
    done(0.3)
    notes: list[str] = []
    trial = _Trial(bare, start)
    if gnss_latency_s is None:
        latency = _latency(trial, first_imu, first_gnss)
        notes.append(f"gnss: latency {latency:.3f} s (estimated)")
        first_gnss = replace(first_gnss, latency_s=latency)
    done(0.6)
    if imu is None:
        names = ("adis16448", "adis16448-rotors", "consumer", "autopilot")
        values = [trial.score(IMU_MODELS[name], first_gnss) for name in names]
        imu = IMU_MODELS[names[int(np.argmax(values))]]
        notes.append(f"imu: noise of preset {names[int(np.argmax(values))]!r} (fits best)")
    done(0.8)
    chosen = first_gnss
    if gnss is None:
        name, chosen, own = _receiver(log, bare, start, imu, first_gnss.latency_s)
        log = log if own else _without_noise(log)
        notes.append(f"gnss: noise {name} (fits best)")
    done(1.0)
    ekf = ErrorStateEkf(imu, chosen, baro)
    first = first_state(log, ekf)
    prior = prior.replace(
        t_s=first.t_s,
        position=first.position,
        velocity=first.velocity,
        position_std=first.position_std,
        velocity_std=first.velocity_std,
        gyro_bias_std=first.gyro_bias_std,
        accel_bias_std=first.accel_bias_std,
    )
    stop = min(window_end(log, prior.t_s), prior.t_s + _PIECE_S)
    start = refine(_thinned(log), ekf, prior, stop_s=stop)
    return Models(imu, chosen, baro, log, prior, start, tuple(notes))


class _Trial:
    """Scores hypotheses on the same piece of a log from the same start."""

    def __init__(self, log: SensorLog, start: InitialState, *, whole: bool = False) -> None:
        self.log = log
        # wide enough for any of the hypotheses, so that none is judged by the start
        self.start = start.replace(
            position_std=np.full(3, 20.0),
            velocity_std=np.full(3, 3.0),
            attitude_std=np.radians([5.0, 5.0, 20.0]),
        )
        self.after = start.t_s + float(_LATENCIES_S[-1]) + 5.0
        self.stop = float(log.imu.t_s[-1]) if whole else self._piece()

    def _piece(self) -> float:
        """Return the end of a piece with motion in it [s]."""
        gnss = self.log.gnss
        moving = self.start.t_s
        if gnss is not None:
            speed = np.linalg.norm(np.nan_to_num(gnss.velocity), axis=1)
            fast = gnss.t_s[(speed > 1.5) & (gnss.t_s > self.start.t_s)]
            moving = float(fast[0]) if len(fast) else moving
        return min(moving + _PIECE_S, float(self.log.imu.t_s[-1]))

    def score(
        self, imu: ImuModel, gnss: GnssModel, *, gate: float = 1e-5, worst: float = 100.0
    ) -> float:
        """Return the log-likelihood of the fixes of the piece."""
        ekf = scout(ErrorStateEkf(imu, gnss), gate=gate)
        states = ekf.run(self.log, self.start, keep_history=False, stop_s=self.stop)
        # by the stamp, so that every latency is judged by the same fixes
        return score(states, self.after - gnss.latency_s, worst)


def _latency(trial: _Trial, imu: ImuModel, gnss: GnssModel) -> float:
    """Return the latency of the fixes that explains them best [s], or 0 if none does clearly."""
    values = [
        trial.score(imu, replace(gnss, latency_s=float(x)), gate=0.0, worst=25.0)
        for x in _LATENCIES_S
    ]
    plain = values[1]  # no latency
    best = int(np.argmax(values))
    if values[best] - plain < _DECISIVE:
        return 0.0
    if 0 < best < len(values) - 1:
        low, high = values[best - 1] - values[best], values[best + 1] - values[best]
        shift = 0.5 * (low - high) / (low + high) if low + high < 0.0 else 0.0
    else:
        shift = 0.0
    step = float(_LATENCIES_S[1] - _LATENCIES_S[0])
    return round(float(_LATENCIES_S[best]) + shift * step, 3)


def _receiver(
    log: SensorLog, bare: SensorLog, start: InitialState, imu: ImuModel, latency_s: float
) -> tuple[str, GnssModel, bool]:
    """Return what to call the best receiver model, the model, whether the log's noise is used."""
    log = _thinned(log)
    options = [
        (f"of preset {name!r}", replace(model, latency_s=latency_s), False)
        for name, model in GNSS_MODELS.items()
    ]
    if log.gnss is not None and log.gnss.position_std is not None:
        logged = replace(GNSS_MODELS["single"], latency_s=latency_s)
        options.append(("as the receiver states it", logged, True))
    # over the whole log: a receiver is as good as its worst minute
    values = [
        _Trial(log if own else bare, start, whole=True).score(imu, model)
        for _, model, own in options
    ]
    return options[int(np.argmax(values))]


def _velocity_only(log: SensorLog) -> SensorLog:
    """Return the log without positions (their slow errors blur latency), if it has velocities."""
    gnss = log.gnss
    if gnss is None or np.isfinite(gnss.velocity).all(axis=1).mean() < 0.5:
        return log
    return log.replace(gnss=replace(gnss, position=np.full_like(gnss.position, np.nan)))


def _thinned(log: SensorLog) -> SensorLog:
    """Return the log with every n-th height only, ten a second: enough to judge the rest by."""
    baro = log.baro
    if baro is None or len(baro.t_s) < 2:
        return log
    every = max(1, int(len(baro.t_s) / (baro.t_s[-1] - baro.t_s[0]) / 10.0))
    return log.replace(baro=BaroLog(baro.t_s[::every], baro.height_m[::every]))


def _without_noise(log: SensorLog) -> SensorLog:
    """Return the log without the receiver's own noise figures."""
    if log.gnss is None:
        return log
    return log.replace(gnss=replace(log.gnss, position_std=None, velocity_std=None))
