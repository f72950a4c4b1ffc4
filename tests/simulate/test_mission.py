from __future__ import annotations

import numpy as np
import pytest

from hsvaos.nav import attitude
from hsvaos.simulate.mission import Mission, fly
from hsvaos.simulate.sensors import log_flight
from hsvaos.simulate.settings import SensorSettings
from hsvaos.simulate.simulation import MOUNTING
from hsvaos.simulate.vehicle import GRAVITY, STEP_S, Airframe, Quadrotor, Wind


def test_the_papers_mission_has_nine_strips_of_thirteen_photos() -> None:
    mission = Mission()
    assert (mission.strips, mission.per_strip, mission.photos) == (9, 13, 117)
    places = mission.places()
    assert places.shape == (117, 3)
    assert np.ptp(places[:, 1]) == 64.0
    assert np.ptp(places[:, 0]) == 60.0
    steps = np.linalg.norm(np.diff(places[:13], axis=0), axis=1)
    np.testing.assert_allclose(steps, 5.0)
    assert (places[:, 2] == -20.0).all()


@pytest.mark.parametrize("photos", [1, 2, 7, 30, 64])
def test_short_flights_have_exactly_the_photos_asked(photos: int) -> None:
    mission = Mission(photos=photos)
    assert len(mission.places()) == photos
    assert len(np.unique(mission.places(), axis=0)) == photos


def test_the_vehicle_passes_every_place_level_and_at_speed() -> None:
    mission = Mission(photos=8)
    flown = fly(mission, 1)
    position, velocity, q = flown.motion.at(flown.triggers_s)
    assert (np.diff(flown.triggers_s) > 0.5).all()
    error = position - mission.places()
    assert np.abs(error[:, 0]).max() < 0.01
    assert np.abs(error[:, 1:]).max() < 0.4
    assert np.linalg.norm(velocity, axis=1) == pytest.approx(5.0, abs=0.8)
    roll, pitch, _ = np.degrees(attitude.to_euler(q)).T
    assert np.abs(np.concatenate([roll, pitch])).max() < 20.0
    assert roll.std() > 0.05


def test_the_logged_motion_integrates_to_itself() -> None:
    motion = fly(Mission(photos=4), 2).motion
    q = motion.quaternion[0]
    v = motion.velocity[0].copy()
    for k in range(2000):
        rate = 0.5 * (motion.angular_rate[k] + motion.angular_rate[k + 1])
        force = 0.5 * (motion.specific_force[k] + motion.specific_force[k + 1])
        middle = attitude.multiply(q, attitude.exp(0.5 * rate * STEP_S))
        v += STEP_S * (attitude.rotate(middle, force) + np.array([0.0, 0.0, GRAVITY]))
        q = attitude.multiply(q, attitude.exp(rate * STEP_S))
    # Second-order differences: after ten seconds centimetres a second and hundredths of a degree.
    assert np.abs(v - motion.velocity[2000]).max() < 0.02
    turn = attitude.log(attitude.multiply(attitude.conjugate(q), motion.quaternion[2000]))
    assert np.degrees(np.linalg.norm(turn)) < 0.05


def test_hovering_in_still_air_stays_put_and_level() -> None:
    vehicle = Quadrotor(Airframe(), np.array([1.0, 2.0, -20.0]))
    for _ in range(400):
        vehicle.step(np.array([1.0, 2.0, -20.0]), np.zeros(3), 0.0, np.zeros(3))
    np.testing.assert_allclose(vehicle.position, [1.0, 2.0, -20.0], atol=1e-6)
    np.testing.assert_allclose(np.abs(vehicle.quaternion), [1, 0, 0, 0], atol=1e-9)


def test_it_leans_into_the_wind() -> None:
    vehicle = Quadrotor(Airframe(), np.zeros(3))
    for _ in range(3000):
        vehicle.step(np.zeros(3), np.zeros(3), 0.0, np.array([0.0, 3.0, 0.0]))
    np.testing.assert_allclose(vehicle.position, 0.0, atol=0.05)
    roll = attitude.to_euler(vehicle.quaternion)[0]
    build = Airframe()
    # A wind toward the east is held by rolling left: tan(roll) = drag / weight.
    assert np.tan(roll) == pytest.approx(-build.drag * 3.0 / build.mass / GRAVITY, rel=0.02)


def test_the_same_seed_flies_the_same_flight() -> None:
    first, again = fly(Mission(photos=3), 4), fly(Mission(photos=3), 4)
    np.testing.assert_array_equal(first.motion.position, again.motion.position)
    np.testing.assert_array_equal(first.triggers_s, again.triggers_s)
    assert not np.array_equal(fly(Mission(photos=3), 5).triggers_s, first.triggers_s)


def test_a_storm_is_refused() -> None:
    with pytest.raises(ValueError, match="carries the vehicle away"):
        fly(Mission(photos=2, wind=Wind((30.0, 0.0, 0.0))), 0)


@pytest.mark.parametrize(
    "change",
    [
        {"photos": 0},
        {"photos": 2.5},
        {"height_m": -20.0},
        {"speed_m_s": 0.0},
        {"speed_m_s": 40.0},
        {"photo_distance_m": float("nan")},
    ],
)
def test_bad_missions_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        Mission(**change)  # type: ignore[arg-type]


def test_faults_of_the_receiver_are_in_the_log() -> None:
    flown = fly(Mission(photos=4), 3)
    plain = log_flight(SensorSettings(), flown, 3, MOUNTING)
    faulty = log_flight(
        SensorSettings(gnss_latency_s=0.2, gnss_outages_s=((8.0, 12.0),), gnss_outlier_share=0.1),
        flown,
        3,
        MOUNTING,
    )
    assert plain.gnss is not None
    assert faulty.gnss is not None
    t = faulty.gnss.t_s
    assert not ((t - 0.2 >= 8.0) & (t - 0.2 < 12.0)).any()
    assert ((plain.gnss.t_s >= 8.0) & (plain.gnss.t_s < 12.0)).sum() == 40
    truth, _, _ = flown.motion.at(t - 0.2)
    off = np.linalg.norm(faulty.gnss.position - truth, axis=1)
    assert (off > 9.0).sum() >= 2
    assert np.median(off) < 3.5
    np.testing.assert_array_equal(plain.imu.gyro, faulty.imu.gyro)


@pytest.mark.parametrize(
    "change",
    [
        {"imu": "none"},
        {"gnss": "x"},
        {"gnss_latency_s": -1.0},
        {"gnss_outlier_share": 2.0},
        {"gnss_outages_s": ((5.0, 4.0),)},
        {"gnss_outlier_m": -1.0},
    ],
)
def test_bad_sensors_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"imu|gnss|outage"):
        SensorSettings(**change)  # type: ignore[arg-type]
