"""A flight: photos, their camera, the pose of each, and what else was logged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera, VirtualCamera, check_pose


class FlightError(ValueError):
    """A flight, or a file of it, that cannot be used: says which, what was expected, what came."""


@dataclass(frozen=True)
class Origin:
    """Where the local NED frame is tied to the Earth (WGS-84).

    Args:
        lat_deg: Geodetic latitude [deg].
        lon_deg: Longitude [deg].
        height_m: Height of the origin; ellipsoidal or above sea level as the source gave it [m].
    """

    lat_deg: float
    lon_deg: float
    height_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Frame:
    """One photo and where it was taken.

    Args:
        name: File name as the flight's own files call it.
        path: The image file.
        world_from_camera: Shape (4, 4), camera to world NED [m]; None until a filter estimates it.
        t_s: Time of exposure [s]; NaN where not logged.
        mask: Image file with the frame's own valid pixels (0 = ignore), or None.
        covariance: Shape (6, 6), of the pose: north, east, down [m], then the rotation vector of
            the attitude error about them [rad]; None where it is not known.

    Raises:
        FlightError: If the pose is not finite or holds no rotation.
    """

    name: str
    path: Path
    world_from_camera: NDArray[np.float64] | None
    t_s: float = float("nan")
    mask: Path | None = None
    covariance: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        if self.world_from_camera is not None:
            try:
                pose = check_pose(self.world_from_camera, f"pose of {self.name}")
            except ValueError as error:
                raise FlightError(str(error)) from None
            object.__setattr__(self, "world_from_camera", pose)


@dataclass(frozen=True, eq=False)
class Flight:
    """Photos with one camera, their poses, and the world they lie in.

    Args:
        name: What to call the flight.
        camera: The camera of all photos.
        frames: At least one frame, in order of time.
        origin: WGS-84 place of the local NED frame, or None if not known.
        ground_down_m: Down of the ground in the local frame [m], or None if not known.
        mask: Image file with the valid pixels of every frame (0 = ignore), or None.
        terrain: Digital elevation model that belongs to the flight, or None.
        sensors: Files of the sensor log by kind ("imu", "gnss", "baro", "triggers"), and mounting
            ("body_from_camera_q", "camera_lever_arm_m", "antenna_lever_arm_m").
        source: The folder or file that was opened.
        format: Name of the format it was read from.
        notes: What was skipped or assumed while reading, one line each, for the user's eyes.

    Raises:
        FlightError: If there is no frame.
    """

    name: str
    camera: Camera
    frames: tuple[Frame, ...]
    origin: Origin | None = None
    ground_down_m: float | None = None
    mask: Path | None = None
    terrain: Path | None = None
    sensors: dict[str, Any] = field(default_factory=dict)
    source: Path = Path()
    format: str = "native"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.frames:
            raise FlightError(f"{self.source}: a flight needs at least one photo, got none")
        object.__setattr__(self, "frames", tuple(self.frames))

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def has_poses(self) -> bool:
        """Whether every frame has a pose."""
        return all(frame.world_from_camera is not None for frame in self.frames)

    @property
    def poses(self) -> NDArray[np.float64]:
        """Shape (N, 4, 4), float64, world_from_camera of every frame, world NED [m].

        Raises:
            FlightError: If a frame has no pose.
        """
        poses = [frame.world_from_camera for frame in self.frames]
        missing = [f.name for f in self.frames if f.world_from_camera is None]
        if missing:
            raise FlightError(
                f"{self.source}: {len(missing)} of {len(poses)} photos have no pose "
                f"(first: {missing[0]})"
            )
        return np.array(poses, dtype=np.float64)

    @property
    def pose_covariances(self) -> NDArray[np.float64] | None:
        """Shape (N, 6, 6), of the poses, see `Frame`; None unless every frame has one."""
        known = [frame.covariance for frame in self.frames if frame.covariance is not None]
        return np.array(known, dtype=np.float64) if len(known) == len(self) else None

    @property
    def centre_index(self) -> int:
        """Number of the frame whose camera is nearest to the middle of all cameras."""
        places = self.poses[:, :3, 3]
        return int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))

    def index(self, name: str) -> int:
        """Return the number of a frame given by name, file stem or number.

        Raises:
            FlightError: If no frame, or more than one, goes by that name.
        """
        names = [frame.name for frame in self.frames]
        found = [i for i, n in enumerate(names) if name in (n, Path(n).stem, Path(n).name)]
        if not found and name.isdigit() and int(name) < len(names):
            found = [int(name)]
        if len(found) != 1:
            raise FlightError(
                f"{'no' if not found else 'more than one'} frame called {name!r}: expected a file "
                f"name such as {names[0]!r} or a number from 0 to {len(names) - 1}"
            )
        return found[0]

    def view(self, index: int) -> VirtualCamera:
        """Return the virtual camera at a frame's pose: the flight's camera without distortion."""
        return VirtualCamera(self.camera.without_distortion(), self.poses[index])

    def replace(self, **changes: Any) -> Flight:
        """Return the flight with some fields changed."""
        return replace(self, **changes)

    def at_poses(self, poses: ArrayLike) -> Flight:
        """Return the flight with other poses.

        Args:
            poses: Shape (N, 4, 4), world_from_camera of every frame, world NED [m].
        """
        pairs = zip(self.frames, np.asarray(poses, dtype=np.float64), strict=True)
        return replace(self, frames=tuple(replace(f, world_from_camera=p) for f, p in pairs))

    def subset(self, indices: Sequence[int], note: str | None = None) -> Flight:
        """Return the flight with some of its frames only, and a note why."""
        notes = self.notes if note is None else (*self.notes, note)
        return replace(self, frames=tuple(self.frames[i] for i in indices), notes=notes)

    def images(self, *, workers: int | None = None) -> Iterator[NDArray[Any]]:
        """Yield the photos in order, decoded in threads ahead of the caller.

        Args:
            workers: Threads that decode; by default one a core.

        Yields:
            Shape (H, W, 3) RGB or (H, W) grey; uint8, uint16 or float32.

        Raises:
            FlightError: If a photo cannot be decoded or has another size than the camera.
        """
        from hsvaos.formats.images import decode_ahead

        return decode_ahead(self, workers=workers)
