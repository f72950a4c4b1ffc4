"""The score from which a find counts for a person, chosen by flights (extra `train`)."""

import json

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

from bench.paper import Measured
from hsvaos import Camera, Detector, VirtualCamera
from hsvaos.detect.detections import Detections
from hsvaos.detect.locate import ViewFinds
from hsvaos.detect.network import Network
from hsvaos.detect.second_look import LOOK_PX, SECOND_CHANNELS, SecondLook
from hsvaos.evaluate.results import JudgedView
from hsvaos.evaluate.truth import TruthBox, TruthPerson
from tests.detect.nets import OWN, own_net
from tests.kernels.test_integrate import looking_down
from train.persons import (
    box_rows,
    brought_to,
    chosen,
    chosen_for_boxes,
    rows_of,
    with_person_score,
)
from train.second_net import MeanOfNets, SecondNet, export_second


def person(north, east, rays=5.0):
    corners = np.array([[-0.9, -0.3], [0.9, -0.3], [0.9, 0.3], [-0.9, 0.3]])
    outline = np.column_stack([corners + np.array([north, east]), np.zeros(4)])
    return TruthPerson(f"{north} {east}", outline, "half", rays / 100.0, 100.0)


def flight(finds, people):
    """Finds (score, north, east) of one view that holds them all."""
    camera = Camera.from_fov(200, 200, 90.0)
    view = VirtualCamera(camera, looking_down(0.0, 0.0, 20.0))
    scores = np.array([score for score, *_ in finds], np.float32)
    places = np.array([[*place, 0.0] for _, *place in finds])
    count = len(finds)
    found = Detections(np.zeros((count, 4), np.float32), scores, np.zeros(count, np.int64))
    one = ViewFinds(view, found, places, np.tile(0.01 * np.eye(2), (count, 1, 1)))
    return Measured("one", (), (one,), tuple(people), 0.4)


def test_rows_tell_who_is_found_and_who_is_not_there():
    people = [person(5.0, 5.0), person(-5.0, 5.0), person(-5.0, -5.0, rays=1.0)]
    finds = [(0.9, 5.0, 5.2), (0.6, 5.0, -5.0), (0.5, -5.0, 5.1), (0.4, -5.1, -5.0)]
    flights = [flight(finds, people), flight(finds[:1], people)]
    rows = rows_of(flights, (0.3, 0.55, 0.7))
    assert [(row.found, row.people, row.false_alarms) for row in rows] == [
        (3, 4, 1),  # whom one ray reaches counts neither way
        (2, 4, 1),
        (2, 4, 0),
    ]
    assert rows[2].expected == pytest.approx(-np.log(0.05) / 2.0, abs=1e-6)
    assert rows[0].expected == pytest.approx(4.744 / 2.0, abs=1e-3)  # Garwood's tables
    with pytest.raises(ValueError, match="got none"):
        rows_of([])


def test_the_least_score_with_few_false_alarms_from_there_on_is_chosen():
    people = [person(5.0, 5.0)]
    rows = rows_of([flight([(0.9, 5.0, 5.0), (0.5, -5.0, 5.0)], people)] * 6, (0.4, 0.6, 0.7))
    assert chosen(rows) == 0.6
    assert chosen(rows, most=3.0) == 0.4
    with pytest.raises(ValueError, match=r"0\.1 false alarms a flight"):
        chosen(rows, most=0.1)


def judged(finds):
    """Boxes (score, whether right) of one view."""
    places = np.arange(len(finds), dtype=np.float32)[:, None] * np.array([40, 0, 40, 0])
    boxes = places + np.array([0, 0, 20, 20], np.float32)
    scores = np.array([score for score, _ in finds], np.float32)
    found = Detections(boxes.astype(np.float32), scores, np.zeros(len(finds), np.int64))
    there = [box for box, (_, right) in zip(boxes.tolist(), finds, strict=True) if right]
    people = tuple(person(0.0, float(k)) for k in range(len(there)))
    truth = tuple(TruthBox(one.id, tuple(box), 1.0) for one, box in zip(people, there, strict=True))
    return Measured("one", (JudgedView("a", found, truth),), (), people, 0.4)


def test_boxes_need_a_precision_that_a_search_will_have():
    some = [(0.9, True)] * 54 + [(0.6, True)] * 36 + [(0.5, False)] + [(0.4, False)] * 9
    rows = box_rows([judged(some)], (0.3, 0.45, 0.55, 0.8))
    assert [(row.right, row.wrong) for row in rows] == [(90, 10), (90, 1), (90, 0), (54, 0)]
    many = -np.log(0.2)  # of none seen
    assert rows[2].precision == pytest.approx(54.0 / (54.0 + many), abs=1e-6)
    assert rows[3].precision == pytest.approx(32.4 / (32.4 + many), abs=1e-6)
    assert rows[1].precision == pytest.approx(54.0 / (54.0 + 2.994), abs=1e-3)
    assert chosen_for_boxes(rows) == 0.55
    assert chosen_for_boxes(rows, 0.94) == 0.45
    assert chosen_for_boxes(rows, 0.999) == 0.55  # the best there is


def test_a_second_look_is_brought_to_both_scores(tmp_path):
    def logit(p):
        return np.log(p / (1.0 - p))

    by = logit(0.7) - logit(0.8)
    path = tmp_path / "second.onnx"
    net = MeanOfNets([SecondNet(), SecondNet()])
    export_second(net, path, 0.3, {"seeds": [1, 2]})
    patches = np.random.default_rng(1).normal(size=(3, len(SECOND_CHANNELS) + 1, LOOK_PX, LOOK_PX))
    facts = np.random.default_rng(2).normal(size=(3, 3))
    feeds = {"input": patches, "facts": facts}
    before = Network(path).run(feeds)
    brought_to(path, 0.7, 0.8, 0.6)
    after, look = Network(path).run(feeds), SecondLook(path)
    assert json.loads(Network(path).metadata["training"])["shift"] == round(0.3 + by, 4)

    np.testing.assert_allclose(logit(after["scores"]), logit(before["scores"]) + by, atol=1e-4)
    np.testing.assert_array_equal(after["shifts"], before["shifts"])
    assert look.person_score is not None
    assert logit(look.person_score) == pytest.approx(logit(0.6) + by, abs=0.003)
    assert [p.name for p in tmp_path.iterdir()] == ["second.onnx"]
    path.write_bytes(own_net([1.0], metadata=OWN))
    with pytest.raises(ValueError, match="the sigmoid of logits and a shift"):
        brought_to(path, 0.7, 0.8, 0.6)


def test_it_goes_into_the_file_and_nothing_else_changes(tmp_path):
    path = tmp_path / "own.onnx"
    path.write_bytes(own_net([1.0], metadata=OWN))
    assert Detector(path).person_score() == Detector(path).score == 0.4
    with_person_score(path, 0.25)
    changed = Detector(path)
    assert (changed.score, changed.person_score(), changed.layout) == (0.4, 0.25, "hsvaos")
    assert Detector(path, score=0.3).person_score() == 0.3
    assert [p.name for p in tmp_path.iterdir()] == ["own.onnx"]
