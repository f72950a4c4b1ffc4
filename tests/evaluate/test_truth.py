"""True boxes and rays, and truth.json with its faults."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hsvaos
from hsvaos.camera import VirtualCamera
from hsvaos.demo import FOLDER
from hsvaos.evaluate.seen import ground_seen_ha
from hsvaos.evaluate.truth import TruthPerson, read_truth, truth_box, truth_boxes
from hsvaos.flight import Flight, FlightError, Frame
from hsvaos.surface import FocalPlane
from tests.evaluate.scenes import above, lying


def test_box_has_the_edges_of_the_shape() -> None:
    box = truth_box("a", lying("a", 0.0, 0.0).outline, above())
    assert box is not None
    # 0.1 m a pixel, centre at 100: 0.6 m to both sides of it, 1.8 m up and down
    np.testing.assert_allclose(box.xyxy, [97.0, 91.0, 103.0, 109.0])
    assert box.inside == 1.0


def test_box_of_a_pixel_is_the_pixel() -> None:
    view = VirtualCamera.ortho(0.0, 0.0, 0.5, 20, 20)
    square = np.array([[-1.25, 1.75, 0], [-1.25, 2.25, 0], [-1.75, 2.25, 0], [-1.75, 1.75, 0]])
    box = truth_box("a", square, view)
    assert box is not None
    np.testing.assert_allclose(box.xyxy, [3.5, 2.5, 4.5, 3.5])


@given(north=st.floats(-14.0, 14.0), east=st.floats(-14.0, 14.0))
def test_clipped_box_lies_in_the_picture_and_knows_its_share(north: float, east: float) -> None:
    box = truth_box("a", lying("a", north, east).outline, above())
    middle = np.array([east, -north]) / 0.1 + 100.0
    half = np.array([3.0, 9.0])
    low, high = np.maximum(middle - half, -0.5), np.minimum(middle + half, 200.5)
    share = float(np.maximum(high - low, 0.0).prod()) / (6.0 * 18.0)
    if box is None:
        assert share < 1e-9
    else:
        assert box.inside == pytest.approx(share, abs=1e-9)
        np.testing.assert_allclose(box.xyxy, [*low, *high], atol=1e-9)


def test_nobody_behind_the_camera_has_a_box() -> None:
    up = above()
    pose = up.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    assert truth_box("a", lying("a", 0.0, 0.0).outline, VirtualCamera(up.camera, pose)) is None


def test_demo_flight_rays_and_boxes() -> None:
    flight = hsvaos.open_flight(FOLDER)
    people = read_truth(flight)
    assert [p.occlusion for p in people] == ["full", "half"]
    raw = json.loads((FOLDER / "truth.json").read_text())
    pixels = np.array(raw["pixels"]["by_photo"])  # photo, person, (shown, unoccluded)
    for k, person in enumerate(people):
        # the photos' own pixels say the same: those with a part of the person count in part
        shown = int((pixels[:, k, 1] >= 12).sum())
        assert shown - 3 < person.photos <= shown
        assert person.rays == pytest.approx(person.photos * person.visible)
        entry = raw["people"][k]
        np.testing.assert_allclose(person.place, [entry["north_m"], entry["east_m"]], atol=1e-3)
        seen = [truth_boxes([person], flight.view(i)) for i in range(len(flight))]
        assert [bool(boxes) for boxes in seen] == (pixels[:, k, 1] > 0).tolist()
    assert people[0].rays < 1.5 < people[1].rays


def level_flight(places: list[tuple[float, float]]) -> Flight:
    frames = []
    for k, (north, east) in enumerate(places):
        frames.append(Frame(f"{k}.jpg", Path(f"{k}.jpg"), above(north, east).world_from_camera))
    camera = above().camera
    assert camera is not None
    return Flight("level", camera, tuple(frames))


def test_ground_seen_is_the_union_of_the_photos() -> None:
    one = 20.1**2 / 1e4  # 201 pixels of 0.1 m
    surface = FocalPlane(0.0)
    assert ground_seen_ha(level_flight([(0, 0)]), surface) == pytest.approx(one, rel=0.01)
    assert ground_seen_ha(level_flight([(0, 0)] * 3), surface) == pytest.approx(one, rel=0.01)
    half_apart = ground_seen_ha(level_flight([(0, 0), (0, 10.05)]), surface)
    assert half_apart == pytest.approx(1.5 * one, rel=0.01)
    apart = ground_seen_ha(level_flight([(0, 0), (0, 40)]), surface)
    assert apart == pytest.approx(2 * one, rel=0.01)


def truth_with(tmp_path: Path, content: Any) -> Flight:
    folder = Path(shutil.copytree(FOLDER, tmp_path / "flight"))
    text = content if isinstance(content, str) else json.dumps(content)
    (folder / "truth.json").write_text(text)
    return hsvaos.open_flight(folder)


PERSON = {"id": "a", "outline_ned_m": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "occlusion": "half"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "malformed JSON"),
        ("[1]", "list of people"),
        ({"people": {}}, "list of people"),
        ({"people": []}, "no people"),
        ({"people": [3]}, r"people\[0\]: expected an object"),
        ({"people": [PERSON]}, r"people\[0\]: lacks visible_fraction_mean"),
        ({"people": [{**PERSON, "visible_fraction_mean": 2.0}]}, "visible must be a share"),
        ({"people": [{**PERSON, "visible_fraction_mean": "much"}]}, r"people\[0\]"),
        (
            {"people": [{**PERSON, "visible_fraction_mean": 0.5, "outline_ned_m": [[1, 2]]}]},
            "at least 3 points",
        ),
        ({"people": [{**PERSON, "visible_fraction_mean": 0.5}] * 2}, "same id"),
    ],
)
def test_faults_of_truth_are_named(tmp_path: Path, content: Any, message: str) -> None:
    with pytest.raises(FlightError, match=message):
        read_truth(truth_with(tmp_path, content))


def test_who_is_in_no_photo_is_unseen(tmp_path: Path) -> None:
    far = [[n + 500.0, e, d] for n, e, d in PERSON["outline_ned_m"]]
    entry = {**PERSON, "occlusion": None, "visible_fraction_mean": None, "outline_ned_m": far}
    (person,) = read_truth(truth_with(tmp_path, {"people": [entry]}))
    assert (person.occlusion, person.photos, person.rays) == ("unseen", 0.0, 0.0)


def test_no_truth_is_said_with_a_way_out(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(FOLDER, tmp_path / "flight"))
    (folder / "truth.json").unlink()
    with pytest.raises(FlightError, match=r"truth\.json: no such file.*hsvaos simulate"):
        read_truth(hsvaos.open_flight(folder))


def test_outline_must_be_finite() -> None:
    with pytest.raises(ValueError, match="a: outline must be finite"):
        TruthPerson("a", np.full((3, 3), np.nan), "half", 0.5, 3.0)
