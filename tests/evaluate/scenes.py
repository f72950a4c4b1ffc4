"""People and finds laid out by hand."""

from __future__ import annotations

import numpy as np

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.evaluate.results import FlightResult, JudgedView
from hsvaos.evaluate.truth import TruthPerson, truth_boxes


def lying(
    name: str, north: float, east: float, occlusion: str = "half", rays: float = 10.0
) -> TruthPerson:
    """A person of 1.8 m by 0.6 m on the plane down = 0."""
    sides = np.array([[0.9, 0.3, 0.0], [0.9, -0.3, 0.0], [-0.9, -0.3, 0.0], [-0.9, 0.3, 0.0]])
    return TruthPerson(name, sides + np.array([north, east, 0.0]), occlusion, rays / 20.0, 20.0)


def find(north: float, east: float, score: float) -> Person:
    return Person(north, east, 0.0, None, None, 0.3, score, 5)


def above(north: float = 0.0, east: float = 0.0) -> VirtualCamera:
    """A view straight down from 20 m, picture's top to the north, 0.1 m a pixel, 20 m wide."""
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    pose[:3, 3] = [north, east, -20.0]
    return VirtualCamera(Camera(201, 201, 200.0, 200.0, 100.0, 100.0), pose)


def detections(rows: list[tuple[float, float, float, float, float]]) -> Detections:
    """Boxes with a score each."""
    table = np.array(rows, dtype=np.float32).reshape(-1, 5)
    return Detections(table[:, :4], table[:, 4], np.zeros(len(table), np.int64))


def perfect(name: str, people: list[TruthPerson], extra: int = 0) -> FlightResult:
    """Every person found in two views and on the ground, with some false finds below them."""
    views = []
    for number, view in enumerate((above(), above(1.0, 1.0))):
        truth = truth_boxes(people, view)
        rows = [(*box.xyxy, 50.0 - k) for k, box in enumerate(truth)]
        rows += [(2.0, 10.0 * k, 8.0, 10.0 * k + 5.0, 5.0) for k in range(extra)]
        views.append(JudgedView(f"photo_{number}.jpg", detections(rows), truth))
    persons = [find(*p.place.tolist(), 20.0) for p in people]
    persons += [find(-9.0, -9.0 + 0.1 * k, 3.0) for k in range(extra)]
    return FlightResult(name, tuple(views), tuple(persons), tuple(people), 0.5)
