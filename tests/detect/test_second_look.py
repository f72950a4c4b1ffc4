"""The second look: patches, boxes put right, and when the detector looks again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hsvaos.detect.yolo as yolo
from hsvaos import Detector
from hsvaos.detect.network_input import CHANNELS
from hsvaos.detect.second_look import (
    FLOOR,
    MOST,
    SECOND_CHANNELS,
    SecondLook,
    corner_of,
    facts_of,
    moved,
    patch,
)
from hsvaos.finding import make_finder, operating_scores
from hsvaos.settings import DetectSettings
from tests.detect.nets import own_net, second_net

PLACES = st.integers(-480, 1120).map(lambda eighths: eighths / 8.0)  # sums are exact
SIDES = st.integers(8, 480).map(lambda eighths: eighths / 8.0)


@given(PLACES, PLACES, SIDES, SIDES, st.integers(8, 90))
def test_a_patch_is_a_window_of_the_view_with_zeros_around_it(
    left: float, top: float, width: float, height: float, side: int
) -> None:
    planes = np.random.default_rng(0).normal(size=(3, 70, 90)).astype(np.float32)
    box = np.array([left, top, left + width, top + height], np.float32)
    padded = np.pad(planes[:2], ((0, 0), (0, 6), (0, 22)))  # as the first network takes them
    found = patch((padded, planes[2:]), box, side)
    around = 300
    wide = np.pad(planes, ((0, 0), (around, around), (around, around)))
    x, y = corner_of(box, side)
    want = wide[:, y + around : y + around + side, x + around : x + around + side]
    np.testing.assert_array_equal(found[:3], want)
    rows, columns = np.nonzero(found[3])
    inside = {
        (r, c)
        for r in range(side)
        for c in range(side)
        if box[0] <= c + x <= box[2] and box[1] <= r + y <= box[3]
    }
    assert set(zip(rows.tolist(), columns.tolist(), strict=True)) == inside
    middle = 0.5 * (box[:2] + box[2:])
    assert np.abs(middle - (np.array([x, y]) + 0.5 * (side - 1))).max() <= 0.51


@given(
    st.lists(st.tuples(PLACES, PLACES, st.floats(2.0, 50.0), st.floats(2.0, 50.0)), min_size=1),
    st.floats(-0.5, 0.5),
    st.floats(-1.0, 1.0),
)
def test_boxes_move_by_their_sides_and_grow_by_factors(
    places: list[tuple[float, float, float, float]], shift: float, growth: float
) -> None:
    corners = np.array(places)
    boxes = np.concatenate([corners[:, :2], corners[:, :2] + corners[:, 2:]], axis=1)
    same = moved(boxes, np.zeros_like(boxes))
    np.testing.assert_allclose(same, boxes, atol=1e-3)
    found = moved(boxes, np.tile([shift, 0.0, growth, 0.0], (len(boxes), 1)))
    np.testing.assert_allclose(found[:, [1, 3]], boxes[:, [1, 3]], atol=1e-3)
    sides = found[:, 2] - found[:, 0]
    np.testing.assert_allclose(sides, corners[:, 2] * np.exp(growth), rtol=1e-3, atol=1e-3)
    middles = 0.5 * (found[:, 0] + found[:, 2])
    want = corners[:, 0] + (0.5 + shift) * corners[:, 2]
    np.testing.assert_allclose(middles, want, atol=1e-2)


def test_scores_follow_what_lies_in_the_box_and_weak_boxes_are_left_out(tmp_path: Path) -> None:
    model = tmp_path / "second.onnx"
    model.write_bytes(second_net("fragments", 40.0, (0.25, 0.0, 0.0, np.log(2.0))))
    planes = np.zeros((len(SECOND_CHANNELS), 120, 150), np.float32)
    planes[SECOND_CHANNELS.index("fragments"), 20:60, 20:60] = 1.0
    boxes = np.array([[30.0, 30.0, 50.0, 50.0], [100, 90, 120, 110], [5, 90, 25, 110]], np.float32)
    scores = np.array([0.5, 0.5, 0.5 * FLOOR], np.float32)
    placed, sure = SecondLook(model).at((planes,), boxes, scores)
    assert len(placed) == len(sure) == 2
    assert sure[0] > 0.99
    assert sure[1] == pytest.approx(0.5, abs=1e-4)
    np.testing.assert_allclose(placed[0], [35.0, 20.0, 55.0, 60.0], atol=1e-3)
    nobody = SecondLook(model).at((planes,), boxes[:0], scores[:0])
    assert nobody[0].shape == (0, 4)
    assert nobody[1].shape == (0,)


def test_many_boxes_are_looked_at_in_turn_and_the_strongest_first(tmp_path: Path) -> None:
    model = tmp_path / "second.onnx"
    model.write_bytes(second_net("fragments", 0.0, (0.0, 0.0, 0.0, 0.0)))
    rng = np.random.default_rng(2)
    corners = np.stack(np.meshgrid(np.arange(20) * 14.0, np.arange(20) * 14.0), -1).reshape(-1, 2)
    boxes = np.concatenate([corners, corners + 10.0], axis=1).astype(np.float32)
    scores = rng.uniform(0.1, 0.9, len(boxes)).astype(np.float32)
    planes = rng.normal(size=(len(SECOND_CHANNELS), 64, 64)).astype(np.float32)
    placed, sure = SecondLook(model).at((planes,), boxes, scores)
    order = np.argsort(-scores)[:MOST]
    np.testing.assert_allclose(sure, scores[order], atol=1e-4)
    np.testing.assert_allclose(placed, boxes[order], atol=1e-3)
    facts = facts_of(boxes[order], scores[order])
    np.testing.assert_allclose(1.0 / (1.0 + np.exp(-facts[:, 0])), scores[order], atol=1e-4)


def test_it_says_how_sure_a_person_need_be_where_it_looks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    second = tmp_path / "second.onnx"
    still = (0.0, 0.0, 0.0, 0.0)
    monkeypatch.setattr(yolo, "PACKAGED_SECOND_LOOK", second)
    second.write_bytes(second_net("fragments", 0.0, still, person_score_threshold="0.3"))
    detector = Detector()
    assert detector.person_score(all_known=True) == 0.3
    assert detector.person_score() == detector.score == 0.697
    assert Detector(score=0.5).person_score(all_known=True) == 0.5
    first = Detector(yolo.PACKAGED.read_bytes())  # looks once
    assert first.person_score(all_known=True) == first.score
    assert operating_scores(DetectSettings()) == (0.697, 0.3)
    assert operating_scores(DetectSettings(), colour=False) == (0.697, 0.697)
    assert operating_scores(DetectSettings(inputs="integrals")) == (0.697, 0.697)
    assert operating_scores(DetectSettings(person_score=0.6), colour=False) == (0.697, 0.6)
    for colour, of_persons in ((True, 0.3), (False, 0.697)):
        finder = make_finder(DetectSettings(), 30, colour)
        assert finder is not None
        assert (finder.scores.of_persons, finder.looks_at_photos) == (of_persons, colour)
    second.write_bytes(second_net("fragments", 0.0, still))
    assert Detector().person_score(all_known=True) == 0.697
    second.write_bytes(second_net("fragments", 0.0, still, person_score_threshold="likely"))
    with pytest.raises(ValueError, match="person_score_threshold from 0 to 1"):
        Detector().person_score(all_known=True)


def test_a_network_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "own.onnx").write_bytes(own_net([1.0]))
    with pytest.raises(ValueError, match="second look, with the channels SECOND_CHANNELS"):
        SecondLook(tmp_path / "own.onnx")
    with pytest.raises(ValueError, match="no such ONNX file"):
        SecondLook(tmp_path / "missing.onnx")


def test_the_detector_looks_again_only_where_everything_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, again = tmp_path / "first.onnx", tmp_path / "second.onnx"
    weights = [0.0] * len(CHANNELS)
    weights[CHANNELS.index("red")] = 8.0
    first.write_bytes(own_net(weights, -4.0))
    again.write_bytes(second_net("fragments", 0.0, (0.0, 0.0, 0.0, 0.0), bias=-20.0))
    monkeypatch.setattr(yolo, "PACKAGED", first)
    monkeypatch.setattr(yolo, "PACKAGED_PICTURE", first)
    monkeypatch.setattr(yolo, "PACKAGED_SECOND_LOOK", again)
    rng = np.random.default_rng(3)
    image = rng.normal((60.0, 90.0, 50.0), 4.0, (160, 192, 3)).astype(np.float32)
    image[64:80, 96:112] = (200.0, 60.0, 50.0)
    flat = np.full(image.shape[:2], 9.0, np.float32)
    known = {
        "footprint": flat,
        "rarity": flat,
        "plain": image,
        "coherence": (image, flat),
        "fragments": flat,
        "fragment_coherence": (image, flat),
        "ground": (image, flat),
    }
    assert len(Detector().detect(image)) == 1
    assert len(Detector().detect(image, **known)) == 0  # the second network believes nothing
    for name in known:
        part = {key: value for key, value in known.items() if key != name}
        assert len(Detector().detect(image, **part)) == 1
    assert len(Detector(first).detect(image, **known)) == 1  # another's network is its own judge
