"""Plain folders of photos whose poses the caller names (`--poses FILE`)."""

from __future__ import annotations

from pathlib import Path

from hsvaos.flight import Flight, FlightError
from hsvaos.formats.jku import read_posed_photos
from hsvaos.formats.options import Options
from hsvaos.formats.select import images_in


def recognise(path: Path, options: Options) -> bool:
    """Whether it is a folder with photos and the caller named a pose file."""
    return options.poses is not None and bool(images_in(path) or images_in(path / "images"))


def read(path: Path, options: Options) -> Flight:
    """Read photos with the caller's poses and camera.

    Raises:
        FlightError: If it cannot be used.
    """
    if options.poses is None:
        raise FlightError(f"{path}: photos without poses: give --poses FILE")
    return read_posed_photos(path, options.poses, options, path, "photos")
