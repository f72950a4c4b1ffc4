"""Poses of photos from the trajectory of the vehicle that took them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import Flight, FlightError
from hsvaos.nav.estimate import estimate_trajectory
from hsvaos.nav.trajectory import Trajectory


def poses_at_photos(
    flight: Flight,
    trajectory: Trajectory | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Flight:
    """Return the flight with a pose for each photo, from its sensor log.

    Photos are matched to triggers by file name; where a flight has no triggers, by the time of
    exposure of each frame. The pose goes through lever arm and boresight of the camera.

    Args:
        flight: A flight with sensors.
        trajectory: The trajectory, if it is known already.
        progress: Told of stage and share done, 0..1, while the trajectory is estimated.

    Returns:
        The flight; photos without time, or outside the trajectory, are left out with a note.

    Raises:
        FlightError: If no photo can be placed.
    """
    from hsvaos.formats.sensor_log import sensor_log_of

    log = sensor_log_of(flight)
    triggers = dict(log.triggers)
    notes = list(flight.notes)
    names = [frame.name for frame in flight.frames]
    if triggers and not any(name in triggers for name in names) and len(triggers) == len(names):
        triggers = dict(zip(names, triggers.values(), strict=True))
        notes.append(f"nav: {len(names)} photos matched to as many triggers in order of time")
    times = np.array([triggers.get(frame.name, frame.t_s) for frame in flight.frames])
    _refuse_strangers(flight, times, (float(log.imu.t_s[0]), float(log.imu.t_s[-1])))
    if trajectory is None:
        trajectory = estimate_trajectory(log, progress=progress)
    notes += [f"nav: {note}" for note in trajectory.notes]
    inside = _refuse_strangers(flight, times, trajectory.span)
    index = np.flatnonzero(inside)
    poses = trajectory.world_from_camera(times[index])
    covariances = trajectory.camera_covariance(times[index])
    frames = tuple(
        replace(flight.frames[i], world_from_camera=pose, t_s=float(times[i]), covariance=spread)
        for i, pose, spread in zip(index, poses, covariances, strict=True)
    )
    if len(index) < len(times):
        notes.append(
            f"nav: {len(times) - len(index)} of {len(times)} photos were left out: no time of "
            "exposure within the sensor log"
        )
    return flight.replace(frames=frames, notes=tuple(notes))


def _refuse_strangers(
    flight: Flight, times: NDArray[np.float64], span: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return which photos lie within a span of time, or refuse a flight of which none does."""
    inside = np.asarray((times >= span[0]) & (times <= span[1]))
    if not inside.any():
        raise FlightError(
            f"{flight.source}: no photo lies within the sensor log ({span[0]:.1f} to "
            f"{span[1]:.1f} s): expected triggers on the log's clock, got "
            f"{int(np.isfinite(times).sum())} of {len(times)} photos with a time"
        )
    return inside
