"""Intrinsics of DJI photos, from the best source the photos themselves offer."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from hsvaos.camera import Camera
from hsvaos.formats.exif import PhotoTags

FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
"""Diagonal of 35 mm film; "equivalent" focal lengths compare diagonals (CIPA DCG-001)."""


class Sensor(NamedTuple):
    """A sensor of known size.

    Args:
        width_mm: Width of the area that makes the widest photo [mm].
        width_px: Columns of that photo [px].
        height_px: Rows of that photo [px].
    """

    width_mm: float
    width_px: int
    height_px: int


SENSORS = {
    "FC6310": Sensor(13.2, 5472, 3648),  # Phantom 4 Pro, 1 inch
    "FC6310R": Sensor(13.2, 5472, 3648),  # Phantom 4 RTK
    "FC6310S": Sensor(13.2, 5472, 3648),  # Phantom 4 Pro V2
    "L1D-20c": Sensor(13.2, 5472, 3648),  # Mavic 2 Pro
    "ZenmuseP1": Sensor(35.9, 8192, 5460),  # Zenmuse P1
}
"""Cameras whose sensor size and pixel count are published by the maker, by Exif model."""


def dji_camera(tags: PhotoTags, width: int, height: int) -> tuple[Camera, str] | None:
    """Return the camera of a DJI photo and where its intrinsics came from.

    Tried in this order: the factory's calibration (`DewarpData`), the calibrated focal length in
    pixels, a sensor of known size, the focal length on 35 mm film. The first three describe the
    full photo: they are scaled to photos made smaller, and cut to those of another shape.

    Args:
        tags: Tags of one photo.
        width: Its columns [px].
        height: Its rows [px].

    Returns:
        The camera and a line for the user, or None where the photo says nothing usable.
    """
    full = _full_size(tags, width, height)
    found = _from_dewarp_data(tags, *full) or _from_calibrated(tags, *full)
    found = found or _from_sensor(tags)
    if found is not None:
        camera, note = found
        fitted = fit_camera(camera, width, height)
        shape = "" if full == (width, height) else f", scaled from {full[0]} x {full[1]}"
        return fitted, f"intrinsics from {note}: {fitted.fx:.0f} px{shape}"
    if tags.focal_35mm is None:
        return None
    focal = tags.focal_35mm / FILM_DIAGONAL_MM * full_diagonal_px(width, height)
    note = (
        f"intrinsics from the 35 mm equivalent focal length {tags.focal_35mm:g} mm (same angle "
        f"over the diagonal of the whole sensor): {focal:.0f} px"
    )
    return _centred(width, height, focal), note


def full_diagonal_px(width: int, height: int) -> float:
    """Return the diagonal of the whole 4:3 or 3:2 sensor that a photo was cut from [px].

    Photos wider than 3:2 are taken to be cut from above and below a 4:3 sensor, keeping its
    width; the equivalent focal length in their tags is still that of the whole sensor.

    Args:
        width: Columns of the photo [px].
        height: Rows of the photo [px].
    """
    long, short = max(width, height), min(width, height)
    if long / short > 1.6:
        short = round(long * 3 / 4)
    return math.hypot(long, short)


def fit_camera(camera: Camera, width: int, height: int) -> Camera:
    """Return the camera of a photo made smaller by its width, then cut above and below.

    Args:
        camera: Camera of the full photo.
        width: Columns of the photo at hand [px].
        height: Rows of the photo at hand [px].
    """
    # Rows are scaled by the columns' ratio exactly; rounding them would make pixels oblong.
    scale = width / camera.width
    surplus = camera.height * scale - height
    return Camera(
        width,
        height,
        camera.fx * scale,
        camera.fy * scale,
        (camera.cx + 0.5) * scale - 0.5,
        (camera.cy + 0.5) * scale - 0.5 - surplus / 2.0,
        camera.distortion,
    )


def _full_size(tags: PhotoTags, width: int, height: int) -> tuple[int, int]:
    """Return the size of the photo that calibrations refer to [px]."""
    sensor = SENSORS.get(_model(tags))
    if sensor is not None:
        return sensor.width_px, sensor.height_px
    cx = tags.xmp_number("CalibratedOpticalCenterX")
    cy = tags.xmp_number("CalibratedOpticalCenterY")
    # The optical centre lies within a few per cent of the middle: it tells half the size roughly,
    # well enough to see that a photo was made smaller afterwards.
    if cx is not None and cy is not None and cx > 0.55 * width and cy > 0.0:
        return round(2 * cx), round(2 * cy)
    return width, height


def _model(tags: PhotoTags) -> str:
    return tags.model or tags.xmp.get("Model", "")


def _centred(width: int, height: int, focal: float) -> Camera:
    return Camera(width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0)


def _from_dewarp_data(tags: PhotoTags, width: int, height: int) -> tuple[Camera, str] | None:
    """Read `date;fx,fy,cx,cy,k1,k2,p1,p2,k3`; the centre is told from the photo's middle."""
    try:
        date, _, text = tags.xmp.get("DewarpData", "").partition(";")
        fx, fy, dx, dy, k1, k2, p1, p2, k3 = (float(part) for part in text.split(","))
        camera = Camera(
            width, height, fx, fy, width / 2 + dx - 0.5, height / 2 + dy - 0.5, (k1, k2, p1, p2, k3)
        )
    except ValueError:
        return None
    if not _plausible(fx, width) or max(abs(dx), abs(dy)) > 0.2 * width:
        return None
    if tags.xmp_number("DewarpFlag") == 1.0:  # the camera took the distortion out itself
        camera = replace(camera, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    return camera, f"the maker's calibration of {date.strip()} in the photos"


def _from_calibrated(tags: PhotoTags, width: int, height: int) -> tuple[Camera, str] | None:
    focal = tags.xmp_number("CalibratedFocalLength")
    if focal is None or not _plausible(focal, width):
        return None
    camera = _centred(width, height, focal)
    cx = tags.xmp_number("CalibratedOpticalCenterX")
    cy = tags.xmp_number("CalibratedOpticalCenterY")
    centre = cx is not None and abs(cx - width / 2) < 0.1 * width
    if centre and cx is not None and cy is not None and abs(cy - height / 2) < 0.1 * height:
        camera = replace(camera, cx=cx - 0.5, cy=cy - 0.5)
    return camera, "CalibratedFocalLength in the photos"


def _plausible(focal: float, width: int) -> bool:
    """Whether it can be pixels: some cameras write millimetres or micrometres."""
    return width / 5 < focal < 20 * width


def _from_sensor(tags: PhotoTags) -> tuple[Camera, str] | None:
    sensor = SENSORS.get(_model(tags))
    if sensor is None or tags.focal_mm is None:
        return None
    focal = tags.focal_mm / sensor.width_mm * sensor.width_px
    note = f"the focal length {tags.focal_mm:g} mm and the {sensor.width_mm:g} mm wide sensor"
    return _centred(sensor.width_px, sensor.height_px, focal), f"{note} of the {_model(tags)}"
