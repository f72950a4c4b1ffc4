"""Trajectories and photo poses as CSV files.

    trajectory.csv  t_s,north_m,east_m,down_m,vn_m_s,ve_m_s,vd_m_s,qw,qx,qy,qz,roll_deg,pitch_deg,
                    yaw_deg,std_north_m,std_east_m,std_down_m,std_vn_m_s,std_ve_m_s,std_vd_m_s,
                    std_roll_deg,std_pitch_deg,std_yaw_deg                  (world_from_body)
    poses.csv       file,t_s,north_m,east_m,down_m,qw,qx,qy,qz,std_north_m,std_east_m,std_down_m,
                    std_turn_north_deg,std_turn_east_deg,std_turn_down_deg  (world_from_camera)

`std_turn_*` is the spread of the camera's attitude error as a rotation about each world axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.formats.poses import PosedName, write_poses_csv
from hsvaos.nav import attitude
from hsvaos.nav.trajectory import Trajectory

Array = NDArray[np.float64]

TRAJECTORY_COLUMNS = (
    "t_s,north_m,east_m,down_m,vn_m_s,ve_m_s,vd_m_s,qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,"
    "std_north_m,std_east_m,std_down_m,std_vn_m_s,std_ve_m_s,std_vd_m_s,"
    "std_roll_deg,std_pitch_deg,std_yaw_deg"
)


def write_trajectory(path: Path, trajectory: Trajectory, rate_hz: float = 0.0) -> int:
    """Write a trajectory.

    Args:
        path: The file; its folder is made if it is not there.
        trajectory: The trajectory.
        rate_hz: Rows a second, or 0 for a row at each IMU sample and measurement.

    Returns:
        Number of rows.

    Raises:
        ValueError: If the rate is negative.
    """
    if not rate_hz >= 0.0:
        raise ValueError(f"rate_hz must be 0 or more rows a second, got {rate_hz!r}")
    t = trajectory.t_s
    if rate_hz > 0.0:
        first, last = trajectory.span
        t = first + np.arange(int((last - first) * rate_hz) + 1) / rate_hz
    position, velocity, q = trajectory.at(t)
    variance = np.diagonal(trajectory.full_covariance(t), axis1=1, axis2=2)
    table = np.column_stack(
        [
            t,
            position,
            velocity,
            np.where(q[:, :1] < 0.0, -q, q),
            np.degrees(attitude.to_euler(q)),
            np.sqrt(np.maximum(variance[:, :6], 0.0)),
            np.degrees(trajectory.euler_std(t)),
        ]
    )
    formats = ["%.6f"] + ["%.4f"] * 6 + ["%.9f"] * 4 + ["%.5f"] * 3 + ["%.4f"] * 6 + ["%.5f"] * 3
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8") as file:
        file.write(TRAJECTORY_COLUMNS + "\n")
        np.savetxt(file, table, fmt=formats, delimiter=",")
    return len(table)


def write_poses(path: Path, trajectory: Trajectory, files: Sequence[str], t_s: ArrayLike) -> None:
    """Write the camera's pose at each photo, a flight's poses.csv with std columns.

    Args:
        path: The file; its folder is made if it is not there.
        trajectory: The trajectory; its mounting places the camera.
        files: Shape (N,), names of the photos.
        t_s: Shape (N,), times of exposure, within the trajectory [s].

    Raises:
        ValueError: If a time lies outside the trajectory.
    """
    times = np.asarray(t_s, dtype=np.float64)
    pose = trajectory.world_from_camera(times)
    spread = trajectory.camera_covariance(times)
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = zip(files, pose, times.tolist(), spread, strict=True)
    write_poses_csv(path, [PosedName(n, p, t, covariance=c) for n, p, t, c in rows])
