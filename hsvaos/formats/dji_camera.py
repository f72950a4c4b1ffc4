"""Intrinsics of DJI photos, from the best source the photos themselves offer."""

from __future__ import annotations

import math
from typing import NamedTuple

from hsvaos.camera import Camera
from hsvaos.formats.exif import PhotoTags

FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
"""Diagonal of 35 mm film; "equivalent" focal lengths compare diagonals (CIPA DCG-001)."""


class Sensor(NamedTuple):
    """A sensor of known size.

    Args:
        width_mm: Width of the whole sensor area that makes the widest photo [mm].
        width_px: Columns of that photo [px].
    """

    width_mm: float
    width_px: int


SENSORS = {
    "FC6310": Sensor(13.2, 5472),  # Phantom 4 Pro, 1 inch
    "FC6310R": Sensor(13.2, 5472),  # Phantom 4 RTK
    "FC6310S": Sensor(13.2, 5472),  # Phantom 4 Pro V2
    "L1D-20c": Sensor(13.2, 5472),  # Mavic 2 Pro
    "ZenmuseP1": Sensor(35.9, 8192),  # Zenmuse P1
}
"""Cameras whose sensor size and pixel count are published by the maker, by Exif model."""


def dji_camera(tags: PhotoTags, width: int, height: int) -> tuple[Camera, str] | None:
    """Return the camera of a DJI photo and where its intrinsics came from.

    Tried in this order: the factory's calibration (`DewarpData`), the calibrated focal length in
    pixels, a sensor of known size, the focal length on 35 mm film.

    Args:
        tags: Tags of one photo.
        width: Its columns [px].
        height: Its rows [px].

    Returns:
        The camera and a line for the user, or None where the photo says nothing usable.
    """
    found = _from_dewarp_data(tags, width, height) or _from_calibrated(tags, width, height)
    if found is not None:
        return found
    sensor = SENSORS.get(tags.model or "")
    if sensor is not None and tags.focal_mm is not None:
        focal = tags.focal_mm / sensor.width_mm * sensor.width_px * _resampling(width, sensor)
        note = (
            f"intrinsics from the focal length {tags.focal_mm:g} mm and the {sensor.width_mm:g} mm "
            f"wide sensor of the {tags.model}"
        )
        return _centred(width, height, focal), f"{note}: {focal:.0f} px"
    if tags.focal_35mm is None:
        return None
    focal = tags.focal_35mm / FILM_DIAGONAL_MM * full_diagonal_px(width, height)
    note = (
        f"intrinsics from the 35 mm equivalent focal length {tags.focal_35mm:g} mm (same angle "
        f"over the diagonal of the whole 4:3 sensor): {focal:.0f} px"
    )
    return _centred(width, height, focal), note


def full_diagonal_px(width: int, height: int) -> float:
    """Return the diagonal of the whole 4:3 (or 3:2) sensor a photo was cut from [px].

    Photos wider than 3:2 are cut from above and below, and keep the width; the equivalent focal
    length in their tags is still that of the whole sensor.

    Args:
        width: Columns of the photo [px].
        height: Rows of the photo [px].
    """
    long, short = max(width, height), min(width, height)
    if long / short > 1.6:
        short = round(long * 3 / 4)
    return math.hypot(long, short)


def _resampling(width: int, sensor: Sensor) -> float:
    # Photos of fewer columns are cut when the pixels stay, resampled when the field of view
    # stays. Only half size and less is surely the latter.
    return width / sensor.width_px if width <= 0.6 * sensor.width_px else 1.0


def _centred(width: int, height: int, focal: float) -> Camera:
    return Camera(width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0)


def _from_dewarp_data(tags: PhotoTags, width: int, height: int) -> tuple[Camera, str] | None:
    """Read `date;fx,fy,cx,cy,k1,k2,p1,p2,k3`; the centre is told from the photo's middle."""
    try:
        date, _, text = tags.xmp.get("DewarpData", "").partition(";")
        fx, fy, dx, dy, k1, k2, p1, p2, k3 = (float(part) for part in text.split(","))
        # Where the camera already removed the distortion, what is left is a pinhole.
        dewarped = tags.xmp_number("DewarpFlag") == 1.0
        lens = (0.0, 0.0, 0.0, 0.0, 0.0) if dewarped else (k1, k2, p1, p2, k3)
        camera = Camera(width, height, fx, fy, width / 2 + dx - 0.5, height / 2 + dy - 0.5, lens)
    except ValueError:
        return None
    if not (width / 5 < fx < 20 * width and max(abs(dx), abs(dy)) < 0.2 * width):
        return None
    return camera, f"intrinsics from the maker's calibration of {date} in the photos: {fx:.0f} px"


def _from_calibrated(tags: PhotoTags, width: int, height: int) -> tuple[Camera, str] | None:
    focal = tags.xmp_number("CalibratedFocalLength")
    cx = tags.xmp_number("CalibratedOpticalCenterX")
    cy = tags.xmp_number("CalibratedOpticalCenterY")
    # Some cameras put millimetres or micrometres into this field.
    if focal is None or not width / 5 < focal < 20 * width:
        return None
    camera = _centred(width, height, focal)
    if cx is None or cy is None:
        pass  # the middle of the photo stands
    elif abs(cx - width / 2) < 0.2 * width and abs(cy - height / 2) < 0.2 * height:
        camera = Camera(width, height, focal, focal, cx - 0.5, cy - 0.5)
    return camera, f"intrinsics from CalibratedFocalLength in the photos: {focal:.0f} px"
