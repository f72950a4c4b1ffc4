"""Is a log fit for a filter? Small flaws are repaired, counted and said; others are refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import FlightError
from hsvaos.geodesy import geodetic_from_ned
from hsvaos.nav.attitude import check_unit
from hsvaos.nav.log import BaroLog, GnssLog, ImuLog, SensorLog
from hsvaos.nav.process import GAP_S

Array = NDArray[np.float64]

_LEAST_SAMPLES = 50
_LONGEST_GAP_S = 5.0
_SLOWEST_STEP_S = 0.5
_FAR_ORIGIN_KM, _FARTHEST_ORIGIN_KM = 5.0, 50.0
_MOST_FORCE = 320.0  # [m/s^2], 32 g: more than any IMU of a drone measures
_MOST_RATE = 70.0  # [rad/s], 4000 deg/s


def check_log(log: SensorLog) -> SensorLog:
    """Return the log fit for a filter, with notes on what was repaired.

    Repaired and counted: IMU samples that are not finite or beyond any IMU, repeated stamps, short
    gaps (the filter widens its uncertainty over them), fixes and heights out of order, fixes
    without position or velocity, fixes at 0 N 0 E. Refused: IMU time running backwards or not in
    seconds, long gaps, units other than rad/s and m/s^2, z axis up, too few samples, no fix at
    all, an origin far from the fixes.

    Raises:
        FlightError: If the log cannot be used; says which sensor, what was expected, what came.
    """
    notes: list[str] = []
    imu = _imu(log, notes)
    gnss = _gnss(log, notes)
    baro = None if log.baro is None else _baro(log, log.baro, notes)
    mounting = log.mounting
    check_unit(mounting.body_from_camera_q, f"{log.name}: body_from_camera_q")
    for name in ("camera_lever_arm", "antenna_lever_arm"):
        arm = np.asarray(getattr(mounting, name), dtype=np.float64)
        if arm.shape != (3,) or not np.isfinite(arm).all():
            raise FlightError(f"{log.name}: {name}_m must be 3 finite metres, got {arm.tolist()}")
    span = imu.t_s[0], imu.t_s[-1]
    if not ((gnss.t_s >= span[0]) & (gnss.t_s <= span[1])).any():
        raise FlightError(
            f"{log.name}: no GNSS fix within the IMU log ({span[0]:.1f} to {span[1]:.1f} s): "
            f"expected one clock, got fixes from {gnss.t_s[0]:.1f} s to {gnss.t_s[-1]:.1f} s"
        )
    return log.replace(imu=imu, gnss=gnss, baro=baro, notes=(*log.notes, *notes))


def _imu(log: SensorLog, notes: list[str]) -> ImuLog:
    """Check stamps, gaps and units of the IMU."""
    imu = log.imu
    good = np.isfinite(imu.t_s) & np.isfinite(imu.gyro).all(axis=1) & np.isfinite(imu.accel).all(1)
    bad = int((~good).sum())
    if bad > 0.1 * len(good):
        raise FlightError(f"{log.name}: imu: {bad} of {len(good)} samples are not finite numbers")
    if bad:
        notes.append(f"imu: {bad} samples that are not finite numbers were left out")
    good &= _believable(log.name, imu, good, notes)
    t = imu.t_s[good]
    _refuse_backwards(log.name, t)
    fresh = np.concatenate([[True], np.diff(t) > 0.0]) if len(t) else np.zeros(0, dtype=bool)
    repeated = int((~fresh).sum())
    if repeated:
        notes.append(f"imu: {repeated} samples with a repeated stamp were left out")
    imu = ImuLog(t[fresh], imu.gyro[good][fresh], imu.accel[good][fresh])
    if len(imu.t_s) < _LEAST_SAMPLES:
        raise FlightError(
            f"{log.name}: imu: expected at least {_LEAST_SAMPLES} samples, got {len(imu.t_s)}"
        )
    steps = np.diff(imu.t_s)
    _check_seconds(log.name, float(np.median(steps)))
    longest = int(np.argmax(steps))
    if steps[longest] > _LONGEST_GAP_S:
        raise FlightError(
            f"{log.name}: imu: a gap of {steps[longest]:.1f} s at {imu.t_s[longest]:.3f} s: "
            f"expected none above {_LONGEST_GAP_S:g} s; cut the log there"
        )
    if steps[longest] > GAP_S:
        notes.append(
            f"imu: {int((steps > GAP_S).sum())} gaps above {GAP_S:g} s, the longest "
            f"{steps[longest]:.2f} s: uncertainty widened"
        )
    _check_units(log.name, imu)
    return imu


def _believable(
    name: str, imu: ImuLog, good: NDArray[np.bool_], notes: list[str]
) -> NDArray[np.bool_]:
    """Return which samples lie within what an IMU can measure; spikes are counted."""
    force, rate = np.linalg.norm(imu.accel, axis=1), np.linalg.norm(imu.gyro, axis=1)
    wild = good & ((force > _MOST_FORCE) | (rate > _MOST_RATE))
    count = int(wild.sum())
    limits = f"{_MOST_FORCE:g} m/s^2 or {_MOST_RATE:g} rad/s"
    if count > 0.1 * len(good):
        if len(imu.t_s[good]) > 1:
            _check_units(name, ImuLog(imu.t_s[good], imu.gyro[good], imu.accel[good]))
        raise FlightError(
            f"{name}: imu: {count} of {len(good)} samples are above {limits}: expected m/s^2 and "
            f"rad/s without spikes, got up to {force[good].max():.3g} m/s^2 and "
            f"{rate[good].max():.3g} rad/s"
        )
    if count:
        notes.append(f"imu: {count} samples above {limits} (spikes) were left out")
    return np.asarray(~wild)


def _refuse_backwards(name: str, t: Array) -> None:
    """Refuse an IMU clock that runs backwards."""
    back = np.flatnonzero(np.diff(t) < 0.0)
    if len(back):
        k = int(back[0])
        raise FlightError(
            f"{name}: imu: time runs backwards at sample {k + 1} ({t[k + 1]:.6f} s after "
            f"{t[k]:.6f} s; {len(back)} times in all): expected increasing seconds"
        )


def _check_seconds(name: str, step: float) -> None:
    """Refuse stamps in thousandths of a second or less."""
    if step <= _SLOWEST_STEP_S:
        return
    unit, factor = next(
        (unit, factor)
        for above, unit, factor in (
            (5e5, "nanoseconds", "1e-9"),
            (5e2, "microseconds", "1e-6"),
            (0.0, "milliseconds", "1e-3"),
        )
        if step > above
    )
    raise FlightError(
        f"{name}: imu: stamps are {step:g} apart (median): expected seconds, at most "
        f"{_SLOWEST_STEP_S:g} s apart; they look like {unit} (multiply by {factor})"
    )


def _check_units(name: str, imu: ImuLog) -> None:
    """Refuse specific force in g or with z up, and rates in degrees."""
    force = float(np.median(np.linalg.norm(imu.accel, axis=1)))
    if 0.5 < force < 2.0:
        raise FlightError(
            f"{name}: imu: specific force has a median of {force:.2f}: expected about 9.8 m/s^2; "
            "it looks like g (multiply by 9.80665)"
        )
    if not 5.0 < force < 20.0:
        raise FlightError(
            f"{name}: imu: specific force has a median of {force:.3g}: expected about 9.8 m/s^2"
        )
    if float(np.median(imu.accel[:, 2])) > 5.0:
        raise FlightError(
            f"{name}: imu: az has a median of {np.median(imu.accel[:, 2]):+.2f} m/s^2: expected "
            "about -9.8 (body forward-right-down); it looks like z up (negate y and z)"
        )
    high = float(np.percentile(np.linalg.norm(imu.gyro, axis=1), 95))
    swing = _median_swing(imu)
    if high > 8.0 or swing > 2.0:
        raise FlightError(
            f"{name}: imu: angular rates (95 % below {high:.3g}, turning {swing:.2g} within 2 s) "
            "are beyond any survey flight in rad/s: they look like deg/s (multiply by pi/180)"
        )


def _median_swing(imu: ImuLog) -> float:
    """Return the median over spans of 2 s of how far roll and pitch rates swing, integrated."""
    angle = np.zeros((len(imu.t_s), 2))
    angle[1:] = np.cumsum(
        0.5 * (imu.gyro[1:, :2] + imu.gyro[:-1, :2]) * np.diff(imu.t_s)[:, None], axis=0
    )
    cuts = np.searchsorted(imu.t_s, np.arange(imu.t_s[0], imu.t_s[-1], 2.0))[:-1]
    if len(cuts) < 3:
        return 0.0
    swings = np.maximum.reduceat(angle, cuts) - np.minimum.reduceat(angle, cuts)
    return float(np.median(swings.max(axis=1)))


def _gnss(log: SensorLog, notes: list[str]) -> GnssLog:
    """Check that there are fixes, and bring them in order."""
    gnss = log.gnss
    if gnss is None or not np.isfinite(gnss.position).all(axis=1).any():
        missing = "; ".join(log.extra.get("missing", ()))
        raise FlightError(
            f"{log.name}: no GNSS position: a trajectory needs fixes to be tied to the ground, "
            f"expected at least one, got {'no GNSS log' if gnss is None else 'none'}"
            + (f" (missing: {missing})" if missing else "")
        )
    keep = np.isfinite(gnss.t_s) & (np.isfinite(gnss.position) | np.isfinite(gnss.velocity)).any(1)
    order, out_of_order, repeated = _in_order(gnss.t_s, keep)
    _note_order("gnss", int((~keep).sum()), out_of_order, repeated, notes)
    for numbers, what in ((gnss.position, "position"), (gnss.velocity, "velocity")):
        lacking = ~np.isfinite(numbers[order]).all(axis=1)
        # a receiver without velocities at all is no flaw
        if 0 < int(lacking.sum()) < len(order):
            notes.append(
                f"gnss: {int(lacking.sum())} of {len(order)} fixes lack a finite {what}: only "
                "what else they hold was used"
            )
    _check_origin(log, gnss.position[order], notes)

    def take(values: Array | None) -> Array | None:
        return None if values is None else values[order]

    for values, what in ((gnss.position_std, "position"), (gnss.velocity_std, "velocity")):
        if values is not None and not (np.nan_to_num(values[order], nan=-1.0) > 0.0).all():
            raise FlightError(f"{log.name}: gnss: {what} std must be positive throughout")
    return GnssLog(
        gnss.t_s[order],
        gnss.position[order],
        gnss.velocity[order],
        take(gnss.position_std),
        take(gnss.velocity_std),
    )


def _check_origin(log: SensorLog, position: Array, notes: list[str]) -> None:
    """Refuse an origin so far off that the local frame is not level at the fixes."""
    there = position[np.isfinite(position).all(axis=1)]
    if log.origin is None or not len(there):
        return
    place = np.median(there, axis=0)
    km = float(np.linalg.norm(place)) / 1000.0
    if km <= _FAR_ORIGIN_KM:
        return
    lat, lon, _ = (float(v) for v in geodetic_from_ned(place, log.origin))
    said = (
        f"the origin ({log.origin.lat_deg:.5f} N {log.origin.lon_deg:.5f} E) is {km:.1f} km from "
        f"the GNSS fixes (about {lat:.5f} N {lon:.5f} E)"
    )
    if km > _FARTHEST_ORIGIN_KM:
        raise FlightError(
            f"{log.name}: {said}: expected one within {_FARTHEST_ORIGIN_KM:g} km; correct "
            "origin_lat_deg and origin_lon_deg or leave them out"
        )
    notes.append(f"gnss: {said}: the local frame is not quite level there")


def _baro(log: SensorLog, baro: BaroLog, notes: list[str]) -> BaroLog | None:
    """Bring heights in order."""
    keep = np.isfinite(baro.t_s) & np.isfinite(baro.height_m)
    order, out_of_order, repeated = _in_order(baro.t_s, keep)
    _note_order("baro", int((~keep).sum()), out_of_order, repeated, notes)
    if not len(order):
        return None
    return BaroLog(baro.t_s[order], baro.height_m[order])


def _in_order(t: Array, keep: NDArray[np.bool_]) -> tuple[NDArray[np.intp], int, int]:
    """Return the samples to keep in order of time, how many came late, how many repeat a stamp."""
    index = np.flatnonzero(keep)
    order = index[np.argsort(t[index], kind="stable")]
    late = int((np.diff(t[index]) < 0.0).sum())
    fresh = np.concatenate([[True], np.diff(t[order]) > 0.0]) if len(order) else keep[:0]
    return order[fresh], late, int((~fresh).sum())


def _note_order(sensor: str, bad: int, late: int, repeated: int, notes: list[str]) -> None:
    """Say what was repaired."""
    for count, what in (
        (bad, "measurements without a finite number were left out"),
        (late, "measurements out of order were sorted in"),
        (repeated, "measurements with a repeated stamp were left out"),
    ):
        if count:
            notes.append(f"{sensor}: {count} {what}")
