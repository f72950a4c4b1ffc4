from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.flight import FlightError
from hsvaos.formats.poses import NED_FROM_JKU, nearest_rotation

NOISE = np.random.default_rng(2).integers(0, 256, (8, 8), dtype=np.uint8)


def m3x4(seed):
    rng = np.random.default_rng(seed)
    rotation = nearest_rotation(np.eye(3) + 0.1 * rng.normal(size=(3, 3)))
    return np.hstack([rotation, rng.normal(size=(3, 1))])


def write(folder, names, poses=None, sub=""):
    """Write a poses.json that names files, and the images a.png, b.jpg and c.JPG."""
    poses = poses or [m3x4(i).tolist() for i in range(len(names))]
    (folder / sub).mkdir(exist_ok=True)
    cv2.imwrite(str(folder / sub / "a.png"), NOISE)
    cv2.imwrite(str(folder / sub / "b.jpg"), NOISE)
    (folder / sub / "c.JPG").write_bytes((folder / sub / "b.jpg").read_bytes())
    images = [{"imagefile": n, "M3x4": m} for n, m in zip(names, poses, strict=True)]
    (folder / "poses.json").write_text(json.dumps({"images": images}))
    return folder


def test_points_land_where_their_matrix_puts_them(tmp_path):
    matrix = m3x4(0)
    numbers_as_text = [[f"{value:.17g}" for value in row] for row in matrix]
    flight = hsvaos.open_flight(write(tmp_path, ["a.tiff"], [numbers_as_text]), fov_deg=50)
    points = np.random.default_rng(1).uniform((-1, -1, 19), (1, 1, 21), (20, 3))  # x east, y south
    in_camera = points @ matrix[:, :3].T + matrix[:, 3]
    expected = 4 / np.tan(np.radians(25)) * in_camera[:, :2] / in_camera[:, 2:] + 3.5
    north_east_down = np.stack([-points[:, 1], points[:, 0], points[:, 2]], axis=1)
    np.testing.assert_array_equal(north_east_down, points @ NED_FROM_JKU.T)
    np.testing.assert_allclose(flight.view(0).project(north_east_down), expected, atol=1e-9)


@pytest.mark.parametrize("sub", ["", "images"])
def test_names_with_another_extension_or_case(tmp_path, sub):
    names = ["a.tiff", "B.JPG", "c.jpg"]
    flight = hsvaos.open_flight(write(tmp_path, names, sub=sub), fov_deg=50)
    assert [frame.name for frame in flight.frames] == names
    assert [frame.path.name for frame in flight.frames] == ["a.png", "b.jpg", "c.JPG"]
    assert (flight.format, flight.origin, flight.notes) == ("jku", None, ())
    assert len(list(flight.images())) == 3


def test_the_file_itself_and_another_name_for_it(tmp_path):
    folder = write(tmp_path, ["a.png"])
    (folder / "poses.json").rename(folder / "list.json")
    (folder / "other.json").write_text("{ not ours")
    assert len(hsvaos.open_flight(folder, fov_deg=50)) == 1
    assert len(hsvaos.open_flight(folder / "list.json", fov_deg=50)) == 1


def test_camera_of_a_flight_toml_and_mask(tmp_path):
    folder = write(tmp_path, ["a.png", "b.png"])
    with pytest.raises(FlightError, match=r"without intrinsics: give --fov DEG or \[camera\]"):
        hsvaos.open_flight(folder)
    (folder / "flight.toml").write_text("[camera]\nfov_deg = 40.0\n")
    cv2.imwrite(str(folder / "mask.png"), NOISE)
    flight = hsvaos.open_flight(folder)
    assert flight.camera == hsvaos.Camera.from_fov(8, 8, 40.0)
    assert flight.mask == folder / "mask.png"
    assert ["mask.png" in note for note in flight.notes] == [True]
    assert hsvaos.open_flight(folder, mask=folder / "a.png").mask == folder / "a.png"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: [row[:3] for row in m], r"3 x 4 numbers, got shape \(3, 3\)"),
        (lambda m: [[float("nan"), *m[0][1:]], *m[1:]], "must be finite"),
        (lambda m: [["x", *m[0][1:]], *m[1:]], "3 x 4 numbers, got"),
        (lambda m: [m[1], m[0], m[2]], "must hold a rotation"),
        (lambda m: [[2 * v for v in row] for row in m], "must hold a rotation"),
        (lambda m: None, "M3x4 must"),
    ],
)
def test_bad_matrices(tmp_path, change, message):
    good, bad = m3x4(0).tolist(), change(m3x4(1).tolist())
    flight = hsvaos.open_flight(write(tmp_path, ["a.png", "b.png"], [good, bad]), fov_deg=50)
    assert [f.name for f in flight.frames] == ["a.png"]
    assert flight.notes[0].startswith("1 photo left out: pose not usable (b.png)")
    write(tmp_path, ["a.png"], [good])
    content = json.loads((tmp_path / "poses.json").read_text())
    content["images"][0]["M3x4"] = bad
    (tmp_path / "poses.json").write_text(json.dumps(content))
    with pytest.raises(FlightError, match=message) as error:
        hsvaos.open_flight(tmp_path, fov_deg=50)
    assert "poses.json" in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"images": [\n{"imagefile": ]}', r"poses\.json: line 2, column \d+: malformed JSON"),
        ('{"images": []}', "no known flight"),
        ('{"images": [{"M3x4": []}]}', r"images\[0\] must name an imagefile"),
        ('{"images": [{"imagefile": "gone.png", "M3x4": 1}]}', "no photo can be used"),
    ],
)
def test_bad_lists(tmp_path, text, message):
    write(tmp_path, ["a.png"])
    (tmp_path / "poses.json").write_text(text)
    with pytest.raises(FlightError, match=message):
        hsvaos.open_flight(tmp_path, fov_deg=50)


def test_absent_images_are_counted(tmp_path):
    names = ["a.png", *[f"gone{i}.png" for i in range(5)]]
    flight = hsvaos.open_flight(write(tmp_path, names), fov_deg=50)
    assert flight.notes[0].startswith("5 photos left out: no such image in ")
    assert flight.notes[0].endswith("(gone0.png, gone1.png, gone2.png, ...)")


def test_conifer(data):
    flight = hsvaos.open_flight(data("jku_conifer"), fov_deg=32.51)
    assert (flight.format, len(flight)) == ("jku", 10)
    assert flight.mask is not None
    # The cameras stand in a row of 11 units from west to east and look down.
    assert np.ptp(flight.poses[:, 1, 3]) == pytest.approx(11.0, abs=0.1)
    assert (flight.poses[:, 2, 2] > 0.97).all()
    assert next(flight.images()).shape == (1024, 1024, 3)


def test_f0_lies_as_its_reference_renderer_saw_it(data):
    """The mean of the photos over the plane z = 10 is the picture that JKU's renderer made."""
    folder = data("jku_f0_first30")
    flight = hsvaos.open_flight(folder, fov_deg=50.815436217896945)
    assert len(flight) == 30
    assert ["--terrain dem_lr.obj" in note for note in flight.notes] == [True]
    with np.load(folder / "reference" / "plane_z+10_512.npz") as reference:
        integral, count = reference["integral"], reference["count"]
        camera_from_jku = reference["M_virtual"].astype(np.float64)
    pose = np.eye(4)
    pose[:3, :3] = NED_FROM_JKU @ camera_from_jku[:3, :3].T
    pose[:3, 3] = -pose[:3, :3] @ camera_from_jku[:3, 3]
    view = hsvaos.VirtualCamera(flight.camera, pose)
    columns, rows = np.meshgrid(np.arange(512.0), np.arange(512.0))
    origins, directions = view.rays(np.stack([columns, rows], axis=-1))
    reach = (10.0 - origins[..., 2]) / directions[..., 2]
    ground = origins + reach[..., None] * directions
    total, number = np.zeros((512, 512)), np.zeros((512, 512))
    for i, image in enumerate(flight.images()):
        at = flight.view(i).project(ground)
        seen = ((at >= -0.5) & (at <= 511.5)).all(axis=-1)
        at = np.nan_to_num(at, nan=-99.0).astype(np.float32)
        sampled = cv2.remap(
            image.astype(np.float32), at[..., 0], at[..., 1],
            cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        total += np.where(seen, sampled, 0.0)
        number += seen
    assert (number == count).mean() > 0.99
    same = (number == count) & (number > 0)
    error = total[same] / number[same] - integral[same]
    assert 10 * np.log10(255**2 / np.mean(error**2)) > 60.0  # PSNR [dB]
