"""Sensor logs of any known kind, told apart by what they hold."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hsvaos.flight import Flight, FlightError, Origin
from hsvaos.formats.sensor_csv import is_csv_log, read_csv_folder, read_csv_log
from hsvaos.nav.attitude import check_unit
from hsvaos.nav.log import Mounting, SensorLog

_ULOG_MAGIC = b"ULog\x01\x12\x35"
_DATAFLASH_MAGIC = b"\xa3\x95"
_ONE_FILE = (".ulg", ".bin")
_KINDS = ("imu", "gnss", "baro", "mag", "triggers")


def open_sensor_log(path: str | Path) -> SensorLog:
    """Open a sensor log.

    Args:
        path: A flight folder with a [nav] table in flight.toml, a folder with imu.csv, a PX4 ULog
            file, an ArduPilot DataFlash file, or a folder with just one of these files.

    Raises:
        FlightError: If it is none of these, or cannot be read.
    """
    path = Path(path)
    if path.name == "flight.toml":
        path = path.parent
    if path.is_dir():
        if (path / "flight.toml").is_file():
            return _from_toml(path)
        if is_csv_log(path):
            return read_csv_folder(path)
        logs = _logs_in(path)
        if len(logs) == 1:
            log = open_sensor_log(logs[0])
            return log.replace(notes=(f"{logs[0].name}: the one log in {path}", *log.notes))
        raise FlightError(
            f"{path}: expected a sensor log (flight.toml with a [nav] table, or imu.csv), got a "
            "folder with neither" + _give_one(logs)
        )
    if not path.is_file():
        raise FlightError(f"{path}: no such file or folder")
    with path.open("rb") as file:
        head = file.read(8)
    if head.startswith(_ULOG_MAGIC):
        from hsvaos.formats.ulog import read_ulog

        return read_ulog(path)
    if head.startswith(_DATAFLASH_MAGIC):
        from hsvaos.formats.dataflash import read_dataflash

        return read_dataflash(path)
    raise FlightError(
        f"{path}: expected a PX4 ULog or an ArduPilot DataFlash log, got a file that begins with "
        f"{head!r}"
    )


def _logs_in(folder: Path) -> list[Path]:
    """Return the files of a folder that are named like an autopilot's log."""
    return sorted(
        file for file in folder.iterdir() if file.suffix.lower() in _ONE_FILE and file.is_file()
    )


def _give_one(logs: list[Path]) -> str:
    """Return the end of a message: which files could be given instead."""
    if not logs:
        return ""
    names = ", ".join(file.name for file in logs[:3]) + (" ..." if len(logs) > 3 else "")
    return f"; give a log file itself ({names})"


def sensor_log_of(flight: Flight) -> SensorLog:
    """Return the sensor log of a flight.

    Args:
        flight: `sensors` names a file for "imu" and whichever of "gnss", "baro", "mag",
            "triggers" there are, or one file for "log"; and the mounting.

    Raises:
        FlightError: If the flight has no sensors, or they cannot be read.
    """
    sensors = flight.sensors
    mounting = _mounting(sensors, str(flight.source))
    if "log" in sensors:
        return open_sensor_log(sensors["log"]).replace(mounting=mounting, name=flight.name)
    if "imu" not in sensors:
        raise FlightError(
            f"{flight.source}: the flight has no sensor log: expected an imu file in [nav], got "
            f"{', '.join(sensors) or 'none'}"
        )
    files = {kind: Path(sensors[kind]) for kind in _KINDS if sensors.get(kind)}
    return read_csv_log(files, origin=flight.origin, mounting=mounting, name=flight.name)


def _from_toml(folder: Path) -> SensorLog:
    """Read the sensors that a flight.toml names, whatever else the flight holds."""
    file = folder / "flight.toml"
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FlightError(f"{file}: expected TOML: {error}") from None
    nav = table.get("nav")
    if not isinstance(nav, dict) or "imu" not in nav:
        raise FlightError(
            f'{file}: expected a [nav] table with imu = "...", got none'
            + _give_one(_logs_in(folder))
        )
    world = table.get("world", {})
    origin = None
    if "origin_lat_deg" in world and "origin_lon_deg" in world:
        origin = Origin(
            float(world["origin_lat_deg"]),
            float(world["origin_lon_deg"]),
            float(world.get("origin_height_m", 0.0)),
        )
    files = {kind: folder / str(nav[kind]) for kind in _KINDS if nav.get(kind)}
    return read_csv_log(
        files,
        origin=origin,
        mounting=_mounting(nav, str(file)),
        name=str(table.get("flight", {}).get("name", folder.name)),
    )


def _mounting(table: Mapping[str, Any], where: str) -> Mounting:
    """Return boresight and lever arms from a table, defaults where it has none."""
    out: dict[str, Any] = {}
    try:
        if table.get("body_from_camera_q") is not None:
            q = np.asarray(table["body_from_camera_q"], dtype=np.float64)
            out["body_from_camera_q"] = check_unit(q, f"{where}: body_from_camera_q")
        for name in ("camera_lever_arm", "antenna_lever_arm"):
            if table.get(f"{name}_m") is not None:
                arm = np.asarray(table[f"{name}_m"], dtype=np.float64)
                if arm.shape != (3,) or not np.isfinite(arm).all():
                    raise ValueError(f"{where}: {name}_m must be 3 metres, got {arm.tolist()}")
                out[name] = arm
    except (TypeError, ValueError) as error:
        raise FlightError(str(error)) from None
    return Mounting(**out)
