"""Folders of photos that carry their own pose: DJI's XMP and the GPS tags of Exif."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.flight import Flight, FlightError, Origin
from hsvaos.formats.dji_camera import dji_camera
from hsvaos.formats.exif import PhotoTags, read_tags
from hsvaos.formats.options import MASK_NOTE, NO_INTRINSICS, Options, camera_from_table
from hsvaos.formats.poses import PosedName, read_poses
from hsvaos.formats.select import PhotoFinder, images_in, select_frames, skipped_note
from hsvaos.formats.text import read_toml
from hsvaos.geodesy import ned_from_geodetic

Matrix = NDArray[np.float64]

GIMBAL_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Gimbal x forward = optical axis, y right = image right, z down = image down."""

_RTK_FIXED = 50.0
"""RtkFlag of a position solved with fixed ambiguities."""
_LOOKED_AT = 5
"""So many photos, spread over a folder, are opened to tell whether it is one of these."""


class Angles(NamedTuple):
    """Attitude of the gimbal in NED.

    Args:
        yaw: Heading, clockwise from north [deg].
        pitch: Up is positive; -90 looks straight down [deg].
        roll: Clockwise seen from behind [deg].
        from_flight: Whether they are those of the vehicle, for want of a gimbal.
    """

    yaw: float
    pitch: float
    roll: float
    from_flight: bool = False


def recognise(path: Path, options: Options) -> bool:
    """Whether a folder holds photos with a GPS position and gimbal or flight angles."""
    folder = _photo_folder(path)
    photos = images_in(folder)
    for photo in photos[:: -(-len(photos) // _LOOKED_AT) or 1]:
        try:
            tags = read_tags(photo)
        except FlightError:
            continue
        if gimbal_angles(tags) is not None and position(tags) is not None:
            return True
    return False


def _photo_folder(path: Path) -> Path:
    return path if images_in(path) else path / "images"


def gimbal_angles(tags: PhotoTags) -> Angles | None:
    """Return the gimbal's angles, or the vehicle's where there are none of a gimbal."""
    for prefix in ("Gimbal", "Flight"):
        yaw = tags.xmp_number(f"{prefix}YawDegree")
        pitch = tags.xmp_number(f"{prefix}PitchDegree")
        roll = tags.xmp_number(f"{prefix}RollDegree")
        if yaw is not None and pitch is not None:
            return Angles(yaw, pitch, roll or 0.0, prefix == "Flight")
    return None


def rotation_from_angles(yaw: float, pitch: float, roll: float) -> Matrix:
    """Return world_from_gimbal = R_z(yaw) R_y(pitch) R_x(roll).

    Args:
        yaw: [deg].
        pitch: [deg].
        roll: [deg].

    Returns:
        Shape (3, 3), gimbal axes (x forward, y right, z down) to world NED.
    """
    (cy, cp, cr), (sy, sp, sr) = (f(np.radians([yaw, pitch, roll])) for f in (np.cos, np.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def camera_rotation(angles: Angles, flight_yaw: float | None) -> tuple[Matrix, bool]:
    """Return the rotation of the camera and whether a flipped roll was set right.

    Angles near straight down may be told as yaw + 180, roll 180: the same attitude, which needs
    no care. Some gimbals flip the roll alone; the photo would then hang upside down, which a
    gimbal under a vehicle cannot do. Looking ahead, up in the photo is up in the world; looking
    down, it is where the vehicle's nose points, within a right angle.

    Args:
        angles: What the photo says.
        flight_yaw: Heading of the vehicle [deg], or None.

    Returns:
        world_from_camera rotation, shape (3, 3), and whether 180 was taken off the roll.
    """
    as_told = rotation_from_angles(*angles[:3]) @ GIMBAL_FROM_CAMERA
    if abs(angles.roll) < 90.0:
        return as_told, False
    turned = rotation_from_angles(angles.yaw, angles.pitch, angles.roll - 180.0)
    turned = turned @ GIMBAL_FROM_CAMERA
    if abs(np.cos(np.radians(angles.pitch))) > 0.17:  # more than 10 degrees from the vertical
        flipped = bool(turned[2, 1] > as_told[2, 1])
    elif flight_yaw is not None:
        nose = np.array([np.cos(np.radians(flight_yaw)), np.sin(np.radians(flight_yaw)), 0.0])
        flipped = bool(-turned[:, 1] @ nose > -as_told[:, 1] @ nose)
    else:
        flipped = False
    return (turned, True) if flipped else (as_told, False)


def position(tags: PhotoTags) -> tuple[float, float] | None:
    """Return latitude and longitude [deg]: XMP's, which has more digits, or the GPS tags'."""
    lat = tags.xmp_number("GpsLatitude", "Latitude")
    # Several models misspell the longitude.
    lon = tags.xmp_number("GpsLongitude", "GpsLongtitude", "Longitude")
    if lat is None or lon is None:
        lat, lon = tags.lat_deg, tags.lon_deg
    if lat is None or lon is None or abs(lat) > 90.0 or abs(lon) > 180.0:
        return None
    # Exactly 0, 0 is what cameras write before their first fix.
    return None if lat == 0.0 and lon == 0.0 else (lat, lon)


class _Place(NamedTuple):
    lat: float
    lon: float
    absolute: float | None
    relative: float | None
    fixed: bool


def _place(tags: PhotoTags) -> _Place | None:
    where = position(tags)
    if where is None:
        return None
    absolute = tags.xmp_number("AbsoluteAltitude")
    return _Place(
        *where,
        tags.height_m if absolute is None else absolute,
        tags.xmp_number("RelativeAltitude"),
        tags.xmp_number("RtkFlag") == _RTK_FIXED,
    )


def read(path: Path, options: Options) -> Flight:
    """Read a folder of DJI photos.

    The local frame has its origin at the first photo's latitude and longitude, and at the height
    of take-off where the photos tell their height above it.

    Raises:
        FlightError: If it cannot be used.
    """
    folder = _photo_folder(path)
    tags: dict[str, PhotoTags] = {}
    silent = []
    mask = folder / "mask.png"
    for photo in images_in(folder):
        if photo == mask:
            continue
        try:
            read = read_tags(photo)
        except FlightError:
            read = PhotoTags()
        if gimbal_angles(read) is None or _place(read) is None:
            silent.append(photo.name)
        else:
            tags[photo.name] = read
    if not tags:
        raise FlightError(f"{path}: expected photos with GPS and gimbal angles, got none")
    notes = [skipped_note(len(silent), "no position or angles in them", silent)] if silent else []
    origin, has_ground, height_note = _origin([_place(read) for read in tags.values()])
    notes += height_note
    posed, pose_notes = _posed(tags, origin)
    if options.poses is not None:
        posed, pose_notes = read_poses(options.poses), []
    size = (options.camera.width, options.camera.height) if options.camera else None
    frames, size, skipped = select_frames(posed, PhotoFinder([folder]), path, camera_size=size)
    if options.mask is None and mask.is_file():
        notes.append(MASK_NOTE)
    camera, camera_note = _camera(path, options, tags.get(frames[0].name), size)
    ground = options.ground_down_m
    if ground is None and has_ground:
        ground = 0.0
        notes.append("ground taken to be level with take-off (down = 0); correct by --ground-down")
    elif ground is None:
        notes.append("height of the ground not known: give --ground-down")
    return Flight(
        name=path.resolve().name,
        camera=camera,
        frames=frames,
        origin=origin,
        ground_down_m=ground,
        mask=options.mask or (mask if mask.is_file() else None),
        source=path,
        format="dji",
        notes=(*skipped, *notes, *pose_notes, *camera_note),
    )


def _origin(places: list[_Place | None]) -> tuple[Origin, bool, list[str]]:
    """Return the origin, whether down = 0 is take-off there, and a note."""
    known = [place for place in places if place is not None]
    first = known[0]
    take_off = [
        place.absolute - place.relative
        for place in known
        if place.absolute is not None and place.relative is not None
    ]
    if take_off:
        kind = "RTK" if all(place.fixed for place in known) else "GPS without RTK, metres off"
        note = f"positions from {kind}; origin at the first photo, at the height of take-off"
        return Origin(first.lat, first.lon, float(np.median(take_off))), True, [note]
    if any(place.relative is not None for place in known):
        note = "no height above sea level in the photos: origin height 0 stands for take-off"
        return Origin(first.lat, first.lon, 0.0), True, [note]
    heights = [place.absolute for place in known if place.absolute is not None]
    note = "no height above take-off in the photos: down = 0 at the lowest photo"
    return Origin(first.lat, first.lon, min(heights, default=0.0)), False, [note]


def _posed(tags: dict[str, PhotoTags], origin: Origin) -> tuple[list[PosedName], list[str]]:
    posed, unknown, flipped, from_flight = [], [], [], []
    times = [read.time_s for read in tags.values() if read.time_s is not None]
    start = min(times, default=0.0)
    for name, read in tags.items():
        place, angles = _place(read), gimbal_angles(read)
        if place is None or angles is None:
            continue
        if place.fixed and place.absolute is not None:
            height = place.absolute  # far better than the barometer's height above take-off
        elif place.relative is not None:
            height = origin.height_m + place.relative
        elif place.absolute is not None:
            height = place.absolute
        else:
            unknown.append(name)
            continue
        pose = np.eye(4)
        pose[:3, :3], was_flipped = camera_rotation(angles, read.xmp_number("FlightYawDegree"))
        pose[:3, 3] = ned_from_geodetic(place.lat, place.lon, height, origin)
        posed.append(
            PosedName(name, pose, math.nan if read.time_s is None else read.time_s - start)
        )
        flipped += [name] if was_flipped else []
        from_flight += [name] if angles.from_flight else []
    posed.sort(key=lambda entry: (math.inf if math.isnan(entry.t_s) else entry.t_s, entry.name))
    notes = []
    if unknown:
        notes.append(skipped_note(len(unknown), "no height in them", unknown))
    if flipped:
        notes.append(f"{len(flipped)} photos with a flipped gimbal roll set upright")
    if from_flight:
        notes.append(f"{len(from_flight)} photos without gimbal angles: the vehicle's are taken")
    return posed, notes


def _camera(
    path: Path, options: Options, tags: PhotoTags | None, size: tuple[int, int]
) -> tuple[Camera, list[str]]:
    if options.gives_camera:
        return options.camera_for(*size), []
    described = path / "flight.toml"
    table = read_toml(described).get("camera") if described.is_file() else None
    if isinstance(table, dict):
        camera = camera_from_table(table, f"{described}: [camera]", size)
        if camera is not None:
            return camera, ["intrinsics from flight.toml"]
    found = dji_camera(tags, *size) if tags is not None else None
    if found is None:
        raise FlightError(f"{path}: camera without intrinsics: {NO_INTRINSICS}")
    return found[0], [found[1]]
