"""Bad input: each flaw is refused with its probable cause, or repaired and counted."""

from dataclasses import replace

import numpy as np
import pytest

from hsvaos.flight import FlightError, Origin
from hsvaos.geodesy import ned_from_llh
from hsvaos.nav.checks import check_log
from hsvaos.nav.log import GnssLog, ImuLog, Mounting


@pytest.fixture
def log(simulated):
    return simulated(0)


def imu(log, **changes):
    return log.replace(imu=replace(log.imu, **changes))


def test_a_good_log_passes_untouched(log):
    checked = check_log(log)
    assert checked.notes == ()
    np.testing.assert_array_equal(checked.imu.gyro, log.imu.gyro)
    np.testing.assert_array_equal(checked.gnss.position, log.gnss.position)


def test_time_running_backwards_is_refused(log):
    t = log.imu.t_s.copy()
    t[1000:] -= 2.0
    with pytest.raises(FlightError, match=r"time runs backwards at sample 1000 \(3\.0"):
        check_log(imu(log, t_s=t))


def test_a_short_gap_is_counted_and_a_long_one_refused(log):
    for length, refused in ((1.0, False), (6.0, True)):
        keep = (log.imu.t_s < 20.0) | (log.imu.t_s > 20.0 + length)
        cut = log.replace(imu=ImuLog(log.imu.t_s[keep], log.imu.gyro[keep], log.imu.accel[keep]))
        if refused:
            with pytest.raises(FlightError, match=r"a gap of 6\.0\d? s at 19\.9"):
                check_log(cut)
        else:
            assert "1 gaps above 0.3 s, the longest 1.0" in check_log(cut).notes[0]


def test_a_few_nans_are_left_out_and_many_refused(log):
    gyro = log.imu.gyro.copy()
    gyro[100:103] = np.nan
    checked = check_log(imu(log, gyro=gyro))
    assert checked.notes == ("imu: 3 samples that are not finite numbers were left out",)
    assert np.isfinite(checked.imu.gyro).all()
    gyro[: len(gyro) // 5] = np.nan
    with pytest.raises(FlightError, match="are not finite numbers"):
        check_log(imu(log, gyro=gyro))


def test_repeated_stamps_are_left_out_and_counted(log):
    t = log.imu.t_s.copy()
    t[500] = t[499]
    checked = check_log(imu(log, t_s=t))
    assert checked.notes == ("imu: 1 samples with a repeated stamp were left out",)
    assert (np.diff(checked.imu.t_s) > 0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda i: {"accel": i.accel / 9.80665}, r"looks like g \(multiply by 9\.80665\)"),
        (lambda i: {"gyro": np.degrees(i.gyro) * 20.0}, "look like deg/s"),
        (lambda i: {"accel": -i.accel}, "looks like z up"),
        (lambda i: {"accel": i.accel * 100.0}, r"expected about 9\.8 m/s\^2"),
    ],
)
def test_wrong_units_are_refused_with_the_probable_cause(log, change, message):
    with pytest.raises(FlightError, match=message):
        check_log(imu(log, **change(log.imu)))


def test_degrees_per_second_of_a_gentle_flight_are_noticed(log):
    with pytest.raises(FlightError, match="look like deg/s"):
        check_log(imu(log, gyro=np.degrees(log.imu.gyro)))


def test_no_gnss_at_all(log):
    with pytest.raises(FlightError, match=r"no GNSS position.*got no GNSS log"):
        check_log(log.replace(gnss=None))
    empty = GnssLog(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(FlightError, match=r"no GNSS position.*got none"):
        check_log(log.replace(gnss=empty))


def test_missing_messages_are_named(log):
    with pytest.raises(FlightError, match=r"missing: vehicle_gps_position"):
        check_log(log.replace(gnss=None, extra={"missing": ("vehicle_gps_position",)}))


def test_a_log_of_two_samples(log):
    two = ImuLog(log.imu.t_s[:2], log.imu.gyro[:2], log.imu.accel[:2])
    with pytest.raises(FlightError, match="expected at least 50 samples, got 2"):
        check_log(log.replace(imu=two))


def test_a_quaternion_not_of_unit_length(log):
    wrong = Mounting(body_from_camera_q=np.array([1.0, 1.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match=r"unit length, got length 1\.41"):
        check_log(log.replace(mounting=wrong))


def test_lever_arms_must_be_metres(log):
    wrong = Mounting(antenna_lever_arm=np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(FlightError, match="antenna_lever_arm_m must be 3 finite metres"):
        check_log(log.replace(mounting=wrong))


def test_clocks_that_do_not_meet(log):
    late = replace(log.gnss, t_s=log.gnss.t_s + 1e6)
    with pytest.raises(FlightError, match=r"no GNSS fix within the IMU log.*expected one clock"):
        check_log(log.replace(gnss=late))


def test_fixes_out_of_order_repeated_or_empty_are_put_right_and_counted(log):
    gnss = log.gnss
    order = np.arange(len(gnss.t_s))
    order[[10, 11]] = [11, 10]
    order[50] = 49
    position, velocity = gnss.position[order].copy(), gnss.velocity[order].copy()
    position[80], velocity[80] = np.nan, np.nan
    shuffled = GnssLog(gnss.t_s[order], position, velocity)
    checked = check_log(log.replace(gnss=shuffled))
    assert set(checked.notes) == {
        "gnss: 1 measurements without a finite number were left out",
        "gnss: 1 measurements out of order were sorted in",
        "gnss: 1 measurements with a repeated stamp were left out",
    }
    assert (np.diff(checked.gnss.t_s) > 0).all()


def test_noise_that_is_not_positive_is_refused(log):
    wrong = replace(log.gnss, position_std=np.zeros_like(log.gnss.position))
    with pytest.raises(FlightError, match="position std must be positive"):
        check_log(log.replace(gnss=wrong))


@pytest.mark.parametrize(("kind", "value"), [("accel", 1e6), ("accel", -400.0), ("gyro", 80.0)])
def test_spikes_beyond_any_imu_are_left_out_and_many_refused(log, kind, value):
    values = getattr(log.imu, kind).copy()
    values[1500] = value
    checked = check_log(imu(log, **{kind: values}))
    assert checked.notes == ("imu: 1 samples above 320 m/s^2 or 70 rad/s (spikes) were left out",)
    assert len(checked.imu.t_s) == len(log.imu.t_s) - 1
    assert np.linalg.norm(checked.imu.accel, axis=1).max() < 320.0
    values[: len(values) // 5] = value
    with pytest.raises(FlightError, match=r"samples are above 320 m/s\^2 or 70 rad/s|look like"):
        check_log(imu(log, **{kind: values}))


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
def test_stamps_not_in_seconds_are_named(log, factor, unit):
    with pytest.raises(FlightError, match=rf"expected seconds.*look like {unit}"):
        check_log(imu(log, t_s=log.imu.t_s * factor))


@pytest.mark.parametrize(("what", "other"), [("position", "velocity"), ("velocity", "position")])
def test_fixes_without_a_position_or_velocity_are_counted(log, what, other):
    values = getattr(log.gnss, what).copy()
    values[20:27] = np.nan
    checked = check_log(log.replace(gnss=replace(log.gnss, **{what: values})))
    count = len(log.gnss.t_s)
    assert checked.notes == (
        f"gnss: 7 of {count} fixes lack a finite {what}: only what else they hold was used",
    )
    assert len(getattr(checked.gnss, other)) == count


def test_a_receiver_without_velocities_is_no_flaw(log):
    none = replace(log.gnss, velocity=np.full_like(log.gnss.velocity, np.nan))
    assert check_log(log.replace(gnss=none)).notes == ()


def test_an_origin_far_from_the_fixes(log):
    far, near = Origin(10.0, 11.0, 400.0), Origin(48.09, 11.0, 400.0)
    shift = ned_from_llh((48.0, 11.0, 450.0), far)
    moved = replace(log.gnss, position=log.gnss.position + shift)
    with pytest.raises(
        FlightError, match=r"the origin \(10\.0.* is 4136\.\d km from .*about 4[78]\."
    ):
        check_log(log.replace(gnss=moved, origin=far))
    shift = ned_from_llh((48.0, 11.0, 450.0), near)
    moved = replace(log.gnss, position=log.gnss.position + shift)
    (note,) = check_log(log.replace(gnss=moved, origin=near)).notes
    assert "is 10.0 km from the GNSS fixes" in note
