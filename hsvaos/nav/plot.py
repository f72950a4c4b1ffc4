"""A figure of a trajectory: track, height, attitude with +-2 sigma, innovations."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from hsvaos.flight import FlightError
from hsvaos.nav import attitude
from hsvaos.nav.states import Innovations
from hsvaos.nav.trajectory import Trajectory

_MOST_POINTS = 4000
_BLUE, _ORANGE, _GREY, _RED = "#0072b2", "#e69f00", "#777777", "#d55e00"


def need_matplotlib() -> None:
    """Say in one line how to get matplotlib, if it is not there.

    Raises:
        FlightError: If it is not installed.
    """
    if find_spec("matplotlib") is None:
        raise FlightError("--plot needs matplotlib: pip install 'hsvaos[plot]'")


def check_format(path: Path) -> None:
    """Refuse a picture of a format that matplotlib does not write.

    Args:
        path: Picture to write.

    Raises:
        FlightError: If matplotlib is not installed.
        ValueError: If the ending says no known format.
    """
    need_matplotlib()
    from matplotlib.backend_bases import FigureCanvasBase

    if path.suffix.lower()[1:] not in FigureCanvasBase.get_supported_filetypes():
        raise ValueError(
            f"{path}: expected a figure ending in .png, .pdf or .svg, got "
            f"{path.suffix or 'no ending'}"
        )


def draw(trajectory: Trajectory, path: Path, title: str = "") -> None:
    """Draw a trajectory into a file.

    Args:
        trajectory: The trajectory.
        path: Picture to write; its ending (png, pdf, svg) says the format.
        title: Put on top.

    Raises:
        FlightError: If matplotlib is not installed.
        ValueError: If the format is not one that matplotlib writes.
    """
    check_format(path)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    t = trajectory.t_s[:: max(1, len(trajectory.t_s) // _MOST_POINTS)]
    figure = Figure(figsize=(14, 9), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(5, 2, width_ratios=(1, 1.25), height_ratios=(1, 1, 1, 1, 1))
    _track(figure.add_subplot(grid[0:3, 0]), trajectory, t)
    _height(figure.add_subplot(grid[3, 0]), trajectory, t)
    _spread(figure.add_subplot(grid[4, 0]), trajectory, t)
    _attitude([figure.add_subplot(grid[i, 1]) for i in range(2)], trajectory, t)
    axes = [figure.add_subplot(grid[i, 1]) for i in range(2, 5)]
    seen = trajectory.innovations
    for axis, sensor, unit in zip(
        axes, ("gnss position", "gnss velocity", "baro"), ("m", "m/s", "m"), strict=True
    ):
        _innovations(axis, sensor, unit, seen.get(sensor))
    for axis in figure.axes[1:]:
        axis.set_xlim(*trajectory.span)
    axes[-1].set_xlabel("time [s]")
    how = "smoothed" if trajectory.states.smoothed else "filtered"
    figure.suptitle(f"{title} ({how})" if title else how)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _track(axis: Any, trajectory: Trajectory, t: Any) -> None:
    """Draw the track from above, with the nose every so often."""
    position, _, q = trajectory.at(t)
    axis.plot(position[:, 1], position[:, 0], color=_BLUE, lw=1.0)
    axis.plot(*position[0, [1, 0]], "o", color=_BLUE, ms=6, label="start")
    axis.plot(*position[-1, [1, 0]], "s", color=_RED, ms=6, label="end")
    few = slice(None, None, max(1, len(t) // 40))
    nose = attitude.rotate(q[few], np.array([1.0, 0.0, 0.0]))
    axis.quiver(
        position[few, 1],
        position[few, 0],
        nose[:, 1],
        nose[:, 0],
        color=_GREY,
        width=0.003,
        scale=30,
        label="nose",
    )
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.legend(loc="best", fontsize=8)
    axis.grid(alpha=0.3)


def _height(axis: Any, trajectory: Trajectory, t: Any) -> None:
    """Draw the height with its 2-sigma band."""
    up = -trajectory.at(t)[0][:, 2]
    band = 2.0 * np.sqrt(trajectory.covariance(t)[:, 2, 2])
    axis.fill_between(t, up - band, up + band, color=_BLUE, alpha=0.25, lw=0)
    axis.plot(t, up, color=_BLUE, lw=1.0)
    axis.set_ylabel("height [m]\n±2σ")
    axis.grid(alpha=0.3)


def _spread(axis: Any, trajectory: Trajectory, t: Any) -> None:
    """Draw the spread of position and heading."""
    C = trajectory.covariance(t)
    flat, down = np.sqrt(C[:, 0, 0] + C[:, 1, 1]), np.sqrt(C[:, 2, 2])
    axis.plot(t, 2.0 * flat, color=_BLUE, lw=1.0, label="horizontal")
    axis.plot(t, 2.0 * down, color=_ORANGE, lw=1.0, label="vertical")
    axis.set_ylim(bottom=0.0)
    axis.set_ylabel("2σ of position [m]")
    axis.set_xlabel("time [s]")
    axis.legend(loc="upper right", fontsize=8, ncols=2)
    axis.grid(alpha=0.3)


def _attitude(axes: list[Any], trajectory: Trajectory, t: Any) -> None:
    """Draw roll and pitch above, yaw below, each with its 2-sigma band."""
    euler = np.degrees(attitude.to_euler(trajectory.at(t)[2]))
    band = 2.0 * np.degrees(trajectory.euler_std(t))
    # a turn through south is a gap in the line, not a cliff
    euler[1:][np.abs(np.diff(euler, axis=0)) > 180.0] = np.nan
    for axis, columns in ((axes[0], (0, 1)), (axes[1], (2,))):
        for column in columns:
            color = (_BLUE, _ORANGE, _BLUE)[column]
            low, high = euler[:, column] - band[:, column], euler[:, column] + band[:, column]
            axis.fill_between(t, low, high, color=color, alpha=0.25, lw=0)
            label = ("roll", "pitch", "yaw")[column]
            axis.plot(t, euler[:, column], color=color, lw=0.8, label=label)
        axis.set_ylabel(("roll, pitch" if len(columns) > 1 else "yaw") + " [deg]\n±2σ")
        axis.legend(loc="upper right", fontsize=8, ncols=2)
        axis.grid(alpha=0.3)


def _innovations(axis: Any, sensor: str, unit: str, seen: Innovations | None) -> None:
    """Draw the innovations of one sensor, its 2-sigma band, and what the gate refused."""
    axis.set_ylabel(f"{sensor}\ninnovation [{unit}]")
    axis.grid(alpha=0.3)
    if seen is None:
        axis.text(0.5, 0.5, "none", transform=axis.transAxes, ha="center", va="center")
        return
    width = seen.residual.shape[1]
    names = ("north", "east", "down") if width == 3 else ("height",)
    top = 2.0 * np.nanmax(seen.std, axis=1)
    axis.fill_between(seen.t_s, -top, top, color=_GREY, alpha=0.25, lw=0)
    for column in range(width):
        color = (_BLUE, _ORANGE, "#009e73")[column]
        good = seen.accepted
        value = seen.residual[:, column]
        axis.plot(seen.t_s[good], value[good], ".", color=color, ms=2, label=names[column])
    # far outliers would flatten the rest: they are drawn at the rim
    rim = 4.0 * float(np.nanpercentile(top, 95))
    gated = np.clip(seen.residual[~seen.accepted], -rim, rim)
    if len(gated):
        where = np.repeat(seen.t_s[~seen.accepted], width)
        axis.plot(where, gated.ravel(), "x", color=_RED, ms=4, mew=0.8, label="gated")
    axis.set_ylim(-1.05 * rim, 1.05 * rim)
    axis.legend(loc="upper right", fontsize=8, ncols=4)
