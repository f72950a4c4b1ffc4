"""What the caller of `open_flight` may say about a flight, above what its files say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hsvaos.camera import Camera
from hsvaos.flight import FlightError

NO_INTRINSICS = "give --fov DEG or [camera] in flight.toml"
CAMERA_KEYS = ("model", "width", "height", "fx", "fy", "cx", "cy", "distortion", "fov_deg")
"""The keys of [camera]."""
MASK_NOTE = "mask.png found beside the photos: used as user mask (0 = ignore)"


@dataclass(frozen=True)
class Options:
    """The arguments of `open_flight` that every reader honours.

    Args:
        camera: The camera of all photos, in place of what the files say.
        poses: File of poses (poses.csv or poses.json) in place of the flight's own.
        fov_deg: Horizontal field of view of all photos [deg], in place of what the files say.
        ground_down_m: Down of the ground [m], in place of what the files say.
        mask: Image of valid pixels for all photos, in place of the flight's own.
    """

    camera: Camera | None = None
    poses: Path | None = None
    fov_deg: float | None = None
    ground_down_m: float | None = None
    mask: Path | None = None

    @property
    def gives_camera(self) -> bool:
        """Whether the caller described the camera."""
        return self.camera is not None or self.fov_deg is not None

    def camera_for(self, width: int, height: int) -> Camera:
        """Return the camera the caller described, for photos of a size.

        Raises:
            FlightError: If there is none or it has another size.
        """
        if self.camera is not None:
            if (self.camera.width, self.camera.height) != (width, height):
                raise FlightError(
                    f"camera is for {self.camera.width} x {self.camera.height} px, "
                    f"the photos have {width} x {height}"
                )
            return self.camera
        if self.fov_deg is None:
            raise FlightError(f"no intrinsics: {NO_INTRINSICS}")
        try:
            return Camera.from_fov(width, height, self.fov_deg)
        except ValueError as error:
            raise FlightError(str(error)) from None


def number_in(table: Mapping[str, Any], key: str, where: str) -> float:
    """Return a finite number of a TOML table.

    Raises:
        FlightError: If it is absent or not a finite number.
    """
    value = table.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        raise FlightError(f"{where} {key} must be a number, got {value!r}")
    if abs(value) == float("inf"):
        raise FlightError(f"{where} {key} must be finite, got {value!r}")
    return float(value)


def camera_from_table(
    table: Mapping[str, Any], where: str, size: tuple[int, int] | None
) -> Camera | None:
    """Return the camera a [camera] table describes; None while its size is yet to be known.

    Args:
        table: width, height, and fx, fy, cx, cy with optional distortion, or fov_deg alone.
        where: File and table, for messages.
        size: Width and height of the photos, which a table without a size takes over [px].

    Raises:
        FlightError: If it is incomplete or wrong.
    """
    if table.get("model", "opencv") not in ("opencv", "pinhole"):
        raise FlightError(f"{where} model must be 'opencv', got {table['model']!r}")
    if "width" in table or "height" in table:
        size = (int(number_in(table, "width", where)), int(number_in(table, "height", where)))
    if size is None:
        return None
    focal = [key for key in ("fx", "fy", "cx", "cy") if key in table]
    distortion = table.get("distortion", [])
    try:
        numbers = [float(k) for k in distortion]
    except (TypeError, ValueError):
        raise FlightError(f"{where} distortion must be numbers, got {distortion!r}") from None
    if len(numbers) not in (0, 4, 5):
        raise FlightError(
            f"{where} distortion must be [k1, k2, p1, p2, k3], got {len(numbers)} numbers"
        )
    k1, k2, p1, p2, k3 = (*numbers, *[0.0] * (5 - len(numbers)))
    if "fov_deg" in table and (focal or numbers):
        raise FlightError(f"{where} must give fov_deg alone, or fx, fy, cx, cy: got both")
    if "fov_deg" not in table and len(focal) < 4:
        missing = [key for key in ("fx", "fy", "cx", "cy") if key not in focal]
        raise FlightError(f"{where} lacks {', '.join(missing)} (or fov_deg): no intrinsics")
    try:
        if "fov_deg" in table:
            return Camera.from_fov(*size, number_in(table, "fov_deg", where))
        fx, fy, cx, cy = (number_in(table, key, where) for key in ("fx", "fy", "cx", "cy"))
        return Camera(*size, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    except ValueError as error:
        message = str(error)
        raise FlightError(message if where in message else f"{where} {message}") from None
