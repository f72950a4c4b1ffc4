"""Figures of the real logs under ../shared/data/logs, which are not part of the project.

    python bench/nav_real_logs.py ../shared/data/logs

Prints a Markdown table a log: what the gates refused, mean NIS with the latency modelled and not,
and how well 10 s without fixes are predicted, with and without the estimated biases.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from hsvaos.flight import FlightError
from hsvaos.formats.sensor_log import open_sensor_log
from hsvaos.nav.checks import check_log
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.estimate import estimate_trajectory
from hsvaos.nav.fit import fit_models
from hsvaos.nav.initial import InitialState
from hsvaos.nav.sensors import GNSS_MODELS, IMU_MODELS

LOGS = (
    "px4_swiss_search",
    "px4_f450_gps_glitch",
    "ardupilot/arducopter_log171/log171.bin",
    "ardupilot/ardupilot_test.BIN",
    "px4/sample.ulg",
)


def seen(innovations) -> str:
    """Mean NIS and refusals of each sensor."""
    return " | ".join(
        f"{i.mean_nis:.2f}, {i.gated} of {len(i.nis)} gated"
        for i in (innovations[name] for name in ("gnss position", "gnss velocity", "baro"))
    )


def outages(log, ekf: ErrorStateEkf, states, begins, seconds: float = 10.0):
    """Horizontal error after 10 s without fixes, with estimated and with raw biases [m]."""
    late = ekf.gnss.latency_s
    errors: tuple[list[float], list[float]] = ([], [])
    blind = log.replace(gnss=None, baro=None)
    for begin in begins:
        k = int(np.searchsorted(states.t_s, begin))
        sigma = np.sqrt(np.diagonal(states.covariance[k])) + 1e-9
        start = InitialState(
            float(states.t_s[k]),
            states.position[k],
            states.velocity[k],
            states.quaternion[k],
            states.gyro_bias[k],
            states.accel_bias[k],
            *(sigma[3 * i : 3 * i + 3] for i in range(5)),
        )
        raw = start.replace(gyro_bias=np.zeros(3), accel_bias=np.zeros(3))
        here, there = np.searchsorted(log.gnss.t_s - late, [begin, begin + seconds])
        moved = log.gnss.position[there] - log.gnss.position[here]
        for first, out in zip((start, raw), errors, strict=True):
            stop = float(log.gnss.t_s[there]) - late
            end = ekf.run(blind, first, stop_s=stop, keep_history=False)
            out.append(float(np.linalg.norm((end.position[-1] - first.position - moved)[:2])))
    return errors


def main(folder: Path) -> None:
    print("| log | latency | NIS position | NIS velocity | NIS barometer | CPU, times real time |")
    print("|---|---|---|---|---|---|")
    for name in LOGS:
        before = time.process_time()
        try:
            trajectory = estimate_trajectory(folder / name)
        except FlightError as error:
            print(f"| {name} | {error} |")
            continue
        cpu = time.process_time() - before
        span = trajectory.span[1] - trajectory.span[0]
        latency = next(note for note in trajectory.notes if "latency" in note).split()[2]
        figures = seen(trajectory.innovations)
        print(f"| {name} | {latency} s (found) | {figures} | {cpu:.1f} s, {span / cpu:.0f} |")
    log = check_log(open_sensor_log(folder / LOGS[0]))
    imu, gnss = IMU_MODELS["autopilot"], GNSS_MODELS["standalone"]
    for latency in (0.22, 0.0):
        models = fit_models(log, imu, gnss, gnss_latency_s=latency)
        ekf = ErrorStateEkf(imu, models.gnss, models.baro)
        states = ekf.run(models.log, models.start, keep_history=False)
        print(f"| {LOGS[0]} | {latency} s (given) | {seen(states.innovations)} | |")
        if latency:
            # but for the aerobatics from 46 s to 78 s
            begins = (*np.arange(22.0, 46.0, 4.0), *np.arange(78.0, 134.0, 5.0))
            blind = replace(ekf.gnss, latency_s=latency)
            errors = outages(log, ErrorStateEkf(imu, blind, models.baro), states, begins)
    print(f"\n{LOGS[0]}, {len(errors[0])} outages of 10 s, horizontal error at the end:\n")
    print("| biases | root mean square | median |")
    print("|---|---|---|")
    for what, e in zip(("as estimated", "raw (zero)"), errors, strict=True):
        print(f"| {what} | {np.sqrt(np.mean(np.square(e))):.1f} m | {np.median(e):.1f} m |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
