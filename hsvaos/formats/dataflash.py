"""ArduPilot DataFlash logs (.bin), read with pymavlink.

Used: IMU (rate rad/s, specific force m/s^2, body FRD), GPS (degrees, metres above sea level,
ground speed and course, VZ down m/s), GPA (the receiver's own accuracy), BARO (metres above the
ground), MAG, CAM. Times since boot: TimeUS in microseconds; in old logs TimeMS in milliseconds,
where that of GPS is the time of week and its column T the time since boot.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import FlightError, Origin
from hsvaos.geodesy import ned_from_llh
from hsvaos.nav.log import BaroLog, GnssLog, ImuLog, MagLog, SensorLog

Array = NDArray[np.float64]
Rows = list[dict[str, Any]]

_WANTED = ("IMU", "GPS", "GPA", "BARO", "MAG", "CAM", "TRIG")


def read_dataflash(path: str | Path) -> SensorLog:
    """Read a DataFlash log.

    Args:
        path: The file.

    Returns:
        The log; what it lacks is None and named in `extra["missing"]`.

    Raises:
        FlightError: If it is no DataFlash log, or has no IMU, or pymavlink is not installed.
    """
    path = Path(path)
    rows = _messages(path)
    if not rows["IMU"]:
        raise FlightError(f"{path}: the log has no IMU message")
    start = _time(rows["IMU"][0])
    missing: list[str] = []
    notes: list[str] = []
    gnss, origin = _gnss(rows, start, notes)
    if not rows["GPS"]:
        missing.append("GPS (GNSS)")
    if not rows["BARO"]:
        missing.append("BARO (barometer)")
    notes += [f"{path.name}: no message {message}" for message in missing]
    imu = rows["IMU"]
    return SensorLog(
        imu=ImuLog(
            _times(imu, start),
            _columns(imu, "GyrX", "GyrY", "GyrZ"),
            _columns(imu, "AccX", "AccY", "AccZ"),
        ),
        gnss=gnss,
        baro=BaroLog(_times(rows["BARO"], start), _columns(rows["BARO"], "Alt")[:, 0])
        if rows["BARO"]
        else None,
        mag=MagLog(_times(rows["MAG"], start), _columns(rows["MAG"], "MagX", "MagY", "MagZ"))
        if rows["MAG"]
        else None,
        origin=origin,
        triggers=tuple(
            (f"photo_{int(row.get('Img', i)):04d}", _time(row) - start)
            for i, row in enumerate(rows["CAM"] or rows["TRIG"])
        ),
        name=path.name,
        notes=tuple(notes),
        extra={"missing": tuple(missing)},
    )


def _messages(path: Path) -> dict[str, Rows]:
    """Return the rows of the wanted messages, of the first sensor of each kind."""
    try:
        from pymavlink.DFReader import DFReader_binary
    except ImportError:
        raise FlightError(
            f"{path}: reading DataFlash needs pymavlink: pip install 'hsvaos[logs]'"
        ) from None
    rows: dict[str, Rows] = {kind: [] for kind in _WANTED}
    try:
        reader = DFReader_binary(str(path))
        try:
            while (message := reader.recv_match(type=list(_WANTED))) is not None:
                row = message.to_dict()
                if row.get("I", 0) == 0:
                    rows[message.get_type()].append(row)
        finally:
            reader.close()
    except Exception as error:
        # pymavlink raises whatever the damage leads to
        raise FlightError(f"{path}: expected an ArduPilot DataFlash log: {error}") from None
    return rows


def _time(row: dict[str, Any]) -> float:
    """Return the time of a message since boot [s]."""
    if "TimeUS" in row:
        return float(row["TimeUS"]) * 1e-6
    return float(row["T"] if "T" in row else row["TimeMS"]) * 1e-3


def _times(rows: Rows, start: float) -> Array:
    """Return the times of messages from the start [s]."""
    return np.array([_time(row) - start for row in rows])


def _columns(rows: Rows, *names: str) -> Array:
    """Return columns side by side, NaN where a message lacks one."""
    return np.array(
        [[float(row.get(name, np.nan)) for name in names] for row in rows], dtype=np.float64
    ).reshape(len(rows), len(names))


def _gnss(rows: dict[str, Rows], start: float, notes: list[str]) -> tuple[GnssLog | None, Any]:
    """Return the 3-D fixes in a local frame that begins at the first of them, and its origin."""
    fixes = [row for row in rows["GPS"] if row["Status"] >= 3]
    if len(fixes) < len(rows["GPS"]):
        without = len(rows["GPS"]) - len(fixes)
        notes.append(f"gnss: {without} of {len(rows['GPS'])} messages without a 3-D fix")
    if not fixes:
        return None, None
    places = _columns(fixes, "Lat", "Lng", "Alt")
    origin = Origin(*places[0].tolist())
    notes.append("gnss: the local frame begins at the first fix; heights above sea level")
    course = np.radians(_columns(fixes, "GCrs")[:, 0])
    speed = _columns(fixes, "Spd")[:, 0]
    velocity = np.stack(
        [speed * np.cos(course), speed * np.sin(course), _columns(fixes, "VZ")[:, 0]], axis=1
    )
    t = _times(fixes, start)
    position_std = velocity_std = None
    accuracy = {row["TimeUS"]: row for row in rows["GPA"] if row.get("VV", 1)}
    if accuracy and all(row.get("TimeUS") in accuracy for row in fixes):
        own = _columns([accuracy[row["TimeUS"]] for row in fixes], "HAcc", "VAcc", "SAcc")
        if (own > 0.0).all():
            position_std, velocity_std = own[:, [0, 0, 1]], own[:, [2, 2, 2]]
    return GnssLog(
        t,
        ned_from_llh(places, origin),
        velocity,
        position_std,
        velocity_std,
    ), origin
