"""The native flight folder: flight.toml, poses.csv, photos and sensor logs, read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from hsvaos.camera import Camera
from hsvaos.flight import Flight, FlightError, Origin
from hsvaos.formats.options import (
    CAMERA_KEYS,
    NO_INTRINSICS,
    Options,
    camera_from_table,
    number_in,
)
from hsvaos.formats.poses import PosedName, read_poses, rotation_from_quaternion
from hsvaos.formats.select import PhotoFinder, images_in, select_frames
from hsvaos.formats.text import read_csv, read_toml

LOGS = ("imu", "gnss", "baro", "triggers")
"""Files of the sensor log, by their key in [nav]."""
MOUNTING = {"body_from_camera_q": 4, "camera_lever_arm_m": 3, "antenna_lever_arm_m": 3}
"""How the camera and the antenna sit in the vehicle, by key in [nav], and how many numbers."""

_TABLES: dict[str, tuple[str, ...]] = {
    "flight": ("name",),
    "camera": CAMERA_KEYS,
    "frames": ("folder", "poses", "mask", "masks"),
    "world": (
        "frame",
        "origin_lat_deg",
        "origin_lon_deg",
        "origin_height_m",
        "ground_down_m",
        "terrain",
    ),
    "nav": (*LOGS, *MOUNTING),
}
"""The tables of flight.toml and their keys."""


def find_description(path: Path) -> Path | None:
    """Return the flight.toml that a path is or holds."""
    described = path / "flight.toml" if path.is_dir() else path
    return described if described.is_file() and described.suffix.lower() == ".toml" else None


def recognise(path: Path, options: Options) -> bool:
    """Whether there is a flight.toml that says where frames or a log are.

    Raises:
        FlightError: If flight.toml is malformed.
    """
    described = find_description(path)
    return described is not None and bool({"frames", "nav"} & read_toml(described).keys())


def read(path: Path, options: Options) -> Flight:
    """Read a native flight folder.

    Raises:
        FlightError: If it cannot be used.
    """
    described = find_description(path)
    if described is None:
        raise FlightError(f"{path}: no flight.toml")
    content = read_toml(described)
    tables: dict[str, dict[str, Any]] = {}
    for name in _TABLES:
        table = content.get(name, {})
        if not isinstance(table, dict):
            raise FlightError(f"{described}: [{name}] must be a table, got {table!r}")
        tables[name] = table
    folder, frames_table = described.parent, tables["frames"]
    sensors = _sensors(tables["nav"], folder, described)
    posed, pose_note = _posed(frames_table, sensors, folder, described, options)
    where = f"{described}: [camera]"
    camera = options.camera
    if not options.gives_camera:
        if not tables["camera"]:
            raise FlightError(f"{described}: camera without intrinsics: {NO_INTRINSICS}")
        camera = camera_from_table(tables["camera"], where, None)
    image_folder = _text(frames_table, "folder", described, "[frames]") or "images"
    masks = _masks(frames_table, folder, described)
    frames, size, notes = select_frames(
        posed,
        PhotoFinder([folder / image_folder, folder]),
        path,
        camera_size=(camera.width, camera.height) if camera else None,
        masks=masks,
    )
    if camera is None:
        camera = _camera(options, tables["camera"], where, size)
    world = tables["world"]
    if world.get("frame", "NED") != "NED":
        raise FlightError(f"{described}: [world] frame must be 'NED', got {world['frame']!r}")
    ground = options.ground_down_m
    if ground is None and "ground_down_m" in world:
        ground = number_in(world, "ground_down_m", f"{described}: [world]")
    return Flight(
        name=_text(tables["flight"], "name", described, "[flight]") or folder.resolve().name,
        camera=camera,
        frames=frames,
        origin=_origin(world, described),
        ground_down_m=ground,
        mask=options.mask or _file(frames_table, "mask", folder, described, "[frames]"),
        terrain=_file(world, "terrain", folder, described, "[world]"),
        sensors=sensors,
        source=path,
        format="native",
        notes=(*_unknown_notes(content, described), *notes, *pose_note),
    )


def _unknown_notes(content: dict[str, Any], described: Path) -> list[str]:
    """Return notes on what is not understood: misspelt, or of a newer version."""
    notes = []
    unknown = [name for name in content if name not in _TABLES]
    if unknown:
        notes.append(
            f"{described}: passed over {_listed(unknown)} at the top level; known are the tables "
            f"{', '.join(f'[{name}]' for name in _TABLES)}"
        )
    for table, known in _TABLES.items():
        unknown = [key for key in content.get(table, {}) if key not in known]
        if unknown:
            notes.append(
                f"{described}: passed over {_listed(unknown)} in [{table}]; known are "
                f"{', '.join(known)}"
            )
    return notes


def _listed(names: list[str]) -> str:
    return ", ".join(repr(name) for name in names[:5]) + (", ..." if len(names) > 5 else "")


def _camera(options: Options, table: dict[str, Any], where: str, size: tuple[int, int]) -> Camera:
    if options.gives_camera:
        return options.camera_for(*size)
    camera = camera_from_table(table, where, size)
    if camera is None:
        raise FlightError(f"{where} describes no camera: {NO_INTRINSICS}")
    return camera


def _posed(
    table: dict[str, Any],
    sensors: dict[str, Any],
    folder: Path,
    described: Path,
    options: Options,
) -> tuple[list[PosedName], list[str]]:
    """Return the frames with poses, or from the triggers alone where a filter shall find them."""
    poses = options.poses or _file(table, "poses", folder, described, "[frames]")
    if poses is not None:
        return read_poses(poses), []
    if "triggers" not in sensors:
        raise FlightError(
            f"{described}: no poses: expected [frames] poses = FILE, or [nav] with imu and triggers"
        )
    rows = read_csv(sensors["triggers"], ("file", "t_s"))
    posed = [PosedName(row.text("file"), None, row.number("t_s")) for row in rows]
    posed = [
        entry
        if math.isfinite(entry.t_s)
        else PosedName(entry.name, None, problem=f"{sensors['triggers']}: {entry.name}: no time")
        for entry in posed
    ]
    return posed, ["no poses in the flight: they are to be estimated from its sensor log"]


def _sensors(table: dict[str, Any], folder: Path, described: Path) -> dict[str, Any]:
    sensors: dict[str, Any] = {}
    for key in LOGS:
        path = _file(table, key, folder, described, "[nav]")
        if path is not None:
            sensors[key] = path
    for key, count in MOUNTING.items():
        if key not in table:
            continue
        try:
            values = np.array(table[key], dtype=np.float64)
            if values.shape != (count,) or not np.isfinite(values).all():
                raise ValueError(f"expected {count} finite numbers, got {table[key]!r}")
            if key.endswith("_q"):
                rotation_from_quaternion(values)
                values = values / np.linalg.norm(values)
        except (TypeError, ValueError) as error:
            raise FlightError(f"{described}: [nav] {key}: {error}") from None
        sensors[key] = values
    return sensors


def _origin(world: dict[str, Any], described: Path) -> Origin | None:
    keys = ("origin_lat_deg", "origin_lon_deg", "origin_height_m")
    if not any(key in world for key in keys):
        return None
    where = f"{described}: [world]"
    lat, lon = number_in(world, keys[0], where), number_in(world, keys[1], where)
    if abs(lat) > 90.0 or abs(lon) > 360.0:
        raise FlightError(f"{where} origin must be degrees on the Earth, got {lat}, {lon}")
    height = number_in(world, keys[2], where) if keys[2] in world else 0.0
    return Origin(lat, lon, height)


def _text(table: dict[str, Any], key: str, described: Path, section: str) -> str | None:
    value = table.get(key)
    if value is not None and not isinstance(value, str):
        raise FlightError(f"{described}: {section} {key} must be text, got {value!r}")
    return value


def _file(
    table: dict[str, Any], key: str, folder: Path, described: Path, section: str
) -> Path | None:
    name = _text(table, key, described, section)
    if name is None:
        return None
    path = folder / name
    if not path.is_file():
        raise FlightError(f"{described}: {section} {key} names {name!r}, which is not there")
    return path


def _masks(table: dict[str, Any], folder: Path, described: Path) -> dict[str, Path]:
    """Return masks of single photos by stem, from the folder that [frames] masks names."""
    name = _text(table, "masks", described, "[frames]")
    if name is None:
        return {}
    if not (folder / name).is_dir():
        raise FlightError(f"{described}: [frames] masks names {name!r}, which is no folder")
    return {path.stem.lower(): path for path in images_in(folder / name)}
