"""The command `hsvaos nav`: a sensor log in, a trajectory and a table out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from hsvaos.nav.trajectory import Trajectory


def nav(
    flight: Annotated[
        Path,
        typer.Argument(
            help="Flight folder, folder with imu.csv, PX4 .ulg or ArduPilot .bin file.",
            show_default=False,
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Trajectory to write.")] = Path(
        "trajectory.csv"
    ),
    filter: Annotated[
        str, typer.Option("--filter", help="error-state, or paper for the 16-state filter.")
    ] = "error-state",
    smooth: Annotated[
        bool, typer.Option("--smooth/--no-smooth", help="Let later fixes correct earlier poses.")
    ] = True,
    imu: Annotated[
        str | None, typer.Option(help="IMU preset; what fits the log best by default.")
    ] = None,
    gnss: Annotated[
        str | None, typer.Option(help="GNSS preset; what fits the log best by default.")
    ] = None,
    baro: Annotated[str | None, typer.Option(help="Barometer preset.")] = None,
    gnss_latency: Annotated[
        float | None, typer.Option(help="How late fixes are stamped [s]; estimated by default.")
    ] = None,
    rate: Annotated[
        float, typer.Option(help="Rows a second to write; 0: each IMU sample and measurement.")
    ] = 0.0,
    poses: Annotated[
        Path | None, typer.Option(help="Also write the camera's pose at each photo (poses.csv).")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Also draw track, attitude and innovations (png, pdf, svg).")
    ] = None,
) -> None:
    """Estimate poses from IMU, GNSS and barometer."""
    from rich.console import Console
    from rich.progress import Progress

    from hsvaos.flight import FlightError
    from hsvaos.formats.sensor_log import open_sensor_log
    from hsvaos.formats.trajectory_csv import write_poses, write_trajectory
    from hsvaos.nav.estimate import estimate_trajectory
    from hsvaos.nav.plot import check_format, draw

    # before the work, not after it
    for option, path in (("--output", output), ("--poses", poses), ("--plot", plot)):
        if path is not None:
            _check_target(option, path)
    if plot is not None:
        check_format(plot)
    log = open_sensor_log(flight)
    if poses is not None and not log.triggers:
        raise FlightError(f"{flight}: --poses needs times of photos (triggers), got none")
    console = Console()
    with Progress(console=console, transient=True) as progress:
        bars = {}

        def report(stage: str, share: float) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=1.0)
            progress.update(bars[stage], completed=share)

        trajectory = estimate_trajectory(
            log,
            filter=filter,
            smooth=smooth,
            imu=imu,
            gnss=gnss,
            baro=baro,
            gnss_latency_s=gnss_latency,
            progress=report,
        )
    rows = write_trajectory(output, trajectory, rate)
    console.print(summary(trajectory, log.name))
    for note in trajectory.notes:
        console.print(f"  {note}", highlight=False, markup=False, soft_wrap=True)
    console.print(f"{output}: {rows} rows", highlight=False, markup=False, soft_wrap=True)
    if poses is not None:
        first, last = trajectory.span
        inside = [(name, t) for name, t in log.triggers if first <= t <= last]
        write_poses(poses, trajectory, [name for name, _ in inside], [t for _, t in inside])
        left = len(log.triggers) - len(inside)
        tail = f", {left} outside the trajectory left out" if left else ""
        console.print(f"{poses}: {len(inside)} photos{tail}", highlight=False, markup=False)
    if plot is not None:
        draw(trajectory, plot, title=log.name)
        console.print(f"{plot}: figure", highlight=False, markup=False)


def _check_target(option: str, path: Path) -> None:
    """Refuse a file that cannot be written."""
    from hsvaos.flight import FlightError

    expected = f"{option} {path}: expected a file in an existing folder"
    if path.is_dir():
        raise FlightError(f"{expected}, got a folder")
    if not path.parent.is_dir():
        raise FlightError(f"{expected}, got {path.parent}, which is no folder")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise FlightError(f"{expected} that may be written, got one that may not")


def summary(trajectory: Trajectory, name: str) -> Table:
    """Return the table that the command prints: duration, rates, gates, NIS, final spread."""
    import numpy as np
    from rich.table import Table

    first, last = trajectory.span
    seconds = last - first
    how = "smoothed" if trajectory.states.smoothed else "filtered"
    table = Table(title=f"{name}: {seconds:.1f} s, {how}", title_justify="left")
    for head in ("sensor", "rate [Hz]", "used", "gated", "mean NIS"):
        table.add_column(head, justify="left" if head == "sensor" else "right")
    samples = trajectory.imu_samples
    table.add_row("imu", f"{(samples - 1) / seconds:.1f}", str(samples))
    for sensor, seen in trajectory.innovations.items():
        again = f" ({seen.recoveries} times let in again)" if seen.recoveries else ""
        table.add_row(
            sensor,
            f"{len(seen.t_s) / seconds:.1f}",
            str(int(seen.accepted.sum())),
            f"{seen.gated}{again}",
            f"{seen.mean_nis:.2f}",
        )
    C = trajectory.covariance(last)
    std, turn = np.sqrt(np.diagonal(C)), np.degrees(trajectory.euler_std(last))
    table.caption = (
        "mean NIS is 1 where noise is as the models say; at the end, 1 sigma: "
        f"{np.hypot(std[0], std[1]):.3f} m horizontal, {std[2]:.3f} m "
        f"vertical, roll {turn[0]:.2f}, pitch {turn[1]:.2f}, yaw {turn[2]:.2f} deg"
    )
    table.caption_justify = "left"
    return table
