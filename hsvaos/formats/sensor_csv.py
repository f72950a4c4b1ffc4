"""Sensor logs as CSV files: imu.csv, gnss.csv, baro.csv, mag.csv, triggers.csv.

imu.csv       t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2     body FRD, specific force
gnss.csv      t_s,lat_deg,lon_deg,alt_m,vn_m_s,ve_m_s,vd_m_s             or north_m,east_m,down_m
              optional: pos_std_m, pos_std_down_m, vel_std_m_s
baro.csv      t_s,height_m
mag.csv       t_s and three columns of the field in body axes, any unit
triggers.csv  file,t_s
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import FlightError, Origin
from hsvaos.geodesy import geodetic_from_ned, ned_from_llh
from hsvaos.nav.log import BaroLog, GnssLog, ImuLog, MagLog, Mounting, SensorLog

Array = NDArray[np.float64]

_IMU = ("gx_rad_s", "gy_rad_s", "gz_rad_s", "ax_m_s2", "ay_m_s2", "az_m_s2")
_GEODETIC = ("lat_deg", "lon_deg", "alt_m")
_LOCAL = ("north_m", "east_m", "down_m")
_VELOCITY = ("vn_m_s", "ve_m_s", "vd_m_s")


def is_csv_log(path: Path) -> bool:
    """Return whether a folder holds a log of this kind: an imu.csv."""
    return path.is_dir() and (path / "imu.csv").is_file()


def read_csv_log(
    files: Mapping[str, Path],
    *,
    origin: Origin | None = None,
    mounting: Mounting | None = None,
    name: str | None = None,
) -> SensorLog:
    """Read the files of a log.

    Args:
        files: Path by kind: "imu" is needed; "gnss", "baro", "mag" and "triggers" may be there.
        origin: Origin of the local frame; the first fix where not given and fixes are geodetic.
        mounting: Camera and antenna on the vehicle.
        name: What to call the log; the folder of imu.csv by default.

    Raises:
        FlightError: If a file or column is missing, or a number cannot be read.
    """
    if "imu" not in files:
        raise FlightError(f"a sensor log needs an IMU file, got {', '.join(files) or 'no files'}")
    imu_path = Path(files["imu"])
    imu = _columns(imu_path, ("t_s", *_IMU))
    gnss: GnssLog | None = None
    notes: list[str] = []
    if "gnss" in files:
        gnss, origin = _read_gnss(Path(files["gnss"]), origin, notes)
    baro = mag = None
    if "baro" in files:
        table = _columns(Path(files["baro"]), ("t_s", "height_m"))
        baro = BaroLog(table["t_s"], table["height_m"])
    if "mag" in files:
        table = _columns(Path(files["mag"]), ("t_s",))
        field = [column for head, column in table.items() if head != "t_s"]
        if len(field) != 3:
            raise FlightError(f"{files['mag']}: expected t_s and 3 columns, got {list(table)}")
        mag = MagLog(table["t_s"], np.stack(field, axis=1))
    return SensorLog(
        imu=ImuLog(
            imu["t_s"],
            np.stack([imu[head] for head in _IMU[:3]], axis=1),
            np.stack([imu[head] for head in _IMU[3:]], axis=1),
        ),
        gnss=gnss,
        baro=baro,
        mag=mag,
        origin=origin,
        mounting=mounting or Mounting(),
        triggers=_read_triggers(Path(files["triggers"])) if "triggers" in files else (),
        name=name or imu_path.parent.name,
        notes=tuple(notes),
    )


def read_csv_folder(folder: Path) -> SensorLog:
    """Read a folder of CSV files without a flight.toml.

    Args:
        folder: Holds imu.csv and whichever others there are.

    Raises:
        FlightError: If it cannot be read.
    """
    kinds = ("imu", "gnss", "baro", "mag", "triggers")
    files = {kind: folder / f"{kind}.csv" for kind in kinds if (folder / f"{kind}.csv").is_file()}
    return read_csv_log(files, name=folder.name)


def write_csv_log(log: SensorLog, folder: Path) -> list[Path]:
    """Write a log as CSV files, those sensors that it has.

    Args:
        log: The log; fixes are written geodetic if it has an origin, else local.
        folder: Where to; made if it is not there.

    Returns:
        The files written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / "imu.csv"]
    imu = np.column_stack([log.imu.t_s, log.imu.gyro, log.imu.accel])
    _write(written[0], ("t_s", *_IMU), imu, ("%.6f",) + ("%.7g",) * 6)
    if log.gnss is not None:
        g = log.gnss
        heads: list[str] = ["t_s", *(_LOCAL if log.origin is None else _GEODETIC), *_VELOCITY]
        formats = ["%.6f", *(("%.4f",) * 3 if log.origin is None else ("%.9f", "%.9f", "%.4f"))]
        formats += ["%.4f"] * 3
        place = g.position
        if log.origin is not None:
            place = np.stack(geodetic_from_ned(place, log.origin), axis=-1)
        table = [g.t_s[:, None], place, g.velocity]
        if g.position_std is not None:
            heads += ["pos_std_m", "pos_std_down_m"]
            table.append(g.position_std[:, [0, 2]])
            formats += ["%.4f"] * 2
        if g.velocity_std is not None:
            heads.append("vel_std_m_s")
            table.append(g.velocity_std[:, :1])
            formats.append("%.4f")
        written.append(folder / "gnss.csv")
        _write(written[-1], heads, np.concatenate(table, axis=1), formats)
    if log.baro is not None:
        written.append(folder / "baro.csv")
        table_ = np.column_stack([log.baro.t_s, log.baro.height_m])
        _write(written[-1], ("t_s", "height_m"), table_, ("%.6f", "%.4f"))
    if log.triggers:
        written.append(folder / "triggers.csv")
        with written[-1].open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("file", "t_s"))
            writer.writerows((name, f"{t:.6f}") for name, t in log.triggers)
    return written


def _write(path: Path, heads: Sequence[str], table: Array, formats: Sequence[str]) -> None:
    """Write a table of numbers with a line of heads."""
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(heads) + "\n")
        np.savetxt(file, table, fmt=list(formats), delimiter=",")


def _read_gnss(
    path: Path, origin: Origin | None, notes: list[str]
) -> tuple[GnssLog, Origin | None]:
    """Read fixes into the local frame."""
    table = _columns(path, ("t_s",))
    velocity = _group(table, _VELOCITY)
    if all(head in table for head in _GEODETIC):
        llh = _group(table, _GEODETIC)
        nowhere = (llh[:, 0] == 0.0) & (llh[:, 1] == 0.0)
        llh[nowhere] = np.nan
        if nowhere.any():
            notes.append(f"gnss: {int(nowhere.sum())} fixes at 0 N 0 E were left out")
        there = np.isfinite(llh).all(axis=1)
        if (there & ((abs(llh[:, 0]) > 90.0) | (abs(llh[:, 1]) > 360.0))).any():
            raise FlightError(f"{path}: lat_deg, lon_deg: expected degrees, got {llh[there][0]}")
        if origin is None and there.any():
            origin = Origin(*llh[there][0].tolist())
            notes.append(
                f"gnss: the local frame begins at the first fix, {origin.lat_deg:.7f} N "
                f"{origin.lon_deg:.7f} E, {origin.height_m:.1f} m"
            )
        position = llh if origin is None else ned_from_llh(llh, origin)
    elif all(head in table for head in _LOCAL):
        position = _group(table, _LOCAL)
    else:
        raise FlightError(
            f"{path}: expected the columns {','.join(_GEODETIC)} or {','.join(_LOCAL)}, got "
            f"{','.join(table)}"
        )
    position_std = velocity_std = None
    if "pos_std_m" in table:
        flat = table["pos_std_m"]
        position_std = np.stack([flat, flat, table.get("pos_std_down_m", flat)], axis=1)
    if "vel_std_m_s" in table:
        velocity_std = np.repeat(table["vel_std_m_s"][:, None], 3, axis=1)
    return GnssLog(table["t_s"], position, velocity, position_std, velocity_std), origin


def _group(table: Mapping[str, Array], heads: tuple[str, ...]) -> Array:
    """Return columns side by side; NaN for those that are not there."""
    missing = np.full(len(table["t_s"]), np.nan)
    return np.stack([table.get(head, missing) for head in heads], axis=1)


def _columns(path: Path, needed: tuple[str, ...]) -> dict[str, Array]:
    """Return the numeric columns of a CSV file by head; empty cells are NaN."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except UnicodeDecodeError:
        raise FlightError(f"{path}: expected a CSV file, got something that is not text") from None
    heads = [head.strip() for head in rows[0]] if rows else []
    missing = [head for head in needed if head not in heads]
    if missing:
        raise FlightError(
            f"{path}: the column{'s' if len(missing) > 1 else ''} {', '.join(missing)} "
            f"{'are' if len(missing) > 1 else 'is'} missing, got {', '.join(heads) or 'no heads'}"
        )
    body = [row for row in rows[1:] if row]
    for number, row in enumerate(body, start=2):
        if len(row) != len(heads):
            raise FlightError(f"{path}: line {number} has {len(row)} cells, expected {len(heads)}")
    try:
        values = np.array([[cell.strip() or "nan" for cell in row] for row in body], dtype=float)
    except ValueError as error:
        raise FlightError(f"{path}: expected numbers, got one that is not: {error}") from None
    values = values.reshape(len(body), len(heads))
    return {head: values[:, i].copy() for i, head in enumerate(heads)}


def _read_triggers(path: Path) -> tuple[tuple[str, float], ...]:
    """Read photo names and their times."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        heads = [head.strip() for head in reader.fieldnames or ()]
        if "file" not in heads or "t_s" not in heads:
            raise FlightError(f"{path}: expected the columns file,t_s, got {','.join(heads)}")
        try:
            return tuple((row["file"].strip(), float(row["t_s"])) for row in reader)
        except (TypeError, ValueError, AttributeError) as error:
            raise FlightError(f"{path}: a row without file or seconds: {error}") from None
