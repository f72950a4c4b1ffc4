from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hsvaos
from hsvaos.camera import Camera
from hsvaos.flight import Flight, FlightError, Frame, Origin
from hsvaos.formats.native_write import write_native
from hsvaos.formats.poses import quaternion_from_rotation, rotation_from_quaternion
from hsvaos.formats.trajectory_csv import TRAJECTORY_COLUMNS

NOISE = np.random.default_rng(2).integers(0, 256, (6, 8, 3), dtype=np.uint8)
CAMERA = Camera(8, 6, 7.25, 7.5, 3.4, 2.6, (-0.1, 0.02, 1e-3, -2e-3, 0.5))

quaternions = (
    st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: np.array(q) / np.linalg.norm(q))
)
metres = st.floats(-1e5, 1e5)


def flight_of(poses, camera=CAMERA, **more):
    frames = [Frame(f"{i:03d}.png", Path(), pose, float(i)) for i, pose in enumerate(poses)]
    return Flight('a "name" with \\ and ü', camera, tuple(frames), **more)


def pose_of(quaternion=(1, 0, 0, 0), place=(0, 0, 0)):
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(quaternion)
    pose[:3, 3] = place
    return pose


@pytest.fixture
def folder(tmp_path):
    """A native flight of three photos."""
    flight = flight_of([pose_of(place=(i, 2.0, -30.0)) for i in range(3)])
    return write_native(flight, tmp_path / "flight", images=[NOISE] * 3)


def edit(folder, name, old, new):
    path = folder / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@given(quaternions)
def test_quaternion_round_trip(quaternion):
    rotation = rotation_from_quaternion(quaternion)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    again = quaternion_from_rotation(rotation)
    assert abs(again @ quaternion) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(again), rotation, atol=1e-12)


def test_quaternion_convention():
    # Hamilton, w first: 90 degrees about down takes north to east.
    rotation = rotation_from_quaternion([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(rotation @ [1, 0, 0], [0, 1, 0], atol=1e-12)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.tuples(quaternions, metres, metres, metres), min_size=1, max_size=4),
    st.builds(Origin, st.floats(-90, 90), st.floats(-180, 180), st.floats(-100, 5000)),
    st.floats(-50, 50),
)
def test_round_trip(tmp_path_factory, poses, origin, ground):
    flight = flight_of([pose_of(q, p) for q, *p in poses], origin=origin, ground_down_m=ground)
    folder = tmp_path_factory.mktemp("native") / "flight"
    write_native(flight, folder, images=[NOISE] * len(flight))
    again = hsvaos.open_flight(folder)
    assert (again.name, again.camera, again.origin) == (flight.name, flight.camera, origin)
    assert (again.format, again.ground_down_m, again.notes) == ("native", ground, ())
    np.testing.assert_allclose(again.poses, flight.poses, rtol=1e-15, atol=1e-14)
    assert [f.t_s for f in again.frames] == [f.t_s for f in flight.frames]
    np.testing.assert_array_equal(next(again.images()), NOISE)
    assert [p.name for p in folder.parent.iterdir()] == ["flight"]


def test_everything_that_belongs_to_a_flight_is_carried_over(tmp_path):
    mask = cv2.imencode(".png", np.eye(6, 8, dtype=np.uint8) * 255)[1].tobytes()
    for name in ("m.png", "own.png"):
        (tmp_path / name).write_bytes(mask)
    (tmp_path / "dem.npz").write_bytes(b"terrain")
    frames = [Frame("a.png", Path(), np.eye(4)), Frame("b.png", Path(), np.eye(4))]
    frames[1] = Frame("b.png", Path(), np.eye(4), mask=tmp_path / "own.png")
    mounting = {"body_from_camera_q": [0.5, 0.5, 0.5, 0.5], "camera_lever_arm_m": [0.1, 0, 0.05]}
    flight = Flight(
        "all",
        CAMERA,
        tuple(frames),
        mask=tmp_path / "m.png",
        terrain=tmp_path / "dem.npz",
        sensors=mounting,
    )
    logs = {
        "baro": {"t_s": np.arange(3) * 0.1, "height_m": [1.0, 2.0, 3.5]},
        "triggers": {"file": ["a.png", "b.png"], "t_s": [0.1, 0.2]},
    }
    folder = write_native(
        flight, tmp_path / "out", images=[NOISE] * 2, logs=logs, truth={"people": []}
    )
    again = hsvaos.open_flight(folder)
    assert again.mask == folder / "mask.png"
    assert again.terrain == folder / "terrain.npz"
    assert [frame.mask for frame in again.frames] == [None, folder / "masks" / "b.png"]
    np.testing.assert_array_equal(again.sensors["body_from_camera_q"], [0.5] * 4)
    assert (folder / "baro.csv").read_text().splitlines()[1:3] == ["0.0,1.0", "0.1,2.0"]
    assert again.sensors["triggers"].read_text().splitlines()[1] == "a.png,0.1"
    assert json.loads((folder / "truth.json").read_text()) == {"people": []}
    # Opened and written again, now by copying the files.
    third = hsvaos.open_flight(write_native(again, tmp_path / "copy"))
    assert third.sensors["baro"].read_bytes() == again.sensors["baro"].read_bytes()
    assert [frame.mask is None for frame in third.frames] == [True, False]


def test_a_crash_leaves_nothing_behind(tmp_path):
    def broken():
        yield NOISE
        raise RuntimeError("the power went")

    with pytest.raises(RuntimeError, match="power"):
        write_native(flight_of([np.eye(4)] * 2), tmp_path / "flight", images=broken())
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("mine")
    with pytest.raises(FlightError, match="new or empty folder"):
        write_native(flight_of([np.eye(4)]), tmp_path / "full", images=[NOISE])
    with pytest.raises(FlightError, match="expected 2 images, got 1"):
        write_native(flight_of([np.eye(4)] * 2), tmp_path / "short", images=[NOISE])


def test_names_with_commas_and_quotes_and_flights_without_poses(tmp_path):
    name = 'a, "b".png'
    flight = Flight("x", CAMERA, (Frame(name, Path(), np.eye(4)),))
    again = hsvaos.open_flight(write_native(flight, tmp_path / "f", images=[NOISE]))
    assert [frame.name for frame in again.frames] == [name]
    with pytest.raises(FlightError, match="needs poses or triggers"):
        write_native(flight_of([None]), tmp_path / "g", images=[NOISE])
    assert not (tmp_path / "g").exists()


def test_without_poses_frames_come_from_the_triggers(folder):
    (folder / "poses.csv").unlink()
    (folder / "imu.csv").write_text("t_s\n")
    (folder / "triggers.csv").write_text("file,t_s\n000.png,0.5\n001.png,1.5\n002.png,nan\n")
    edit(folder, "flight.toml", 'poses = "poses.csv"\n', "")
    with (folder / "flight.toml").open("a") as file:
        file.write('[nav]\nimu = "imu.csv"\ntriggers = "triggers.csv"\n')
    flight = hsvaos.open_flight(folder)
    assert not flight.has_poses
    assert [frame.t_s for frame in flight.frames] == [0.5, 1.5]
    assert any("1 photo left out: pose not usable (002.png)" in note for note in flight.notes)


def test_camera_by_fov_and_by_the_caller(folder):
    text = (folder / "flight.toml").read_text()
    start, rest = text.split("[camera]")
    (folder / "flight.toml").write_text(
        f"{start}[camera]\nfov_deg = 50\n\n[frames]{rest.split('[frames]')[1]}"
    )
    assert hsvaos.open_flight(folder).camera == Camera.from_fov(8, 6, 50.0)
    assert hsvaos.open_flight(folder, fov_deg=40).camera == Camera.from_fov(8, 6, 40.0)
    assert hsvaos.open_flight(folder, camera=CAMERA).camera == CAMERA
    with pytest.raises(FlightError, match="expected camera or fov_deg, got both"):
        hsvaos.open_flight(folder, camera=CAMERA, fov_deg=40)


def test_poses_mask_and_ground_by_the_caller(folder, tmp_path):
    text = (folder / "poses.csv").read_text().splitlines()
    (tmp_path / "other.csv").write_text("\n".join([text[0], text[2].replace("-30.0", "-31.0")]))
    mask = folder / "images" / "000.png"
    flight = hsvaos.open_flight(folder, poses=tmp_path / "other.csv", ground_down_m=1.5, mask=mask)
    assert [f.name for f in flight.frames] == ["001.png"]
    assert flight.poses[0, 2, 3] == -31.0
    assert (flight.ground_down_m, flight.mask) == (1.5, mask)


def test_deviations_of_poses_are_kept(tmp_path):
    std = np.array([0.4, 0.3, 0.2, *np.radians([0.1, 0.2, 0.6])])
    flight = flight_of([pose_of(place=(i, 2.0, -30.0)) for i in range(3)])
    frames = [replace(frame, covariance=np.diag(std**2)) for frame in flight.frames]
    folder = write_native(flight.replace(frames=frames), tmp_path / "sure", images=[NOISE] * 3)
    read = hsvaos.open_flight(folder).pose_covariances
    np.testing.assert_allclose(read, [np.diag(std**2)] * 3, rtol=1e-5)
    assert flight.pose_covariances is None
    # one photo without: nothing is known of their mean, and the file has no such columns
    frames = [frames[0], replace(frames[1], covariance=None), frames[2]]
    other = write_native(flight.replace(frames=frames), tmp_path / "partly", images=[NOISE] * 3)
    assert "std_north_m" not in (other / "poses.csv").read_text()
    edit(folder, "poses.csv", ",0.4,", ",-0.4,")
    with pytest.raises(FlightError, match=r"expected std_\* columns of at least 0, got -0.4"):
        hsvaos.open_flight(folder)


BAD_FILES = {
    "malformed TOML": ("flight.toml", "[camera]", "[camera", r"malformed TOML.*line \d"),
    "no intrinsics": ("flight.toml", "fx = 7.25\n", "", "lacks fx"),
    "focal length of text": ("flight.toml", "fx = 7.25", 'fx = "7"', "fx must be a number"),
    "negative focal length": ("flight.toml", "fx = 7.25", "fx = -7.0", "positive focal length"),
    "NaN centre": ("flight.toml", "cx = 3.4", "cx = nan", "cx must be a number"),
    "camera of another size": (
        "flight.toml",
        "width = 8",
        "width = 9",
        "not of 9 x 6 px like the camera, but 8 x 6",
    ),
    "another model": ("flight.toml", '"opencv"', '"fisheye"', "model must be 'opencv'"),
    "absent poses": ("flight.toml", '"poses.csv"', '"x.csv"', "'x.csv', which is not there"),
    "poses no text": ("flight.toml", '"poses.csv"', "3", "poses must be text"),
    "world of another frame": ("flight.toml", '"NED"', '"ENU"', "frame must be 'NED'"),
    "wrong column": ("poses.csv", "qw", "q0", "missing qw, got file,"),
    "not a number": ("poses.csv", "-30.0", "deep", "line 2: column 'down_m' must be a number"),
    "missing field": ("poses.csv", ",-30.0", "", "line 2: expected 9 fields, got 8"),
    "empty name": ("poses.csv", "000.png", "", "line 2: column 'file' is empty"),
    "all NaN": ("poses.csv", "-30.0", "nan", "no photo can be used.*NaN"),
    "no rotation": ("poses.csv", "1.0,0.0,0.0,0.0", "1,1,0,0", "unit length, got length 1.414"),
    "absent images": ("poses.csv", ".png", ".x.png", r"3 photos left out: no such image in .*000"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_one_clear_line(folder, case):
    name, old, new, message = BAD_FILES[case]
    edit(folder, name, old, new)
    with pytest.raises(FlightError, match=message) as error:
        hsvaos.open_flight(folder)
    assert str(folder) in str(error.value)
    assert "\n" not in str(error.value)


def test_files_that_are_no_utf8(folder):
    (folder / "poses.csv").write_bytes(b"file,t_s\n\xff\xfe")
    with pytest.raises(FlightError, match=r"poses\.csv: expected UTF-8 text, got the byte 0xff"):
        hsvaos.open_flight(folder)
    (folder / "poses.csv").write_text("")
    with pytest.raises(FlightError, match=r"poses\.csv: expected the columns .* empty file"):
        hsvaos.open_flight(folder)


def test_what_is_bad_is_left_out_where_the_rest_can_be_used(folder):
    lines = (folder / "poses.csv").read_text().splitlines()
    row = lines[1].split(",")
    lines += [
        lines[1],  # listed twice
        ",".join(["absent.png", *row[1:]]),
        ",".join(["nan.png", *row[1:3], "nan", *row[4:]]),
        ",".join(["wide.png", *row[1:]]),
        ",".join(["text.png", *row[1:]]),
        ",".join(["almost.png", *row[1:5], "1.0009", *row[6:]]),
    ]
    (folder / "poses.csv").write_text("\n".join(lines))
    images = folder / "images"
    cv2.imwrite(str(images / "wide.png"), np.zeros((6, 9), np.uint8))
    (images / "text.png").write_text("no image")
    (images / "almost.png").write_bytes((images / "000.png").read_bytes())
    flight = hsvaos.open_flight(folder)
    assert [f.name for f in flight.frames] == ["000.png", "001.png", "002.png", "almost.png"]
    for what in (
        r"listed more than once (000.png)",
        "(absent.png)",
        "pose not usable (nan.png)",
        "not a readable image (text.png)",
        "not of 8 x 6 px and kind like the others (wide.png)",
    ):
        assert any(what in note and note.startswith("1 photo") for note in flight.notes), what
    np.testing.assert_allclose(flight.poses[3, :3, :3], np.eye(3), atol=1e-12)


@pytest.mark.parametrize("north", ["1e12", "-1e30"])
def test_poses_beyond_the_earth_are_left_out(folder, north):
    edit(folder, "poses.csv", "001.png,1.0,1.0,", f"001.png,1.0,{north},")
    flight = hsvaos.open_flight(folder)
    assert [f.name for f in flight.frames] == ["000.png", "002.png"]
    assert any("pose must lie within 10000 km of the origin" in note for note in flight.notes)


def test_a_trajectory_in_place_of_poses_gets_a_hint(folder, tmp_path):
    path = tmp_path / "trajectory.csv"
    path.write_text(f"{TRAJECTORY_COLUMNS}\n")
    with pytest.raises(FlightError, match=r"missing file, .*hsvaos nav FLIGHT --poses FILE writes"):
        hsvaos.open_flight(folder, poses=path)


def test_unknown_keys_and_tables_are_noted(folder):
    edit(folder, "flight.toml", "[world]", '[foo]\nbar = 1\n\n[world]\nterrian = "dem.tif"')
    edit(folder, "flight.toml", "[flight]", 'poses = "x.csv"\n[flight]')
    edit(folder, "flight.toml", "[camera]", "[camera]\nfocal_mm = 8")
    flight = hsvaos.open_flight(folder)
    path = folder / "flight.toml"
    assert flight.notes == (
        f"{path}: passed over 'poses', 'foo' at the top level; known are the tables [flight], "
        "[camera], [frames], [world], [nav]",
        f"{path}: passed over 'focal_mm' in [camera]; known are model, width, height, fx, fy, cx, "
        "cy, distortion, fov_deg",
        f"{path}: passed over 'terrian' in [world]; known are frame, origin_lat_deg, "
        "origin_lon_deg, origin_height_m, ground_down_m, terrain",
    )


def test_unknown_flights(tmp_path, folder):
    with pytest.raises(FlightError, match=r"gone: no such folder or file"):
        hsvaos.open_flight(tmp_path / "gone")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(FlightError, match=r"got an empty folder\. Understood are native: .*jku: "):
        hsvaos.open_flight(empty)
    (empty / "notes.txt").write_text("x")
    with pytest.raises(FlightError, match=r"got 1 entries \(notes.txt\)"):
        hsvaos.open_flight(empty)
    with pytest.raises(FlightError, match=r"expected poses\.json with M3x4"):
        hsvaos.open_flight(folder, format="jku")
    with pytest.raises(FlightError, match="format must be one of native, jku"):
        hsvaos.open_flight(folder, format="bag")
    with pytest.raises(FlightError, match=r"no such file \(given as poses"):
        hsvaos.open_flight(folder, poses=tmp_path / "p.csv")


def test_plain_photos_with_poses_of_the_caller(folder):
    flight = hsvaos.open_flight(folder / "images", poses=folder / "poses.csv", fov_deg=45)
    assert (flight.format, len(flight)) == ("photos", 3)
    with pytest.raises(FlightError, match="camera without intrinsics: give --fov DEG"):
        hsvaos.open_flight(folder / "images", poses=folder / "poses.csv")
