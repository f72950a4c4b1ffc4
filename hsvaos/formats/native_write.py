"""The native flight folder, written whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.flight import Flight, FlightError
from hsvaos.formats.native import LOGS, MOUNTING
from hsvaos.formats.poses import PosedName, write_poses_csv
from hsvaos.formats.text import write_csv

_JPEG_QUALITY = 95


def write_native(
    flight: Flight,
    folder: str | Path,
    *,
    images: Iterable[NDArray[Any]] | None = None,
    logs: Mapping[str, Mapping[str, ArrayLike | Sequence[str]]] | None = None,
    truth: Mapping[str, Any] | None = None,
) -> Path:
    """Write a flight as a native folder.

    Everything is written into a folder with a temporary name beside the target, which is then
    renamed: a crash leaves no half flight under the final name.

    Args:
        flight: What to write. Its photos, masks, terrain and sensor files are copied.
        folder: The new folder; it must not exist, or be empty.
        images: Photos in the order of the frames, each (H, W, 3) RGB or (H, W) grey, to be
            encoded as the frame's name says (.png without loss, .jpg in quality 95), in place of
            copies of the frames' files.
        logs: Tables to write as sensor logs in place of the flight's files: by kind ("imu",
            "gnss", "baro", "triggers") a mapping of column name to values, each shape (T,).
        truth: Content of truth.json (simulated flights).

    Returns:
        The folder.

    Raises:
        FlightError: If the target is not empty or cannot be written, or a photo is missing.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FlightError(f"{folder}: expected a new or empty folder to write to")
    unfinished = folder.with_name(f".{folder.name}.{os.getpid()}.unfinished")
    try:
        (unfinished / "images").mkdir(parents=True)
        names = _write_photos(flight, unfinished / "images", images)
        text = _description(flight, unfinished, names, logs or {})
        (unfinished / "flight.toml").write_text(text, encoding="utf-8")
        if truth is not None:
            (unfinished / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
        unfinished.replace(folder)
    except OSError as error:
        raise FlightError(f"{folder}: cannot be written ({error})") from None
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return folder


def _write_photos(flight: Flight, folder: Path, images: Iterable[NDArray[Any]] | None) -> list[str]:
    """Write the photos; return their names, with the extension of what the file really is."""
    names: list[str] = []
    given = iter(images) if images is not None else None
    for frame in flight.frames:
        plain = Path(frame.name).name
        name = plain if given is not None else Path(plain).stem + frame.path.suffix
        if name in names:
            raise FlightError(f"{folder}: two frames would both be called {name}")
        if given is None:
            if not frame.path.is_file():
                raise FlightError(f"{frame.path}: no such image")
            shutil.copyfile(frame.path, folder / name)
        else:
            image = next(given, None)
            if image is None:
                raise FlightError(f"expected {len(flight)} images, got {len(names)}")
            _encode(folder / name, image)
        names.append(name)
    if given is not None and next(given, None) is not None:
        raise FlightError(f"expected {len(flight)} images, got more")
    return names


def _encode(path: Path, image: NDArray[Any]) -> None:
    pixels = np.asarray(image)
    if pixels.ndim == 3:
        pixels = np.ascontiguousarray(pixels[..., ::-1])
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    try:
        done, data = cv2.imencode(
            path.suffix, pixels, options if path.suffix.lower() in (".jpg", ".jpeg") else []
        )
    except cv2.error as error:
        raise FlightError(f"{path.name}: cannot be encoded ({error.err})") from None
    if not done:
        raise FlightError(f"{path.name}: cannot be encoded as {path.suffix}")
    path.write_bytes(data.tobytes())


def _description(
    flight: Flight,
    folder: Path,
    names: list[str],
    logs: Mapping[str, Mapping[str, ArrayLike | Sequence[str]]],
) -> str:
    """Write the files that flight.toml names and return its text."""
    camera = flight.camera
    tables: dict[str, dict[str, Any]] = {
        "flight": {"name": flight.name},
        "camera": {
            "model": "opencv",
            "width": camera.width,
            "height": camera.height,
            **{key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy")},
            "distortion": list(camera.distortion),
        },
        "frames": {"folder": "images"},
        "world": {"frame": "NED"},
        "nav": {},
    }
    frames, world, nav = tables["frames"], tables["world"], tables["nav"]
    if flight.has_poses:
        posed = [
            PosedName(name, frame.world_from_camera, frame.t_s, covariance=frame.covariance)
            for name, frame in zip(names, flight.frames, strict=True)
        ]
        write_poses_csv(folder / "poses.csv", posed)
        frames["poses"] = "poses.csv"
    elif "triggers" not in logs and "triggers" not in flight.sensors:
        raise FlightError(f"{flight.name}: a flight needs poses or triggers to be written")
    if flight.mask is not None:
        frames["mask"] = _copy(flight.mask, folder, "mask" + flight.mask.suffix)
    masks = [(n, f.mask) for n, f in zip(names, flight.frames, strict=True) if f.mask]
    if masks:
        (folder / "masks").mkdir()
        frames["masks"] = "masks"
        for name, mask in masks:
            _copy(mask, folder, f"masks/{Path(name).stem}{mask.suffix}")
    if flight.origin is not None:
        world["origin_lat_deg"] = float(flight.origin.lat_deg)
        world["origin_lon_deg"] = float(flight.origin.lon_deg)
        world["origin_height_m"] = float(flight.origin.height_m)
    if flight.ground_down_m is not None:
        world["ground_down_m"] = float(flight.ground_down_m)
    if flight.terrain is not None:
        world["terrain"] = _copy(flight.terrain, folder, "terrain" + flight.terrain.suffix)
    for key in LOGS:
        if key in logs:
            _write_table(folder / f"{key}.csv", logs[key])
            nav[key] = f"{key}.csv"
        elif key in flight.sensors:
            nav[key] = _copy(Path(flight.sensors[key]), folder, f"{key}.csv")
    for key in MOUNTING:
        if key in flight.sensors:
            nav[key] = [float(value) for value in np.asarray(flight.sensors[key])]
    return "\n".join(_table_text(name, table) for name, table in tables.items() if table)


def _copy(source: Path, folder: Path, name: str) -> str:
    if not source.is_file():
        raise FlightError(f"{source}: no such file")
    shutil.copyfile(source, folder / name)
    return name


def _write_table(path: Path, columns: Mapping[str, ArrayLike | Sequence[str]]) -> None:
    values = [np.asarray(column) for column in columns.values()]
    if not values or any(v.ndim != 1 or v.size != values[0].size for v in values):
        raise FlightError(f"{path.name}: expected columns of one length")
    rows = [list(columns)]
    for row in zip(*(column.tolist() for column in values), strict=True):
        rows.append([value if isinstance(value, str) else repr(value) for value in row])
    write_csv(path, rows)


def _table_text(name: str, table: Mapping[str, Any]) -> str:
    lines = [f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for DEL, which TOML wants escaped too.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)
