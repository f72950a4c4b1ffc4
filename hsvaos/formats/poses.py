"""Pose files: poses.csv of the native folder, poses.json of JKU, and quaternions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import check_pose
from hsvaos.flight import FlightError
from hsvaos.formats.text import CsvRow, read_csv, read_json, read_text, write_csv

Array = NDArray[np.float64]

POSE_COLUMNS = ("file", "t_s", "north_m", "east_m", "down_m", "qw", "qx", "qy", "qz")
"""The columns of poses.csv; std_* columns may follow."""

STD_COLUMNS = (
    *("std_north_m", "std_east_m", "std_down_m"),
    *("std_turn_north_deg", "std_turn_east_deg", "std_turn_down_deg"),
)
"""Deviations of a pose: of its place, and of its attitude as rotations about the world's axes."""

NED_FROM_JKU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""JKU's world has x = east, y = south, z = down."""

_UNIT_TOLERANCE = 1e-3
"""Rounded files are off by less; a quaternion further off is something else."""


@dataclass(frozen=True, eq=False)
class PosedName:
    """A line of a pose file.

    Args:
        name: File name as the pose file calls it.
        world_from_camera: Shape (4, 4), camera to world NED [m]; None where it has no pose.
        t_s: Time of exposure [s]; NaN where not logged.
        problem: Why the pose cannot be used, or None.
        covariance: See `flight.Frame`.
    """

    name: str
    world_from_camera: Array | None
    t_s: float = math.nan
    problem: str | None = None
    covariance: Array | None = None


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Return the rotation matrix of a Hamilton quaternion, w first.

    Args:
        quaternion: Shape (4,), of unit length within 1e-3 (normalised here).

    Returns:
        Shape (3, 3), float64.

    Raises:
        ValueError: If it is not finite or not of unit length.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if q.shape != (4,) or not np.isfinite(q).all():
        raise ValueError(f"expected a quaternion of 4 finite numbers, got {q.tolist()}")
    length = float(np.linalg.norm(q))
    if abs(length - 1.0) > _UNIT_TOLERANCE:
        raise ValueError(f"expected a quaternion of unit length, got length {length:.4g}")
    w, x, y, z = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """Return the Hamilton quaternion of a rotation, w first and not negative.

    The largest of the four components is found first, so that none is divided by a small one
    (Shepperd 1978).

    Args:
        rotation: Shape (3, 3).

    Returns:
        Shape (4,), float64, unit length.
    """
    R = np.asarray(rotation, dtype=np.float64)
    trace = float(np.trace(R))
    squares = np.array([trace, R[0, 0], R[1, 1], R[2, 2]])
    largest = int(np.argmax(squares))
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if largest == 0:
        q = np.array([1.0 + trace, *skew])
    else:
        i, j, k = largest - 1, largest % 3, (largest + 1) % 3
        q = np.empty(4)
        q[0] = skew[i]
        q[1 + i] = 1.0 + R[i, i] - R[j, j] - R[k, k]
        q[1 + j] = R[i, j] + R[j, i]
        q[1 + k] = R[i, k] + R[k, i]
    q /= np.linalg.norm(q)
    return -q if q[0] < 0.0 else q


def nearest_rotation(matrix: ArrayLike) -> Array:
    """Return the rotation nearest to a matrix that is one but for rounding."""
    U, _, Vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    return np.asarray(U @ Vt)


def read_poses(path: Path) -> list[PosedName]:
    """Read a pose file: poses.json of JKU if it starts like JSON, else poses.csv.

    Raises:
        FlightError: If the file cannot be read, is malformed or holds no pose.
    """
    start = read_text(path).lstrip()[:1]
    poses = jku_poses(path, read_json(path)) if start in ("{", "[") else read_poses_csv(path)
    if not poses:
        raise FlightError(f"{path}: expected poses, got none")
    return poses


def read_poses_csv(path: Path) -> list[PosedName]:
    """Read poses.csv (world NED, quaternion = world_from_camera).

    Raises:
        FlightError: If the file is malformed; a pose that cannot be used is marked instead.
    """
    poses = []
    for row in read_csv(path, POSE_COLUMNS, _hint):
        name, t_s = row.text("file"), row.number_or_nan("t_s")
        numbers = [row.number(column) for column in POSE_COLUMNS[2:]]
        try:
            pose = np.eye(4)
            pose[:3, 3] = numbers[:3]
            pose[:3, :3] = rotation_from_quaternion(numbers[3:])
            spread = _spread(row)
            poses.append(PosedName(name, check_pose(pose, "pose"), t_s, covariance=spread))
        except ValueError as error:
            poses.append(PosedName(name, None, t_s, f"{path}: line {row.line}: {name}: {error}"))
    return poses


def _spread(row: CsvRow) -> Array | None:
    """Return the covariance that the std_* columns of a line give; None without or if empty."""
    if not all(row.has(column) for column in STD_COLUMNS):
        return None
    std = np.array([row.number(column) for column in STD_COLUMNS])
    if not (np.isfinite(std) & (std >= 0.0)).all():
        raise ValueError(f"expected std_* columns of at least 0, got {std.min():g}")
    std[3:] = np.radians(std[3:])
    return np.diag(std * std)


def _hint(header: Sequence[str]) -> str:
    if "file" not in header and {"t_s", "north_m", "qw"} <= set(header):
        return (
            "; this looks like a trajectory, which has a row per time: "
            "hsvaos nav FLIGHT --poses FILE writes the poses of photos"
        )
    return ""


def is_jku(content: Any) -> bool:
    """Whether parsed JSON is a pose list of JKU."""
    images = content.get("images") if isinstance(content, dict) else None
    return isinstance(images, list) and any(isinstance(i, dict) and "M3x4" in i for i in images)


def jku_poses(path: Path, content: Any) -> list[PosedName]:
    """Return the poses of JKU's poses.json: M3x4 = camera from world (x east, y south, z down).

    Args:
        path: The file, for messages.
        content: What was read from it.

    Raises:
        FlightError: If it is no such list; a pose that cannot be used is marked instead.
    """
    if not is_jku(content):
        raise FlightError(f'{path}: expected {{"images": [{{"imagefile", "M3x4"}}, ...]}}')
    poses = []
    for number, entry in enumerate(content["images"]):
        name = entry.get("imagefile") if isinstance(entry, dict) else None
        if not isinstance(name, str) or not name:
            raise FlightError(f"{path}: images[{number}] must name an imagefile, got {name!r}")
        try:
            poses.append(PosedName(name, _pose_from_m3x4(entry.get("M3x4"))))
        except ValueError as error:
            poses.append(PosedName(name, None, problem=f"{path}: {name}: {error}"))
    return poses


def _pose_from_m3x4(rows: Any) -> Array:
    try:
        camera_from_world = np.array(rows, dtype=object).astype(np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"M3x4 must be 3 x 4 numbers, got {str(rows)[:60]}") from None
    if camera_from_world.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"M3x4 must have 3 x 4 numbers, got shape {camera_from_world.shape}")
    camera_from_world = check_pose(camera_from_world[:3], "M3x4")
    rotation = nearest_rotation(camera_from_world[:3, :3])
    pose = np.eye(4)
    pose[:3, :3] = NED_FROM_JKU @ rotation.T
    pose[:3, 3] = -pose[:3, :3] @ camera_from_world[:3, 3]
    return pose


def write_poses_csv(path: Path, poses: Sequence[PosedName]) -> None:
    """Write poses.csv, with every digit a float64 has; deviations where all poses have them.

    Raises:
        ValueError: If one of them has no pose.
    """
    known = all(posed.covariance is not None for posed in poses)
    rows: list[Sequence[str]] = [(*POSE_COLUMNS, *(STD_COLUMNS if known else ()))]
    for posed in poses:
        if posed.world_from_camera is None:
            raise ValueError(f"{posed.name} has no pose to write")
        place = posed.world_from_camera[:3, 3]
        quaternion = quaternion_from_rotation(posed.world_from_camera[:3, :3])
        time = "" if math.isnan(posed.t_s) else repr(float(posed.t_s))
        numbers = [repr(float(value)) for value in (*place, *quaternion)]
        if known and posed.covariance is not None:
            std = np.sqrt(np.maximum(np.diagonal(posed.covariance), 0.0))
            numbers += [f"{value:.6g}" for value in (*std[:3], *np.degrees(std[3:]))]
        rows.append([posed.name, time, *numbers])
    write_csv(path, rows)
