"""The paper's mission flown again and again: errors of each filter at the photos.

    python bench/nav_paper_mission.py --seeds 20

64 m x 64 m, 117 photos, 20 m above the ground, 5 m/s, sensors by the presets of hsvaos.nav.sensors.
Writes bench/NAV.md: errors beside the paper's Table 1, the targets, the faults, consistency.
"""

from __future__ import annotations

import argparse
import platform
import re
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.progress import Progress

from hsvaos.nav import attitude
from hsvaos.nav.chi_square import mean_bounds
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.estimate import estimate_trajectory
from hsvaos.nav.initial import InitialState
from hsvaos.nav.log import Mounting, SensorLog, TrueMotion
from hsvaos.nav.mission import Lawnmower
from hsvaos.nav.paper_ekf import PaperEkf
from hsvaos.nav.sensors import (
    BARO_MODELS,
    GNSS_MODELS,
    IMU_MODELS,
    GnssModel,
    ImuModel,
    simulate_log,
)
from hsvaos.nav.smoother import smooth
from hsvaos.nav.states import States
from hsvaos.nav.trajectory import Trajectory, trajectory_of

BARO = BARO_MODELS["calibrated"]
SINGLE, SBAS = GNSS_MODELS["single"], GNSS_MODELS["sbas"]
IMU = IMU_MODELS["adis16448-calibrated"]
DRIFTING = replace(
    IMU_MODELS["adis16448-rotors"],
    gyro_noise=IMU.gyro_noise,
    accel_noise=IMU.accel_noise,
    gyro_bias_std=IMU.gyro_bias_std,
    accel_bias_std=IMU.accel_bias_std,
)
OUTAGE = (90.0, 120.0)


@dataclass
class Case:
    """One condition: what flies, what goes wrong, and which filters try it."""

    title: str
    filters: tuple[str, ...]
    imu: ImuModel = IMU
    gnss: GnssModel = SINGLE
    faults: dict = field(default_factory=dict)
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0)


CASES = {
    "single": Case(
        "GNSS 5 Hz, 1.5/2.5 m, 0.3 m/s",
        ("paper, as printed", "paper", "error-state", "smoothed"),
        gnss=SINGLE,
    ),
    "sbas": Case(
        "GNSS 10 Hz, 1.0/1.5 m, 0.05 m/s", ("paper", "error-state", "smoothed"), gnss=SBAS
    ),
    "drift": Case(
        "drifting biases (RotorS)",
        ("paper", "paper, bias walk", "error-state", "smoothed"),
        imu=DRIFTING,
        gnss=SBAS,
    ),
    "late": Case(
        "GNSS 0.2 s late",
        (
            "paper",
            "smoothed, latency ignored",
            "error-state",
            "smoothed",
            "smoothed, latency found",
        ),
        gnss=replace(SBAS, latency_s=0.2),
    ),
    "outage": Case(
        "30 s without GNSS", ("error-state", "smoothed"), gnss=SBAS, faults={"outages": (OUTAGE,)}
    ),
    "outliers": Case(
        "2 % outliers of 15 m",
        ("paper", "smoothed, no gate", "error-state", "smoothed"),
        gnss=SBAS,
        faults={"outlier_share": 0.02, "outlier_m": 15.0},
    ),
    "antenna": Case(
        "antenna 0.3 m off",
        ("paper", "error-state", "smoothed"),
        gnss=SBAS,
        lever=(0.3, 0.0, 0.0),
    ),
    "unknown": Case(
        "switch-on biases, heading, noise and latency unknown",
        ("hsvaos nav",),
        imu=IMU_MODELS["adis16448"],
        gnss=SBAS,
    ),
}

TARGETS = {
    ("single", "smoothed"): (0.20, 0.05, 0.045, 0.20),
    ("sbas", "smoothed"): (0.08, 0.02, 0.035, 0.10),
}
HEAD = "| {} | filter | horizontal [m] | vertical [m] | roll [deg] | pitch [deg] | yaw [deg] |"
PAPER = (0.41, 0.20, 0.06, 0.06, 0.61)


def start_of(log: SensorLog, motion: TrueMotion, case: Case, seed: int) -> InitialState:
    """The first fix, and an attitude wrong by about 1 deg in level and 5 deg in heading."""
    rng = np.random.default_rng([seed, 77])
    _, velocity, q = motion.at(motion.t_s[:1])
    std = np.radians([1.0, 1.0, 5.0])
    position = motion.position[0] + case.gnss.position_axes * rng.standard_normal(3)
    return InitialState(
        t_s=float(motion.t_s[0]),
        position=position,
        velocity=velocity[0] + case.gnss.velocity_axes * rng.standard_normal(3),
        quaternion=attitude.multiply(attitude.exp(std * rng.standard_normal(3)), q[0]),
        position_std=case.gnss.position_axes,
        velocity_std=case.gnss.velocity_axes,
        attitude_std=std,
        gyro_bias_std=np.full(3, case.imu.gyro_bias_std),
        accel_bias_std=np.full(3, case.imu.accel_bias_std),
    )


def trial(case: Case, seed: int) -> dict[str, tuple[np.ndarray, States]]:
    """Fly once; return errors at the photos (N, 6) and the states of each filter."""
    motion, photos = Lawnmower().fly(seed)
    mounting = Mounting(antenna_lever_arm=np.array(case.lever))
    log = simulate_log(
        motion, case.imu, case.gnss, BARO, seed=seed, mounting=mounting, **case.faults
    )
    start = start_of(log, motion, case, seed)
    out = {}
    filtered: States | None = None
    for name in case.filters:
        if name.startswith("paper"):
            ekf = PaperEkf(
                case.imu,
                case.gnss,
                BARO,
                bias_random_walk="walk" in name,
                project="printed" not in name,
            )
            states = ekf.run(log, start)
        elif name == "hsvaos nav":
            states = estimate_trajectory(log, baro=BARO).states
        elif name in ("error-state", "smoothed"):
            if filtered is None:
                filtered = ErrorStateEkf(case.imu, case.gnss, BARO).run(log, start)
            states = filtered if name == "error-state" else smooth(filtered)
        elif name == "smoothed, latency ignored":
            plain = replace(case.gnss, latency_s=0.0)
            states = smooth(ErrorStateEkf(case.imu, plain, BARO).run(log, start))
        elif name == "smoothed, latency found":
            plain = replace(case.gnss, latency_s=0.0)
            states = estimate_trajectory(log, imu=case.imu, gnss=plain, baro=BARO).states
        else:
            states = smooth(ErrorStateEkf(case.imu, case.gnss, BARO, gate=0.0).run(log, start))
        out[name] = errors(trajectory_of(states, log), motion, photos), states
    return out


def errors(track: Trajectory, motion: TrueMotion, photos: np.ndarray) -> np.ndarray:
    """North, east, down [m], roll, pitch, yaw [deg] at each photo."""
    t = np.clip(photos, *track.span)
    position, _, q = track.at(t)
    true_position, _, true_q = motion.at(photos)
    turn = np.degrees(attitude.to_euler(q) - attitude.to_euler(true_q))
    turn = (turn + 180.0) % 360.0 - 180.0
    return np.concatenate([position - true_position, turn], axis=1)


def rmse(e: np.ndarray) -> np.ndarray:
    """Horizontal, vertical [m], roll, pitch, yaw [deg] of errors (..., 6), squares averaged."""
    square = np.mean(e.reshape(-1, 6) ** 2, axis=0)
    return np.sqrt([square[0] + square[1], square[2], square[3], square[4], square[5]])


def interval(e: np.ndarray, figure: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """95 % bootstrap interval over seeds of a figure of errors (seeds, N, 6): shape (2, ...)."""
    rng = np.random.default_rng(0)
    draws = [figure(e[rng.integers(0, len(e), len(e))]) for _ in range(1000)]
    return np.percentile(draws, [2.5, 97.5], axis=0)


def cells(e: np.ndarray) -> str:
    """One line of a table: each figure with its interval."""
    figures, (low, high) = rmse(e), interval(e, rmse)
    return " | ".join(
        f"{f:.3f} ({a:.3f} to {b:.3f})" for f, a, b in zip(figures, low, high, strict=True)
    )


def judge(e: np.ndarray, target: tuple[float, float, float, float]) -> list[str]:
    """Compare with a target: horizontal, vertical, roll and pitch, yaw."""
    f = rmse(e)
    level = float(np.sqrt(0.5 * (f[2] ** 2 + f[3] ** 2)))
    lines = []
    for what, unit, value, limit in zip(
        ("horizontal", "vertical", "roll and pitch", "yaw"),
        ("m", "m", "deg", "deg"),
        (f[0], f[1], level, f[4]),
        target,
        strict=True,
    ):
        verdict = "met" if value <= limit else "**not met**"
        lines.append(f"| {what} | {limit:g} {unit} | {value:.3f} {unit} | {verdict} |")
    return lines


def consistency(states: list[States], truths: list[TrueMotion]) -> str:
    """NEES and NIS of one filter over all seeds beside their 95 % bounds."""
    mean = np.mean([s.nees(truth) for s, truth in zip(states, truths, strict=True)], axis=0)
    low, high = mean_bounds(0.95, 9.0, len(states))
    inside = float(np.mean((mean >= low) & (mean <= high)))
    line = f"{np.mean(mean):.2f} | {low:.2f} to {high:.2f} | {100 * inside:.0f} %"
    for sensor in ("gnss position", "gnss velocity", "baro"):
        all_nis = [s.innovations[sensor] for s in states]
        dof = sum(int(i.dof[i.accepted].sum()) for i in all_nis)
        nis = sum(float(i.nis[i.accepted].sum()) for i in all_nis) / dof
        bounds = mean_bounds(0.95, 1.0, dof)
        line += f" | {nis:.3f} ({bounds[0]:.3f} to {bounds[1]:.3f})"
    return line


def report(results: dict[str, dict[str, list]], truths: list[TrueMotion], seeds: int) -> str:
    """The page."""
    at = {
        (case, name): np.array([e for e, _ in rows])
        for case, byname in results.items()
        for name, rows in byname.items()
    }
    out = [
        "# Navigation: the paper's mission, simulated",
        "",
        f"`python {shlex.join(sys.argv)}`: {seeds} flights; {platform.machine()}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}.",
        "",
        "64 m x 64 m, 9 strips of 13 photos, 20 m above the ground, 5 m/s, a stop at each corner,",
        "nose to the north, gusts of 0.1 m; IMU 200 Hz `adis16448-calibrated`, barometer 25 Hz",
        "0.4 m (`calibrated`). The start is a fix, level to 1 deg and heading to 5 deg (1 sigma).",
        "Errors at the 117 photos: root mean square over photos and flights, horizontal in two",
        "dimensions, with a 95 % bootstrap interval over flights. `paper, as printed` leaves the",
        "covariance alone where the quaternion is normalised, `paper` does not (see `PaperEkf`).",
        "The paper's mission is not described down to its accelerations, biases and barometer:",
        "these are ours.",
        "",
        "## Beside the paper's Table 1",
        "",
        HEAD.format("sensors"),
        "|---|---|---|---|---|---|---|",
        "| as printed | paper, Table 1 | " + " | ".join(f"{v:.2f}" for v in PAPER) + " |",
    ]
    for case in ("single", "sbas"):
        for name in results[case]:
            out.append(f"| {CASES[case].title} | {name} | {cells(at[case, name])} |")
    for (case, name), target in TARGETS.items():
        out += ["", f"Targets, {CASES[case].title}, {name}:", ""]
        out += ["| figure | target | here | |", "|---|---|---|---|", *judge(at[case, name], target)]
    out += [
        "",
        "## Faults",
        "",
        "All with GNSS 10 Hz, 1.0/1.5 m, 0.05 m/s.",
        "",
        HEAD.format("fault"),
        "|---|---|---|---|---|---|---|",
    ]
    for case in list(CASES)[2:]:
        for name in results[case]:
            out.append(f"| {CASES[case].title} | {name} | {cells(at[case, name])} |")
    clean = rmse(at["sbas", "smoothed"])[0]
    _, photos = Lawnmower().fly(0)
    dark = (photos >= OUTAGE[0]) & (photos < OUTAGE[1])
    inside = rmse(at["outage", "smoothed"][:, dark])[0]
    verdicts = [
        (
            "0.2 s late, latency modelled",
            rmse(at["late", "smoothed"])[0] / clean,
            1.3,
            "times clean",
        ),
        (
            "0.2 s late, latency found",
            rmse(at["late", "smoothed, latency found"])[0] / clean,
            1.3,
            "times clean",
        ),
        ("30 s outage, all photos", rmse(at["outage", "smoothed"])[0], 0.15, "m"),
        (f"30 s outage, the {int(dark.sum())} photos in it", inside, 0.15, "m"),
        ("2 % outliers", rmse(at["outliers", "smoothed"])[0] / clean, 1.1, "times clean"),
    ]
    out += ["", "| smoothed, horizontal | target | here | |", "|---|---|---|---|"]
    for what, value, limit, unit in verdicts:
        verdict = "met" if value <= limit else "**not met**"
        out.append(f"| {what} | {limit:g} {unit} | {value:.3f} {unit} | {verdict} |")
    out += [
        "",
        "## Consistency",
        "",
        "NEES of position, velocity and attitude (9 expected) every 5 s; bounds are for the mean",
        "over flights at one time, the share is that of times within them. NIS a degree of freedom",
        "(1 expected) over all flights, with its 95 % bounds.",
        "",
        "| case | filter | NEES | bounds | within | NIS position | NIS velocity | NIS barometer |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case in ("single", "sbas"):
        for name in results[case]:
            states = [s for _, s in results[case][name]]
            out.append(f"| {case} | {name} | {consistency(states, truths)} |")
    return "\n".join(out) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("-o", type=Path, default=Path(__file__).parent / "NAV.md")
    parser.add_argument("--only", default="", help="case/filter to match: print its rows alone")
    arguments = parser.parse_args()
    if arguments.only:
        print_rows(arguments.only, arguments.seeds)
        return
    results = {name: {f: [] for f in case.filters} for name, case in CASES.items()}
    truths = [Lawnmower().fly(seed)[0] for seed in range(arguments.seeds)]
    with Progress() as progress:
        bar = progress.add_task("flights", total=arguments.seeds * len(CASES))
        for name, case in CASES.items():
            progress.update(bar, description=name)
            for seed in range(arguments.seeds):
                for label, (e, states) in trial(case, seed).items():
                    # only what the page reads: covariances of forty thousand steps are gigabytes
                    keep = name in ("single", "sbas")
                    results[name][label].append((e, thin(states) if keep else None))
                progress.advance(bar)
    arguments.o.write_text(report(results, truths, arguments.seeds), encoding="utf-8")


def print_rows(pattern: str, seeds: int) -> None:
    """Fly only the filters whose "case/filter" matches, and print their rows of the tables."""
    for name, case in CASES.items():
        wanted = tuple(f for f in case.filters if re.search(pattern, f"{name}/{f}"))
        if not wanted:
            continue
        some = replace(case, filters=wanted)
        errors_of = [
            {label: e for label, (e, _) in trial(some, seed).items()} for seed in range(seeds)
        ]
        for label in wanted:
            print(f"| {case.title} | {label} | {cells(np.array([e[label] for e in errors_of]))} |")


def thin(states: States) -> States:
    """Return the states at the times that `consistency` looks at."""
    index = np.unique(np.searchsorted(states.t_s, np.arange(20.0, 200.0, 5.0)))
    return replace(
        states,
        t_s=states.t_s[index],
        vector=states.vector[index],
        rotation=states.rotation[index],
        covariance=states.covariance[index],
        history=None,
    )


if __name__ == "__main__":
    main()
