"""Readers of sensor logs: CSV both ways, PX4 and ArduPilot logs as they come, and bad files."""

import numpy as np
import pytest

from hsvaos.flight import FlightError, Origin
from hsvaos.formats.sensor_csv import read_csv_folder, read_csv_log, write_csv_log
from hsvaos.formats.sensor_log import open_sensor_log
from hsvaos.nav.checks import check_log
from hsvaos.nav.estimate import estimate_trajectory


@pytest.fixture
def log(simulated):
    return simulated(0).replace(triggers=(("a b.jpg", 1.25), ("ü.jpg", 2.5)))


@pytest.mark.parametrize("origin", [None, Origin(47.1, 8.2, 431.0)])
def test_csv_there_and_back(log, tmp_path, origin):
    log = log.replace(origin=origin)
    write_csv_log(log, tmp_path / "log")
    files = {k: tmp_path / "log" / f"{k}.csv" for k in ("imu", "gnss", "baro", "triggers")}
    back = read_csv_log(files, origin=origin)
    np.testing.assert_allclose(back.imu.t_s, log.imu.t_s, atol=1e-6)
    np.testing.assert_allclose(back.imu.gyro, log.imu.gyro, rtol=1e-6)
    np.testing.assert_allclose(back.imu.accel, log.imu.accel, rtol=1e-6)
    np.testing.assert_allclose(back.gnss.position, log.gnss.position, atol=3e-4)
    np.testing.assert_allclose(back.gnss.velocity, log.gnss.velocity, atol=1e-4)
    np.testing.assert_allclose(back.gnss.position_std, log.gnss.position_std, atol=1e-4)
    np.testing.assert_allclose(back.gnss.velocity_std, log.gnss.velocity_std, atol=1e-4)
    np.testing.assert_allclose(back.baro.height_m, log.baro.height_m, atol=1e-4)
    assert back.triggers == log.triggers
    assert back.origin == origin


def test_a_flight_folder_by_its_nav_table(log, tmp_path):
    write_csv_log(log.replace(origin=Origin(47.1, 8.2, 431.0)), tmp_path / "sensors")
    (tmp_path / "flight.toml").write_text(
        """
        [flight]
        name = "over the wood"
        [world]
        origin_lat_deg = 47.1
        origin_lon_deg = 8.2
        origin_height_m = 431.0
        [nav]
        imu = "sensors/imu.csv"
        gnss = "sensors/gnss.csv"
        triggers = "sensors/triggers.csv"
        antenna_lever_arm_m = [0.1, 0.0, -0.3]
        """
    )
    opened = open_sensor_log(tmp_path)
    assert opened.name == "over the wood"
    assert opened.origin == Origin(47.1, 8.2, 431.0)
    assert opened.baro is None
    np.testing.assert_array_equal(opened.mounting.antenna_lever_arm, [0.1, 0.0, -0.3])
    np.testing.assert_allclose(opened.gnss.position, log.gnss.position, atol=3e-4)
    assert len(opened.triggers) == 2
    text = (tmp_path / "flight.toml").read_text()
    (tmp_path / "flight.toml").write_text(text + "body_from_camera_q = [1.0, 1.0, 0.0, 0.0]\n")
    with pytest.raises(FlightError, match=r"body_from_camera_q must be a quaternion of unit"):
        open_sensor_log(tmp_path)


def test_missing_cells_are_nan_and_zero_island_is_left_out(tmp_path):
    (tmp_path / "imu.csv").write_text(
        "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n0,0,0,0,0,0,-9.8\n1,0,,0,0,0,-9.8\n"
    )
    (tmp_path / "gnss.csv").write_text(
        "t_s,lat_deg,lon_deg,alt_m\n0,0,0,0\n1,47,8,400\n2,47.0001,8,400\n"
    )
    log = read_csv_folder(tmp_path)
    assert np.isnan(log.imu.gyro[1, 1])
    assert np.isnan(log.gnss.position[0]).all()
    np.testing.assert_allclose(log.gnss.position[1], 0.0, atol=1e-9)
    assert log.gnss.position[2, 0] == pytest.approx(11.117, abs=0.01)
    assert np.isnan(log.gnss.velocity).all()  # columns that are not there
    assert any("1 fixes at 0 N 0 E" in note for note in log.notes)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("imu.csv", "t_s,gx,gy\n0,0,0\n", r"imu\.csv: the columns gx_rad_s.* are missing"),
        ("imu.csv", "", r"imu\.csv: the columns .*got no heads"),
        ("gnss.csv", "t_s,x\n0,0\n", r"expected the columns lat_deg,lon_deg,alt_m or north_m"),
        ("gnss.csv", "t_s,lat_deg,lon_deg,alt_m\n0,4739,8,1\n", r"expected degrees"),
        ("baro.csv", "t_s,height_m\n0,abc\n", r"baro\.csv: expected numbers"),
        ("baro.csv", "t_s,height_m\n0\n", r"line 2 has 1 cells, expected 2"),
        ("triggers.csv", "name,t\na,0\n", r"expected the columns file,t_s"),
        ("triggers.csv", "file,t_s\na.jpg,soon\n", r"a row without file or seconds"),
    ],
)
def test_bad_csv_is_refused_in_one_line(log, tmp_path, name, text, message):
    write_csv_log(log, tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(FlightError, match=message) as caught:
        read_csv_folder(tmp_path)
    assert "\n" not in str(caught.value)


def test_what_is_no_log_is_refused(tmp_path):
    with pytest.raises(FlightError, match="no such file or folder"):
        open_sensor_log(tmp_path / "nothing")
    with pytest.raises(FlightError, match="a folder with neither"):
        open_sensor_log(tmp_path)
    (tmp_path / "x.bin").write_bytes(b"hello world")
    with pytest.raises(FlightError, match="expected a PX4 ULog or an ArduPilot DataFlash log"):
        open_sensor_log(tmp_path / "x.bin")
    # the one log of a folder is taken, so its own flaw is said
    with pytest.raises(FlightError, match=r"x\.bin: expected a PX4 ULog"):
        open_sensor_log(tmp_path)
    (tmp_path / "y.ULG").write_bytes(b"hello world")
    with pytest.raises(FlightError, match=r"neither; give a log file itself \(x\.bin, y\.ULG\)"):
        open_sensor_log(tmp_path)
    (tmp_path / "flight.toml").write_text("[flight]\nname = 'x'\n")
    with pytest.raises(FlightError, match=r"expected a \[nav\] table.*\(x\.bin, y\.ULG\)"):
        open_sensor_log(tmp_path)


def test_px4_log(logs):
    log = open_sensor_log(logs / "px4" / "sample.ulg")
    assert len(log.imu.t_s) == 17070
    assert np.diff(log.imu.t_s).mean() == pytest.approx(0.004, abs=1e-4)
    # at rest at first: FRD specific force is -g, rates are nothing
    rest = log.imu.t_s < 2.0
    assert np.linalg.norm(log.imu.accel[rest].mean(axis=0)) == pytest.approx(9.8, abs=0.15)
    assert log.imu.accel[rest, 2].mean() < -9.5
    assert np.abs(log.imu.gyro[rest].mean(axis=0)).max() < 0.01
    assert log.mag is not None
    assert log.gnss is None
    with pytest.raises(FlightError, match=r"missing: vehicle_gps_position or sensor_gps"):
        check_log(log)


def test_the_one_log_of_a_folder_is_taken(logs):
    log = open_sensor_log(logs / "px4")
    assert log.name == "sample.ulg"
    assert log.notes[0].startswith("sample.ulg: the one log in ")


def test_a_ulog_cut_short_or_broken_is_read_or_refused(logs, tmp_path):
    data = (logs / "px4" / "sample.ulg").read_bytes()
    broken = tmp_path / "broken.ulg"
    broken.write_bytes(data[:64])
    with pytest.raises(FlightError, match=r"broken\.ulg: "):
        open_sensor_log(broken)


def test_ardupilot_logs(logs):
    log = open_sensor_log(logs / "ardupilot" / "ardupilot_test.BIN")
    assert len(log.imu.t_s) == 45
    assert np.diff(log.imu.t_s).mean() == pytest.approx(0.04, abs=0.02)
    assert np.median(log.imu.accel[:, 2]) == pytest.approx(-9.8, abs=0.5)
    # first fix: 0.2 m/s toward 36.87 deg, 0.35 m/s down; HAcc 1.61, VAcc 2.41, SAcc 0.51
    np.testing.assert_allclose(log.gnss.velocity[0], [0.16, 0.12, 0.35], atol=1e-3)
    np.testing.assert_allclose(log.gnss.position_std[0], [1.61, 1.61, 2.41], atol=1e-6)
    assert log.gnss.velocity_std[0, 0] == pytest.approx(0.51)
    assert log.origin.lat_deg == pytest.approx(-35.3626277)
    with pytest.raises(FlightError, match="expected at least 50 samples, got 45"):
        check_log(log)


def test_an_old_ardupilot_log_has_its_own_clock_for_gps(logs):
    log = open_sensor_log(logs / "ardupilot" / "arducopter_log171" / "log171.bin")
    assert log.imu.t_s[-1] == pytest.approx(242.6, abs=1.0)
    assert log.gnss.t_s[0] == pytest.approx(33.7, abs=0.1)  # boot time, not time of week
    assert any("161 of 1199 messages without a 3-D fix" in note for note in log.notes)
    # the speed that the log states is the slope of its positions
    slope = np.gradient(log.gnss.position, log.gnss.t_s, axis=0)
    fast = np.linalg.norm(log.gnss.velocity[:, :2], axis=1) > 5.0
    error = slope[fast, :2] - log.gnss.velocity[fast, :2]
    assert np.median(np.linalg.norm(error, axis=1)) < 1.0
    # up is up: barometer and GNSS rise together
    flown = log.gnss.t_s < 220.0
    height = np.interp(log.gnss.t_s, log.baro.t_s, log.baro.height_m)
    assert np.corrcoef(height[flown], -log.gnss.position[flown, 2])[0, 1] > 0.95


def test_without_the_extra_the_message_names_it(logs, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pyulog", None)
    monkeypatch.setitem(sys.modules, "pymavlink.DFReader", None)
    for path in ("px4/sample.ulg", "ardupilot/ardupilot_test.BIN"):
        with pytest.raises(FlightError, match=r"pip install 'hsvaos\[logs\]'"):
            open_sensor_log(logs / path)


@pytest.mark.slow
def test_an_ardupilot_flight_agrees_with_its_own_estimate(logs):
    from pymavlink.DFReader import DFReader_binary

    path = logs / "ardupilot" / "arducopter_log171" / "log171.bin"
    log = open_sensor_log(path)
    flown = log.imu.t_s < 218.0  # it crashes after that
    cut = type(log.imu)(log.imu.t_s[flown], log.imu.gyro[flown], log.imu.accel[flown])
    trajectory = estimate_trajectory(log.replace(imu=cut))
    reader = DFReader_binary(str(path))
    rows = []
    while (message := reader.recv_match(type=["EKF1"])) is not None:
        rows.append([message.TimeMS, message.Roll, message.Pitch])
    reader.close()
    own = np.array(rows, dtype=float)
    t = own[:, 0] * 1e-3 - 11.46
    inside = (t > 75.0) & (t < 215.0)
    from hsvaos.nav import attitude

    euler = np.degrees(attitude.to_euler(trajectory.at(t[inside])[2]))[:, :2]
    difference = euler - own[inside, 1:]
    assert np.sqrt(np.mean(difference**2)) < 3.0
