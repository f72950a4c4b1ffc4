"""Flights with the poses that an evaluation asks for: their own, a filter's, or those of a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from hsvaos.flight import Flight, FlightError
from hsvaos.formats.open import open_flight
from hsvaos.formats.sensor_log import sensor_log_of
from hsvaos.formats.text import read_csv, read_text
from hsvaos.nav import attitude

FROM_LOG = "nav"
"""In place of a file: poses estimated from the flight's sensor log."""

_TRAJECTORY = ("t_s", "north_m", "east_m", "down_m", "qw", "qx", "qy", "qz")


def open_posed(path: Path, poses: Path | None) -> Flight:
    """Open a flight with other poses than its own.

    Args:
        path: The flight.
        poses: None for its own; `Path("nav")` for those that its sensor log gives when it is run;
            a pose file; or a trajectory of the vehicle, which has a row per time: then poses are
            interpolated at the times of exposure, and go through the flight's camera mounting.

    Raises:
        FlightError: If the flight or the file cannot be used, or has no log or times for it.
    """
    if poses is None:
        return open_flight(path)
    if poses == Path(FROM_LOG):
        flight = open_flight(path)
        sensor_log_of(flight)  # find out now whether there is one
        frames = tuple(replace(frame, world_from_camera=None) for frame in flight.frames)
        return flight.replace(frames=frames)
    if _is_trajectory(poses):
        return _along(open_flight(path), poses)
    return open_flight(path, poses=poses)


def _is_trajectory(path: Path) -> bool:
    header = read_text(path).lstrip().partition("\n")[0]
    names = {name.strip() for name in header.split(",")}
    return "file" not in names and set(_TRAJECTORY) <= names


def _along(flight: Flight, path: Path) -> Flight:
    rows = read_csv(path, _TRAJECTORY)
    if len(rows) < 2:
        raise FlightError(f"{path}: expected at least 2 rows of a trajectory, got {len(rows)}")
    table = np.array([[row.number(column) for column in _TRAJECTORY] for row in rows])
    t = table[:, 0]
    if not np.isfinite(table).all() or not (np.diff(t) > 0.0).all():
        raise FlightError(f"{path}: expected finite rows in rising order of time")
    try:
        turns = attitude.check_unit(table[:, 4:], "quaternion")
    except ValueError as error:
        raise FlightError(f"{path}: {error}") from None
    mounting = sensor_log_of(flight).mounting
    times = np.array([frame.t_s for frame in flight.frames])
    inside = np.flatnonzero((times >= t[0]) & (times <= t[-1]))
    if not len(inside):
        raise FlightError(
            f"{path}: no photo lies within the trajectory ({t[0]:.1f} to {t[-1]:.1f} s)"
        )
    when = times[inside]
    i = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 2)
    share = (when - t[i]) / (t[i + 1] - t[i])
    place = table[i, 1:4] + share[:, None] * (table[i + 1, 1:4] - table[i, 1:4])
    turn = attitude.slerp(turns[i], turns[i + 1], share)
    arm = np.broadcast_to(mounting.camera_lever_arm, place.shape)
    pose = np.tile(np.eye(4), (len(inside), 1, 1))
    pose[:, :3, :3] = attitude.matrix(attitude.multiply(turn, mounting.body_from_camera_q))
    pose[:, :3, 3] = place + attitude.rotate(turn, arm)
    notes = flight.notes
    if len(inside) < len(times):
        left = len(times) - len(inside)
        notes = (*notes, f"{left} of {len(times)} photos left out: outside the trajectory {path}")
    return flight.subset(inside.tolist()).at_poses(pose).replace(notes=notes)


def own_file(path: Path, file: Path, alone: bool, name: str) -> Path:
    """Return a file that belongs to a flight.

    Args:
        path: The flight.
        file: As the user gave it: a path, or a name within the flight's folder; where there are
            several flights it must lie in the folder of each.
        alone: Whether the flight is the only one.
        name: What to call it in the message.

    Raises:
        FlightError: If there is no such file.
    """
    folder = path if path.is_dir() else path.parent
    tried = [file, folder / file] if alone else [folder / file]
    if not alone and file.is_absolute():
        raise FlightError(
            f"{file}: one file for several flights (given as {name}): expected the name of a file "
            f"that lies in the folder of each"
        )
    for one in tried:
        if one.is_file():
            return one
    hint = "" if alone else "; with several flights it must lie in the folder of each"
    raise FlightError(f"{tried[0]}: no such file (given as {name}){hint}")
