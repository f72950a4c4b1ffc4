"""`hsvaos detect` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hsvaos.flight import FlightError
from hsvaos.formats.integral import read_view
from tests.detect.nets import own_net, photo_net
from tests.detect.test_detector import RED_CONTRAST, with_person
from tests.test_cli import cli, fails


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "own.onnx"
    path.write_bytes(own_net(RED_CONTRAST, -5.0))
    return path


def write_picture(path: Path, row: int, column: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.clip(with_person(1, row, column), 0, 255).astype(np.uint8)
    cv2.imwrite(str(path), image[..., ::-1])
    return path


def write_npz(path: Path, row: int, column: int) -> Path:
    image = with_person(2, row, column)
    footprint = np.full(image.shape[:2], 7.0, np.float32)
    footprint[:, :32] = 0.0
    image[:, :32] = 0.0
    rarity = np.zeros_like(footprint)
    np.savez(path, image=image, footprint=footprint, rays=9 * footprint, rarity_map=rarity)
    return path


def test_pictures_and_arrays_of_one_name(model: Path, tmp_path: Path) -> None:
    first = write_picture(tmp_path / "a" / "integral.png", 64, 112)
    second = write_picture(tmp_path / "b" / "integral.png", 32, 48)
    third = write_npz(tmp_path / "a" / "integral.npz", 16, 64)
    nobody = tmp_path / "nobody.tiff"
    cv2.imwrite(str(nobody), with_person(3, 0, 0)[40:])
    out = tmp_path / "out"
    files = (first, second, third, nobody, first)
    done = cli("detect", *files, "--model", model, "-o", out, "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    told = json.loads(done.stdout)
    assert (told["layout"], told["provider"], told["score"]) == ("hsvaos", "cpu", 0.4)
    assert told["errors"] == []
    stored = json.loads((out / "detections.json").read_text())
    assert stored["persons"] == []
    assert stored["views"] == told["views"]
    assert [v["frame"] for v in stored["views"]] == [
        str(first),
        str(second),
        "integral.npz",
        "nobody.tiff",
    ]
    boxes = [[box["xyxy"] for box in view["boxes"]] for view in stored["views"]]
    expected = [[[112, 64, 128, 80]], [[48, 32, 64, 48]], [[64, 16, 80, 32]], []]
    for got, wanted in zip(boxes, expected, strict=True):
        np.testing.assert_allclose(np.reshape(got, (-1, 4)), np.reshape(wanted, (-1, 4)) - 0.5)
    assert sorted(path.name for path in out.iterdir()) == sorted(told["files"])
    assert len(told["files"]) == 5
    drawn = cv2.imread(str(out / "integral_detections.png"), cv2.IMREAD_UNCHANGED)
    assert drawn.shape == (160, 200, 4)
    hidden = cv2.imread(str(out / "integral_detections_3.png"), cv2.IMREAD_UNCHANGED)
    assert (hidden[:, :32, 3] == 0).all()
    assert (hidden[:, 32:, 3] > 0).all()


def test_table_and_bad_files_beside_good_ones(model: Path, tmp_path: Path) -> None:
    good = write_picture(tmp_path / "good[1].png", 64, 112)
    text = tmp_path / "text.png"
    text.write_text("this is no picture")
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK\x03\x04 not an archive")
    wrong = tmp_path / "wrong.npz"
    np.savez(wrong, picture=np.zeros((3, 3)))
    files = (tmp_path / "gone.png", good, text, broken, wrong, tmp_path)
    done = cli("detect", *files, "--model", model)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 5
    for name, error in zip(("gone", "text", "broken", "wrong", "folder"), errors, strict=True):
        assert name in error
    assert "good[1].png" in done.stdout
    assert "112" in done.stdout or "111.5" in done.stdout
    assert "layout hsvaos" in done.stdout
    assert "on cpu" in done.stdout


def test_options(model: Path, tmp_path: Path) -> None:
    picture = write_picture(tmp_path / "p.png", 64, 112)
    assert "gone.onnx: no such ONNX file" in fails("detect", picture, "--model", "gone.onnx")
    assert "expected an ONNX network" in fails("detect", picture, "--model", picture)
    assert "layout must be" in fails("detect", picture, "--model", model, "--layout", "x")
    assert "score must lie" in fails("detect", picture, "--model", model, "--score", 7)
    assert "provider 'cuda'" in fails("detect", picture, "--model", model, "--provider", "cuda")
    assert "gsd_m must be" in fails("detect", picture, "--model", model, "--gsd", -1)
    assert str(picture) in fails("detect", picture, "--model", model, "-o", picture)
    other = tmp_path / "other.onnx"
    other.write_bytes(photo_net("yolov8", classes=3))
    assert "person_class" in fails("detect", picture, "--model", other)
    args = ("--model", other, "--person-class", 1, "--score", 0.9, "--json")
    done = cli("detect", picture, *args)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["score"] == 0.9


def test_stored_views(tmp_path: Path) -> None:
    grey = tmp_path / "grey.png"
    cv2.imwrite(str(grey), np.full((4, 5), 300, np.uint16))
    assert read_view(grey).image.dtype == np.uint16
    clear = tmp_path / "clear.png"
    pixels = np.full((4, 5, 4), 200, np.uint8)
    pixels[1, :, 3] = 0
    cv2.imwrite(str(clear), pixels)
    view = read_view(clear)
    assert view.seen.sum() == 15
    assert not view.seen[1].any()
    grid = tmp_path / "grid.npz"
    image = np.zeros((4, 5, 1), np.float32)
    np.savez(grid, image=image, footprint=np.ones((4, 5)), ortho=np.array([0.0, 0.0, 0.07]))
    view = read_view(grid)
    assert view.gsd_m == 0.07
    assert view.image.shape == (4, 5)
    assert view.rays is not None
    for odd in (
        {"image": np.zeros(3)},
        {"image": np.zeros((4, 5), complex)},
        {"image": np.zeros((4, 5)), "rays": np.zeros((5, 4))},
        {"image": np.array([[None]], object)},
    ):
        np.savez(grid, **odd)
        with pytest.raises(FlightError, match=r"grid.npz"):
            read_view(grid)
