"""Whole flights: what is written, that it is the same again, and what happens when it breaks."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.flight import FlightError
from hsvaos.simulate import record
from hsvaos.simulate.clothes import OUTFITS
from hsvaos.simulate.instances import Kind
from hsvaos.simulate.occlusion import CLASSES, label
from hsvaos.simulate.people import pose_library
from hsvaos.simulate.record import preview, simulate_flight
from hsvaos.simulate.simulation import Simulation
from tests.simulate.conftest import small_settings


@pytest.fixture(scope="module")
def folder(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("simulated") / "flight"
    told: list[tuple[int, int]] = []
    simulate_flight(
        small_settings(),
        target,
        simulation=simulation,
        progress=lambda done, total: told.append((done, total)),
    )
    assert told[0] == (0, 6)
    assert told[-1] == (6, 6)
    return target


def test_the_flight_is_a_native_flight_with_true_poses(
    folder: Path, simulation: Simulation
) -> None:
    flight = hsvaos.open_flight(folder)
    assert len(flight) == 6
    assert flight.camera == simulation.camera
    np.testing.assert_allclose(flight.poses, simulation.poses, atol=1e-5)
    assert set(flight.sensors) >= {"imu", "gnss", "baro", "triggers", "camera_lever_arm_m"}
    image = next(iter(flight.images()))
    assert image.shape == (256, 256, 3)
    # What the JPEG holds is the photo that was taken.
    taken = simulation.photo(0).image.astype(float)
    assert np.abs(image.astype(float) - taken).mean() < 6.0
    assert not list(folder.parent.glob(".*simulating*"))


def test_truth_is_measured_and_meets_the_classes_asked(
    folder: Path, simulation: Simulation
) -> None:
    truth = json.loads((folder / "truth.json").read_text())
    assert [p["asked"] for p in truth["people"]] == ["half", "full"]
    for k, person in enumerate(truth["people"]):
        low, high = CLASSES[person["asked"]]
        assert low <= person["visible_fraction_mean"] <= high
        assert person["occlusion"] == label(person["visible_fraction_mean"], False)
        assert person["clothes"] in OUTFITS
        shares = [
            shown / alone
            for shown, alone in (p[k] for p in truth["pixels"]["by_photo"])
            if alone >= 12
        ]
        assert person["visible_fraction_mean"] == pytest.approx(np.mean(shares), abs=1e-4)
        outline = np.array(person["outline_ned_m"])
        assert outline.shape[1] == 3
        assert np.abs(outline[:, :2].mean(0) - [person["north_m"], person["east_m"]]).max() < 0.5
    assert len(truth["stakes"]) == 3
    # The ids of the pictures themselves agree with the counts.
    photo = simulation.photo(2)
    assert (photo.kind == int(Kind.PERSON)).sum() == sum(shown for shown, _ in photo.people)
    assert photo.people == [tuple(p) for p in truth["pixels"]["by_photo"][2]]


def test_logs_have_the_columns_of_the_format_and_start_at_rest(folder: Path) -> None:
    imu = np.genfromtxt(folder / "imu.csv", delimiter=",", names=True)
    assert imu.dtype.names == (
        "t_s",
        "gx_rad_s",
        "gy_rad_s",
        "gz_rad_s",
        "ax_m_s2",
        "ay_m_s2",
        "az_m_s2",
    )
    assert imu["az_m_s2"][:100].mean() == pytest.approx(-9.8, abs=0.8)
    gnss = np.genfromtxt(folder / "gnss.csv", delimiter=",", names=True)
    assert gnss["lat_deg"][0] == pytest.approx(47.5, abs=0.01)
    assert gnss["alt_m"].mean() == pytest.approx(720.0, abs=3.0)
    assert (folder / "triggers.csv").read_text().splitlines()[1].startswith("photo_000.jpg,")


def test_the_filters_poses_come_with_the_flight(folder: Path, simulation: Simulation) -> None:
    estimated = hsvaos.open_flight(folder, poses=folder / "poses_ekf.csv")
    off = np.linalg.norm(estimated.poses[:, :3, 3] - simulation.poses[:, :3, 3], axis=1)
    assert 1e-4 < off.max() < 1.0


def test_the_true_terrain_is_a_focal_surface(folder: Path, simulation: Simulation) -> None:
    terrain = hsvaos.FocalTerrain.from_file(folder / "truth_terrain.npz")
    node = round((3.0 - terrain.north0_m) / terrain.spacing_m)
    column = round((-2.0 - terrain.east0_m) / terrain.spacing_m)
    north = terrain.north0_m + node * terrain.spacing_m
    east = terrain.east0_m + column * terrain.spacing_m
    have = float(terrain.down_m[node, column])
    assert have == pytest.approx(float(simulation.forest.ground.down_at(north, east)), abs=1e-4)


def test_the_same_seed_is_bit_identical(simulation: Simulation) -> None:
    again = Simulation(small_settings())
    assert again.names() == simulation.names()
    np.testing.assert_array_equal(again.poses, simulation.poses)
    for index in (4, 1):
        first, second = simulation.photo(index), again.photo(index)
        np.testing.assert_array_equal(first.image, second.image)
        np.testing.assert_array_equal(first.kind, second.kind)
        assert first.people == second.people
    for name, table in simulation.tables().items():
        for column, values in table.items():
            np.testing.assert_array_equal(values, again.tables()[name][column])


def test_a_stopped_flight_continues(
    simulation: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "flight"
    taken: list[int] = []
    honest = Simulation.photo

    def stops(self: Simulation, index: int) -> object:
        if len(taken) >= 2:
            raise KeyboardInterrupt
        taken.append(index)
        return honest(self, index)

    monkeypatch.setattr(Simulation, "photo", stops)
    with pytest.raises(KeyboardInterrupt):
        simulate_flight(small_settings(), target, simulation=simulation)
    assert not target.exists()
    workshop = tmp_path / ".flight.simulating"
    kept = sorted(p.name for p in workshop.glob("photo_*.jpg"))
    assert len(kept) == 2
    assert not list(workshop.glob("*.part"))
    before = {name: (workshop / name).read_bytes() for name in kept}
    again: list[int] = []

    def counts(self: Simulation, index: int) -> object:
        again.append(index)
        return honest(self, index)

    monkeypatch.setattr(Simulation, "photo", counts)
    simulate_flight(small_settings(), target, simulation=simulation)
    assert sorted(taken + again) == list(range(6))
    for name, data in before.items():
        assert (target / "images" / name).read_bytes() == data
    assert len(json.loads((target / "truth.json").read_text())["pixels"]["by_photo"]) == 6
    assert not workshop.exists()


def test_a_full_disk_is_told_and_leaves_only_whole_files(
    simulation: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = Path.write_bytes
    written: list[str] = []

    def full(self: Path, data: bytes) -> int:
        if "photo_" in self.name and len(written) >= 3:
            honest(self, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(self.name)
        return honest(self, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(FlightError, match=r"No space left on device.*same command continues"):
        simulate_flight(small_settings(), tmp_path / "flight", simulation=simulation)
    monkeypatch.undo()
    workshop = tmp_path / ".flight.simulating"
    assert not list(workshop.glob("*.part"))
    for path in workshop.glob("photo_*.jpg"):
        assert cv2.imread(str(path)).shape == (256, 256, 3)
    simulate_flight(small_settings(), tmp_path / "flight", simulation=simulation)
    assert len(hsvaos.open_flight(tmp_path / "flight")) == 6


def test_other_settings_do_not_continue_a_flight(simulation: Simulation, tmp_path: Path) -> None:
    record._open_workshop(tmp_path / ".flight.simulating", small_settings(people=1))
    with pytest.raises(FlightError, match="other settings"):
        simulate_flight(small_settings(), tmp_path / "flight", simulation=simulation)


def test_a_folder_in_use_is_left_alone(simulation: Simulation, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FlightError, match="new or empty"):
        simulate_flight(small_settings(), tmp_path, simulation=simulation)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_the_preview_marks_the_people(simulation: Simulation) -> None:
    index = int(
        np.argmin(
            np.linalg.norm(simulation.poses[:, :2, 3] - simulation.cast.people[0].place[:2], axis=1)
        )
    )
    drawn = preview(simulation, index)
    plain = simulation.photo(index).image
    changed = (drawn != plain).any(axis=2)
    assert 20 < changed.sum() < 0.2 * changed.size


def test_thermal_flights_are_grey_and_people_are_warm(simulation: Simulation) -> None:
    thermal = Simulation(small_settings(thermal=True, classes=("open", "half")))
    seen = [thermal.photo(k) for k in range(len(thermal.poses))]
    assert seen[0].image.ndim == 2
    warm = np.concatenate([p.image[p.kind == int(Kind.PERSON)] for p in seen])
    rest = np.concatenate([p.image[p.kind != int(Kind.PERSON)] for p in seen])
    assert np.median(warm) > np.quantile(rest, 0.9)


def test_the_filters_poses_are_near_the_true_ones(simulation: Simulation) -> None:
    from hsvaos.simulate.estimate import estimated_poses

    poses = estimated_poses(
        simulation.log, simulation.settings.sensors, simulation.flown.triggers_s
    )
    off = np.linalg.norm(poses[:, :3, 3] - simulation.poses[:, :3, 3], axis=1)
    # White receiver noise of 1 m, and a flight of under a minute.
    assert off.max() < 1.0
    down = (poses[:, :3, 2] * simulation.poses[:, :3, 2]).sum(axis=1)
    assert np.degrees(np.arccos(down)).max() < 1.0


def test_the_pose_library_is_of_people_who_lie() -> None:
    places, quaternions = pose_library()
    assert len(places) >= 40
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=2), 1.0, atol=1e-5)
    assert places[:, :, 2].max() < 0.75
    assert places[:, :, 2].min() > -0.2
    flat = places - places.mean(axis=1, keepdims=True)
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=3).mean(axis=2)
    assert (apart + np.eye(len(places)) > 0.02).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"people": -1}, "people"),
        ({"people": 2.5}, "people"),
        ({"stakes": 1000}, "stakes"),
        ({"jpeg_quality": 101}, "jpeg_quality"),
        ({"classes": ("hidden",)}, "classes must be among full, half, bush, open"),
        ({"clothes": ("tartan",)}, "clothes must be one of"),
    ],
)
def test_bad_settings_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Simulation(small_settings(**change))


def test_a_class_that_cannot_be_had_is_named() -> None:
    from hsvaos.simulate.forest import ForestSettings

    bare = ForestSettings(seed=5, density=0.0, bushes=0.0)
    with pytest.raises(ValueError, match="class 'full' was not reached"):
        Simulation(small_settings(forest=bare, classes=("full",), people=1))


def test_people_lie_where_they_are_told_to() -> None:
    places = ((3.0, -2.0), (-1.5, 4.0))
    told = Simulation(small_settings(places=places, classes=None))
    for person, place in zip(told.cast.people, places, strict=True):
        np.testing.assert_allclose(person.place[:2], place)
    with pytest.raises(ValueError, match="expected 2 places"):
        Simulation(small_settings(places=places[:1]))


def test_the_demo_flight_is_small_and_whole() -> None:
    demo = Path(hsvaos.__file__).parent / "data" / "demo_flight"
    assert sum(p.stat().st_size for p in demo.rglob("*") if p.is_file()) < 2_800_000
    flight = hsvaos.open_flight(demo)
    assert len(flight) == 30
    assert next(iter(flight.images())).shape == (512, 512, 3)
    truth = json.loads((demo / "truth.json").read_text())
    assert [p["occlusion"] for p in truth["people"]] == ["full", "half"]
    # Photos that look down on the hidden person: within 0.15 of the width of the centre.
    outline = np.array(truth["people"][0]["outline_ned_m"]).mean(axis=0)
    shown = []
    for pose, counts in zip(flight.poses, truth["pixels"]["by_photo"], strict=True):
        pixel = flight.camera.project((outline - pose[:3, 3]) @ pose[:3, :3])
        if np.abs(pixel - 255.5).max() < 0.15 * 512:
            shown.append(counts[0][0])
    assert len(shown) >= 3
    assert max(shown) == 0


def test_an_unknown_device_is_refused() -> None:
    with pytest.raises(ValueError, match="cuda:9"):
        Simulation(small_settings(), device="cuda:9")
