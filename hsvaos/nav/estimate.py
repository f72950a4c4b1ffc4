"""From a log to a trajectory, in one call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from hsvaos.flight import Flight, FlightError
from hsvaos.nav import attitude
from hsvaos.nav.align import moved
from hsvaos.nav.checks import check_log
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.fit import Models, fit_models
from hsvaos.nav.log import SensorLog
from hsvaos.nav.paper_ekf import PaperEkf
from hsvaos.nav.sensor_models import (
    BARO_MODELS,
    GNSS_MODELS,
    IMU_MODELS,
    BaroModel,
    GnssModel,
    ImuModel,
)
from hsvaos.nav.smoother import smooth as smooth_states
from hsvaos.nav.states import States
from hsvaos.nav.trajectory import Trajectory, trajectory_of

T = TypeVar("T")

_PASSES = 4
_LEAST_JUDGED = 10
_LEAST_ACCEPTED = 0.1

FILTERS = ("error-state", "paper")
"""Names of the filters."""


def estimate_trajectory(
    flight: Flight | SensorLog | str | Path,
    *,
    filter: str = "error-state",
    smooth: bool = True,
    imu: ImuModel | str | None = None,
    gnss: GnssModel | str | None = None,
    baro: BaroModel | str | None = None,
    gnss_latency_s: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Trajectory:
    """Estimate where a vehicle flew and how it pointed, from its sensor log.

    Args:
        flight: A flight with sensors, a log, or the path of one (a flight folder, a folder with
            imu.csv, a PX4 .ulg, an ArduPilot .bin).
        filter: "error-state", or "paper" for the 16-state filter of the paper, which takes no
            latency, gates nothing and is never smoothed.
        smooth: Whether later measurements may correct earlier states.
        imu: Model or name of a preset; what fits the log best by default.
        gnss: The same; noise stated in the log comes before that of a model given here.
        baro: The same; "ms5611" by default.
        gnss_latency_s: How late fixes are stamped [s]; estimated by default.
        progress: Called with the name of a stage and the share of it that is done.

    Returns:
        The trajectory; its notes say what was assumed.

    Raises:
        FlightError: If the log cannot be used, or the estimate lost the fixes.
        ValueError: If an argument is not one of those named.
    """
    if filter not in FILTERS:
        raise ValueError(f"filter must be one of {', '.join(FILTERS)}, got {filter!r}")

    def report(stage: str) -> Callable[[float], None] | None:
        return None if progress is None else lambda share: progress(stage, share)

    log = flight if isinstance(flight, SensorLog) else _open(flight)
    log = check_log(log)
    models = fit_models(
        log,
        _model(imu, IMU_MODELS, "imu"),
        _model(gnss, GNSS_MODELS, "gnss"),
        _model(baro, BARO_MODELS, "baro"),
        gnss_latency_s=gnss_latency_s,
        progress=report("models"),
    )
    if filter == "paper":
        states = PaperEkf(
            models.imu, replace(models.gnss, latency_s=0.0), _noise_of(models.baro)
        ).run(_zeroed(models), models.start, progress=report("filter"))
    else:
        states = _error_state(models, smooth, report)
    _refuse_lost(log.name, states)
    notes = (*models.notes, *states.notes)
    return trajectory_of(replace(states, notes=notes, history=None), models.log)


def _error_state(
    models: Models, smooth: bool, report: Callable[[str], Callable[[float], None] | None]
) -> States:
    """Filter, tune the barometer to its log, smooth, and once more if the start was far off."""
    ekf = ErrorStateEkf(models.imu, models.gnss, models.baro)
    start = models.start
    states = ekf.run(models.log, start, keep_history=smooth, progress=report("filter"))
    ratio = _spread_ratio(states)
    if not 0.5 < ratio < 2.0:
        baro = replace(models.baro, noise_std=float(models.baro.noise_std * np.sqrt(ratio)))
        ekf = ErrorStateEkf(models.imu, models.gnss, baro)
        states = ekf.run(models.log, start, keep_history=smooth, progress=report("filter"))
        note = f"baro: noise {baro.noise_std:.2f} m (from its innovations)"
        states = replace(states, notes=(*states.notes, note))
    if not smooth:
        return states
    out = smooth_states(states)
    for _ in range(_PASSES):
        before, start = start.quaternion, moved(models.prior, start, out)
        turn = attitude.log(attitude.multiply(start.quaternion, attitude.conjugate(before)))
        if float(np.abs(turn).max()) < np.radians(0.25):
            break
        # linearised that far off: worth another pass from where the last one leads
        again = ekf.run(models.log, start, progress=report("filter"))
        out = replace(smooth_states(again), notes=states.notes)
    return out


def _refuse_lost(name: str, states: States) -> None:
    """Refuse an estimate that hardly any fix agrees with."""
    if not np.isfinite(states.vector).all():
        raise FlightError(
            f"{name}: the estimate is lost: expected finite states, got some that are not; check "
            "the IMU for spikes, its units and its axes (forward, right, down)"
        )
    accepted = [
        seen.accepted for sensor, seen in states.innovations.items() if sensor.startswith("gnss")
    ]
    passed, count = sum(int(a.sum()) for a in accepted), sum(len(a) for a in accepted)
    if count >= _LEAST_JUDGED and passed < _LEAST_ACCEPTED * count:
        raise FlightError(
            f"{name}: the estimate is lost: expected most GNSS measurements within their gate, got "
            f"{passed} of {count}; the IMU does not fit the fixes: check it for spikes, its axes "
            "(forward, right, down) and that both keep one clock"
        )


def _spread_ratio(states: States) -> float:
    """Return how many times the barometer's NIS exceeds what it should be, by its median."""
    baro = states.innovations.get("baro")
    if baro is None or len(baro.nis) < 50:
        return 1.0
    return float(np.median(baro.nis)) / 0.4549  # median of chi-square with one degree


def _noise_of(baro: BaroModel) -> BaroModel:
    """Return a barometer without offset: the paper's filter has no state for it."""
    return replace(baro, bias_std=0.0, bias_walk=0.0)


def _zeroed(models: Models) -> SensorLog:
    """Return the log with the barometer set to the height of the start, as before a take-off."""
    log, start = models.log, models.start
    if log.baro is None or not len(log.baro.t_s):
        return log
    near = int(np.argmin(np.abs(log.baro.t_s - start.t_s)))
    offset = float(log.baro.height_m[near]) + float(start.position[2])
    if abs(offset) < 5.0 * max(float(start.position_std[2]), models.baro.bias_std):
        return log
    return log.replace(baro=replace(log.baro, height_m=log.baro.height_m - offset))


def _open(flight: Flight | str | Path) -> SensorLog:
    """Open the log of a flight or path."""
    from hsvaos.formats.sensor_log import open_sensor_log, sensor_log_of

    return sensor_log_of(flight) if isinstance(flight, Flight) else open_sensor_log(flight)


def _model(given: T | str | None, presets: dict[str, T], kind: str) -> T | None:
    """Return a model given as such or by the name of a preset."""
    if not isinstance(given, str):
        return given
    if given not in presets:
        raise ValueError(f"{kind} must be one of {', '.join(presets)}, got {given!r}")
    return presets[given]
