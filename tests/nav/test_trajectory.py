"""Trajectories: pose and covariance at any time, through lever arm and boresight, to files."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from hsvaos.camera import Camera
from hsvaos.flight import Flight, FlightError, Frame, Origin
from hsvaos.formats.sensor_csv import write_csv_log
from hsvaos.formats.trajectory_csv import write_poses, write_trajectory
from hsvaos.nav import attitude
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.estimate import estimate_trajectory
from hsvaos.nav.log import Mounting
from hsvaos.nav.paper_ekf import PaperEkf
from hsvaos.nav.photos import poses_at_photos
from hsvaos.nav.smoother import smooth
from hsvaos.nav.trajectory import trajectory_of
from tests.nav.models import BARO, GNSS, IMU

MOUNTING = Mounting(
    body_from_camera_q=attitude.multiply(
        attitude.from_euler(0.05, -0.1, 0.0), Mounting().body_from_camera_q
    ),
    camera_lever_arm=np.array([0.1, 0.02, 0.05]),
    antenna_lever_arm=np.array([0.0, 0.0, -0.2]),
)


@pytest.fixture(scope="module")
def log(simulated):
    return simulated(1, mounting=MOUNTING)


@pytest.fixture(scope="module")
def trajectory(log, start):
    states = smooth(ErrorStateEkf(IMU, GNSS, BARO).run(log, start(1)))
    return trajectory_of(states, log)


def test_runs_at_the_rate_of_the_imu_through_the_states(trajectory, log):
    assert len(trajectory.t_s) == len(log.imu.t_s) == trajectory.imu_samples
    states = trajectory.states
    position, velocity, q = trajectory.at(states.t_s)
    np.testing.assert_allclose(position, states.position, atol=1e-3)
    np.testing.assert_allclose(velocity, states.velocity, atol=5e-3)
    turn = attitude.log(attitude.multiply(attitude.conjugate(q), states.quaternion))
    np.testing.assert_allclose(turn, 0.0, atol=1e-3)


def test_is_close_to_the_truth_between_samples(trajectory, short_mission):
    motion, photos = short_mission
    t = photos + 0.0013
    position, velocity, q = trajectory.at(t)
    true_position, true_velocity, true_q = motion.at(t)
    assert np.linalg.norm((position - true_position)[:, :2], axis=1).max() < 0.4
    assert abs(velocity - true_velocity).max() < 0.1
    turn = attitude.log(attitude.multiply(q, attitude.conjugate(true_q)))
    assert np.degrees(abs(turn[:, :2])).max() < 0.3


def test_times_outside_are_refused(trajectory):
    with pytest.raises(ValueError, match=r"within the trajectory \(0\.000 s to 53\.9"):
        trajectory.at([10.0, 1e4])


def test_camera_pose_goes_through_lever_arm_and_boresight(trajectory):
    t = np.array([12.3, 30.0])
    body = trajectory.world_from_body(t)
    camera = np.eye(4)
    camera[:3, :3] = attitude.matrix(MOUNTING.body_from_camera_q)
    camera[:3, 3] = MOUNTING.camera_lever_arm
    np.testing.assert_allclose(trajectory.world_from_camera(t), body @ camera, atol=1e-12)
    # looks down: the third column of the rotation is mostly world down
    assert (trajectory.world_from_camera(t)[:, 2, 2] > 0.95).all()


def test_default_mounting_looks_down_with_its_top_forward():
    R = attitude.matrix(Mounting().body_from_camera_q)
    np.testing.assert_allclose(R @ [0, 0, 1], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(R @ [0, -1, 0], [1, 0, 0], atol=1e-12)


def test_camera_covariance_equals_sampling(trajectory):
    t = 25.0
    long = replace(trajectory, mounting=replace(MOUNTING, camera_lever_arm=np.array([5.0, 0, 1])))
    C = long.covariance(t)
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(6), C, 20000)
    q = long.at(t)[2]
    arm = attitude.rotate(q, long.mounting.camera_lever_arm)
    shift = draws[:, :3] + attitude.rotate(attitude.exp(draws[:, 3:]), arm) - arm
    sampled = np.cov(np.concatenate([shift, draws[:, 3:]], axis=1).T)
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(long.camera_covariance(t))), np.sqrt(np.diagonal(sampled)), rtol=0.03
    )
    np.testing.assert_allclose(long.camera_covariance(t), sampled, atol=0.05 * C[:3, :3].max())


def test_euler_spread_equals_sampling(trajectory):
    t = np.array([25.0])
    states = trajectory.states
    turned = attitude.from_euler(0.2, 0.6, 2.0)
    leaning = replace(trajectory, quaternion=np.tile(turned, (len(trajectory.t_s), 1)))
    C = leaning.covariance(t)[0, 3:, 3:]
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), C, 20000)
    euler = attitude.to_euler(attitude.multiply(attitude.exp(draws), turned))
    np.testing.assert_allclose(leaning.euler_std(t)[0], euler.std(axis=0), rtol=0.03)
    assert states.smoothed


def test_covariance_is_positive_everywhere(trajectory):
    C = trajectory.camera_covariance(np.linspace(*trajectory.span, 500))
    assert np.linalg.eigvalsh(C).min() > 0.0


def test_the_papers_filter_makes_a_trajectory_too(log, start, short_mission):
    motion, photos = short_mission
    track = trajectory_of(PaperEkf(IMU, GNSS, BARO).run(log, start(1)), log)
    error = (track.at(photos)[0] - motion.at(photos)[0])[5:]
    assert np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))) < 0.5
    sigma = np.sqrt(np.diagonal(track.covariance(photos), axis1=1, axis2=2))
    assert (sigma > 0.0).all()
    assert (sigma[-1, :2] < 0.5).all()


def test_files_hold_what_the_trajectory_says(trajectory, tmp_path):
    rows = write_trajectory(tmp_path / "sub" / "trajectory.csv", trajectory, rate_hz=10.0)
    with (tmp_path / "sub" / "trajectory.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == rows == 540
    row = table[200]
    position, velocity, q = trajectory.at(float(row["t_s"]))
    assert float(row["t_s"]) == pytest.approx(20.0)
    assert float(row["down_m"]) == pytest.approx(position[2], abs=1e-4)
    assert float(row["ve_m_s"]) == pytest.approx(velocity[1], abs=1e-4)
    assert abs(
        sum(float(row[n]) * v for n, v in zip(("qw", "qx", "qy", "qz"), q, strict=True))
    ) == pytest.approx(1.0)
    assert float(row["std_yaw_deg"]) == pytest.approx(
        np.degrees(trajectory.euler_std(20.0)[2]), abs=1e-4
    )
    write_poses(tmp_path / "poses.csv", trajectory, ["a.jpg", "b.jpg"], [10.0, 20.0])
    with (tmp_path / "poses.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["file"] for row in table] == ["a.jpg", "b.jpg"]
    pose = trajectory.world_from_camera(20.0)
    place = [float(table[1][name]) for name in ("north_m", "east_m", "down_m")]
    np.testing.assert_allclose(place, pose[:3, 3], atol=1e-4)
    q = np.array([float(table[1][name]) for name in ("qw", "qx", "qy", "qz")])
    np.testing.assert_allclose(attitude.matrix(q), pose[:3, :3], atol=1e-8)
    assert 0.0 < float(table[1]["std_turn_down_deg"]) < 5.0


def test_poses_at_photos_of_a_flight(log, short_mission, tmp_path):
    motion, photos = short_mission
    names = [f"{i:03d}.png" for i in range(len(photos))]
    log = log.replace(
        triggers=(*zip(names, photos.tolist(), strict=True),), origin=Origin(47.0, 8.0, 400.0)
    )
    files = {path.stem: path for path in write_csv_log(log, tmp_path)}
    frames = [Frame(name, tmp_path / name, None) for name in [*names, "later.png"]]
    flight = Flight(
        name="trial",
        camera=Camera.from_fov(64, 64, 60.0),
        frames=tuple(frames),
        origin=Origin(47.0, 8.0, 400.0),
        source=tmp_path,
        sensors={
            **files,
            "body_from_camera_q": MOUNTING.body_from_camera_q.tolist(),
            "camera_lever_arm_m": [0.1, 0.02, 0.05],
            "antenna_lever_arm_m": [0.0, 0.0, -0.2],
        },
    )
    posed = poses_at_photos(flight)
    assert posed.has_poses
    assert len(posed) == len(photos)  # the photo without trigger is left out, and said
    assert any("1 of 22 photos were left out" in note for note in posed.notes)
    position, _, q = motion.at(photos)
    camera = position + attitude.rotate(
        q, np.broadcast_to(MOUNTING.camera_lever_arm, position.shape)
    )
    error = np.linalg.norm((posed.poses[:, :3, 3] - camera)[:, :2], axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.25
    # gravity differs a little between the simulator (9.80665) and 47 N: the poses hold all the same
    assert abs(posed.poses[:, 2, 3] - camera[:, 2]).max() < 1.5


def test_a_flight_without_sensors_or_times_is_refused(tmp_path, log):
    frame = Frame("a.png", tmp_path / "a.png", None)
    bare = Flight("bare", Camera.from_fov(8, 8, 60.0), (frame,), source=tmp_path)
    with pytest.raises(FlightError, match="the flight has no sensor log"):
        poses_at_photos(bare)
    files = {path.stem: path for path in write_csv_log(log, tmp_path)}
    with pytest.raises(FlightError, match="no photo lies within the sensor log"):
        poses_at_photos(bare.replace(sensors=files))


def test_names_are_public_and_a_wrong_name_is_refused(log):
    import hsvaos

    assert hsvaos.estimate_trajectory is estimate_trajectory
    assert hsvaos.Trajectory.__name__ == "Trajectory"
    assert hsvaos.PaperEkf is PaperEkf
    assert hsvaos.ErrorStateEkf is ErrorStateEkf
    assert hsvaos.smooth is smooth
    with pytest.raises(ValueError, match="filter must be one of error-state, paper, got 'ukf'"):
        estimate_trajectory(log, filter="ukf")
    with pytest.raises(ValueError, match=r"imu must be one of .*got 'best'"):
        estimate_trajectory(log, imu="best")


def test_an_estimate_that_lost_the_fixes_is_refused(log):
    presets = {"imu": "adis16448", "gnss": "sbas", "gnss_latency_s": 0.0}
    spike = log.imu.accel.copy()
    spike[2500] = 1e6
    good = estimate_trajectory(log.replace(imu=replace(log.imu, accel=spike)), **presets)
    assert any("1 samples above 320" in note for note in good.notes)
    assert abs(good.position).max() < 60.0
    # push after push, each within what an IMU can measure
    pushed = log.imu.accel.copy()
    pushed[300:, 0] += np.where(np.arange(len(pushed) - 300) % 40 < 10, 250.0, 0.0)
    with pytest.raises(FlightError, match=r"the estimate is lost: expected most GNSS.* got \d+ of"):
        estimate_trajectory(
            log.replace(imu=replace(log.imu, accel=pushed)), smooth=False, **presets
        )


def test_imu_samples_are_counted_without_the_epochs_between(log, start):
    every = slice(None, None, 7)
    slow = replace(
        log.imu, t_s=log.imu.t_s[every], gyro=log.imu.gyro[every], accel=log.imu.accel[every]
    )
    sparse = log.replace(imu=slow)
    sparse = trajectory_of(ErrorStateEkf(IMU, GNSS, BARO).run(sparse, start(1)), sparse)
    assert sparse.imu_samples == len(slow.t_s)
    assert len(sparse.t_s) > 1.3 * len(slow.t_s)
