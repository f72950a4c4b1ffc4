"""The score from which a find counts for a person, chosen by flights (extra `train`)."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

from bench.paper import Measured
from hsvaos import Camera, Detector, VirtualCamera
from hsvaos.detect.detections import Detections
from hsvaos.detect.locate import ViewFinds
from hsvaos.evaluate.truth import TruthPerson
from tests.detect.nets import OWN, own_net
from tests.kernels.test_integrate import looking_down
from train.persons import chosen, rows_of, with_person_score


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


def test_it_goes_into_the_file_and_nothing_else_changes(tmp_path):
    path = tmp_path / "own.onnx"
    path.write_bytes(own_net([1.0], metadata=OWN))
    assert Detector(path).person_score() == Detector(path).score == 0.4
    with_person_score(path, 0.25)
    changed = Detector(path)
    assert (changed.score, changed.person_score(), changed.layout) == (0.4, 0.25, "hsvaos")
    assert Detector(path, score=0.3).person_score() == 0.3
    assert [p.name for p in tmp_path.iterdir()] == ["own.onnx"]
