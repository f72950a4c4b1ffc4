"""PX4 ULog files (.ulg), read with pyulog.

Used: sensor_combined (rate rad/s and specific force m/s^2, body FRD, averages over the integration
time that ends at the stamp), vehicle_gps_position or sensor_gps (degrees times 1e7 and millimetres,
or degrees and metres from PX4 1.14 on; velocity NED m/s), vehicle_air_data or sensor_baro (metres),
vehicle_magnetometer, camera_capture or camera_trigger. Times: microseconds since boot, one clock.
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
Table = dict[str, Any]

_WANTED = (
    "sensor_combined",
    "vehicle_gps_position",
    "sensor_gps",
    "vehicle_air_data",
    "sensor_baro",
    "vehicle_magnetometer",
    "camera_capture",
    "camera_trigger",
)
_INVALID = 2147483647  # relative stamp of a sensor that has no sample


def read_ulog(path: str | Path) -> SensorLog:
    """Read a ULog file.

    Args:
        path: The file.

    Returns:
        The log; what it lacks is None and named in `extra["missing"]`.

    Raises:
        FlightError: If it is no ULog file, or has no IMU, or pyulog is not installed.
    """
    path = Path(path)
    try:
        from pyulog import ULog
    except ImportError:
        raise FlightError(
            f"{path}: reading ULog needs pyulog: pip install 'hsvaos[logs]'"
        ) from None
    try:
        ulog = ULog(str(path), list(_WANTED))
    except Exception as error:
        # pyulog raises whatever the damage leads to: IndexError, struct.error, TypeError ...
        raise FlightError(f"{path}: expected a PX4 ULog file: {error}") from None
    tables: dict[str, Table] = {}
    for data in ulog.data_list:
        if data.multi_id == 0 or data.name not in tables:
            tables[data.name] = data.data
    if "sensor_combined" not in tables:
        raise FlightError(f"{path}: the log has no sensor_combined message (IMU)")
    imu = tables["sensor_combined"]
    start = int(imu["timestamp"][0])
    missing: list[str] = []
    notes: list[str] = []
    gnss_table = tables.get("vehicle_gps_position", tables.get("sensor_gps"))
    gnss, origin = None, None
    if gnss_table is None:
        missing.append("vehicle_gps_position or sensor_gps (GNSS)")
    else:
        gnss, origin = _gnss(gnss_table, start, notes)
    baro = _baro(tables, start)
    if baro is None:
        missing.append("vehicle_air_data or sensor_baro (barometer)")
    notes += [f"{path.name}: no message {message}" for message in missing]
    return SensorLog(
        imu=_imu(imu, start),
        gnss=gnss,
        baro=baro,
        mag=_mag(tables, start),
        origin=origin,
        triggers=_triggers(tables, start),
        name=path.name,
        notes=tuple(notes),
        extra={"missing": tuple(missing)},
    )


def _seconds(stamps: Any, start: int) -> Array:
    """Return seconds from the start of stamps in microseconds."""
    return np.asarray((np.asarray(stamps, dtype=np.int64) - start) * 1e-6)


def _vector(table: Table, name: str) -> Array:
    """Return three columns name[0] ... name[2] side by side."""
    return np.stack([np.asarray(table[f"{name}[{i}]"], dtype=np.float64) for i in range(3)], axis=1)


def _imu(table: Table, start: int) -> ImuLog:
    """Return the IMU: each sample speaks of the middle of the time it was averaged over."""
    span = np.asarray(table["gyro_integral_dt"], dtype=np.float64)
    # seconds in old logs, microseconds since PX4 1.10
    seconds = np.where(span > 1.0, 1e-6 * span, span)
    t = _seconds(table["timestamp"], start) - 0.5 * seconds
    return ImuLog(t - t[0], _vector(table, "gyro_rad"), _vector(table, "accelerometer_m_s2"))


def _gnss(table: Table, start: int, notes: list[str]) -> tuple[GnssLog, Origin | None]:
    """Return the fixes in a local frame that begins at the first of them."""
    if "latitude_deg" in table:
        llh = [table["latitude_deg"], table["longitude_deg"], table["altitude_msl_m"]]
    else:
        llh = [table["lat"] * 1e-7, table["lon"] * 1e-7, table["alt"] * 1e-3]
    places = np.stack([np.asarray(c, dtype=np.float64) for c in llh], axis=1)
    good = np.asarray(table["fix_type"]) >= 3
    if not good.all():
        notes.append(f"gnss: {int((~good).sum())} of {len(good)} messages without a 3-D fix")
    velocity = np.stack([table[f"vel_{axis}_m_s"] for axis in "ned"], axis=1).astype(np.float64)
    if "vel_ned_valid" in table:
        velocity[np.asarray(table["vel_ned_valid"]) == 0] = np.nan
    t = _seconds(table["timestamp"], start)[good]
    flat, down = np.asarray(table["eph"])[good], np.asarray(table["epv"])[good]
    speed = np.asarray(table["s_variance_m_s"])[good]
    origin = Origin(*places[good][0].tolist()) if good.any() else None
    position = places[good] if origin is None else ned_from_llh(places[good], origin)
    if origin is not None:
        notes.append("gnss: the local frame begins at the first fix; heights above sea level")
    return GnssLog(
        t,
        position,
        velocity[good],
        np.stack([flat, flat, down], axis=1).astype(np.float64),
        np.repeat(speed[:, None], 3, axis=1).astype(np.float64),
    ), origin


def _baro(tables: dict[str, Table], start: int) -> BaroLog | None:
    """Return barometric heights from whichever message has them."""
    for name, column in (("vehicle_air_data", "baro_alt_meter"), ("sensor_baro", "altitude")):
        table = tables.get(name)
        if table is not None and column in table:
            stamps = table.get("timestamp_sample", table["timestamp"])
            return BaroLog(_seconds(stamps, start), np.asarray(table[column], dtype=np.float64))
    table = tables["sensor_combined"]
    if "baro_alt_meter" in table:
        late = np.asarray(table["baro_timestamp_relative"], dtype=np.int64)
        good = late != _INVALID
        if good.any():
            t = _seconds(np.asarray(table["timestamp"], dtype=np.int64) + late, start)[good]
            fresh = np.concatenate([[True], np.diff(t) > 0.0])
            height = np.asarray(table["baro_alt_meter"], dtype=np.float64)[good]
            return BaroLog(t[fresh], height[fresh])
    return None


def _mag(tables: dict[str, Table], start: int) -> MagLog | None:
    """Return the magnetometer from whichever message has it."""
    for name in ("vehicle_magnetometer", "sensor_combined"):
        table = tables.get(name)
        if table is not None and "magnetometer_ga[0]" in table:
            return MagLog(_seconds(table["timestamp"], start), _vector(table, "magnetometer_ga"))
    return None


def _triggers(tables: dict[str, Table], start: int) -> tuple[tuple[str, float], ...]:
    """Return photos by sequence number, with their times."""
    table = tables.get("camera_capture", tables.get("camera_trigger"))
    if table is None:
        return ()
    times = _seconds(table["timestamp"], start)
    numbers = table.get("seq", np.arange(len(times)))
    return tuple((f"photo_{int(n):04d}", float(t)) for n, t in zip(numbers, times, strict=True))
