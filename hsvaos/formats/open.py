"""`open_flight`: any known kind of flight, told by its content."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hsvaos.camera import Camera, checked_fov, finite_number
from hsvaos.flight import Flight, FlightError
from hsvaos.formats import dji, jku, native, photos
from hsvaos.formats.options import Options


class Reader(NamedTuple):
    """A format: how to tell it and how to read it.

    Args:
        name: Its name, as `format=` takes it.
        what: What it looks like, for messages.
        recognise: Whether a path holds it.
        read: Reads it.
    """

    name: str
    what: str
    recognise: Callable[[Path, Options], bool]
    read: Callable[[Path, Options], Flight]


READERS: tuple[Reader, ...] = (
    Reader("native", "flight.toml with [frames]", native.recognise, native.read),
    Reader("jku", "poses.json with M3x4", jku.recognise, jku.read),
    Reader("dji", "photos with GPS and gimbal angles (DJI)", dji.recognise, dji.read),
    Reader("photos", "photos with --poses FILE", photos.recognise, photos.read),
)
"""Asked in this order; the first that recognises a flight reads it."""


def open_flight(
    path: str | Path,
    camera: Camera | None = None,
    poses: str | Path | None = None,
    format: str | None = None,
    fov_deg: float | None = None,
    ground_down_m: float | None = None,
    mask: str | Path | None = None,
) -> Flight:
    """Open a flight of any known format, guessed from its content. No photo is decoded yet.

    Args:
        path: Folder of the flight, or the file that describes it.
        camera: Camera of all photos, in place of what the flight says.
        poses: poses.csv or poses.json in place of the flight's poses, in the same local frame.
        format: Name of the format ("native", "jku", "dji", "photos"), in place of guessing.
        fov_deg: Horizontal field of view of all photos [deg], in place of what the flight says.
        ground_down_m: Down of the ground [m], in place of what the flight says.
        mask: Image of the valid pixels of all photos (0 = ignore), in place of the flight's.

    Raises:
        FlightError: If there is no flight, its format is not known, or it cannot be used. What
            could be left out instead is counted in `Flight.notes`.
        TypeError: If camera is no `Camera`, or fov_deg or ground_down_m no number.
    """
    path = Path(path)
    if camera is not None and not isinstance(camera, Camera):
        raise TypeError(f"camera must be a Camera, got {camera!r}")
    try:
        fov_deg = None if fov_deg is None else checked_fov(fov_deg)
        if ground_down_m is not None:
            ground_down_m = finite_number(ground_down_m, "ground_down_m")
    except ValueError as error:
        raise FlightError(str(error)) from None
    if camera is not None and fov_deg is not None:
        raise FlightError("expected camera or fov_deg, got both")
    options = Options(
        camera,
        _existing(poses, "poses"),
        fov_deg,
        ground_down_m,
        _existing(mask, "mask"),
    )
    if not path.exists():
        raise FlightError(f"{path}: no such folder or file")
    if format is not None:
        for reader in READERS:
            if reader.name == format:
                if not reader.recognise(path, options):
                    raise FlightError(f"{path}: expected {reader.what}; {_seen(path)}")
                return reader.read(path, options)
        known = ", ".join(reader.name for reader in READERS)
        raise FlightError(f"format must be one of {known}, got {format!r}")
    for reader in READERS:
        if reader.recognise(path, options):
            return reader.read(path, options)
    known = "; ".join(f"{reader.name}: {reader.what}" for reader in READERS)
    raise FlightError(f"{path}: no known flight, {_seen(path)}. Understood are {known}")


def _existing(path: str | Path | None, name: str) -> Path | None:
    if path is not None and not Path(path).is_file():
        raise FlightError(f"{path}: no such file (given as {name})")
    return None if path is None else Path(path)


def _seen(path: Path) -> str:
    """Return a short list of what lies at a path."""
    if path.is_file():
        return f"got a file of {path.stat().st_size} bytes"
    try:
        names = sorted(entry.name for entry in path.iterdir())
    except OSError as error:
        return f"got a folder that cannot be listed ({error.strerror})"
    if not names:
        return "got an empty folder"
    return f"got {len(names)} entries ({', '.join(names[:5])}{', ...' if len(names) > 5 else ''})"
