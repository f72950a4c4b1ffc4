"""Every layout finds the same red square at its place, through its own input and output."""

from __future__ import annotations

import numpy as np
import pytest

from hsvaos import Detector
from hsvaos.detect.layouts import ALIASES, LAYOUTS
from tests.detect.nets import SIDE, photo_net

PHOTO_LAYOUTS = [name for name in LAYOUTS if name != "hsvaos"]
FREE = ("yolov8", "yolov5", "end2end", "yolox")
"""Layouts whose tiny networks take any size; those of the others count in shares of their own."""
CELLS = {"end2end": (8,)}
"""Strides that a test needs, so that the boxes are not as many as cells."""
CLASSES = {"rfdetr": (91, 1)}
RED, BLUE = (255, 0, 0), (0, 0, 255)


def net(layout: str, **changes: object) -> bytes:
    classes, person = CLASSES.get(layout, (80, 0))
    defaults = {"classes": classes, "person": person, "strides": CELLS.get(layout, (8, 16, 32))}
    return photo_net(layout, **(defaults | changes))  # type: ignore[arg-type]


def cell(layout: str, row: int, column: int) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of what a cell of 8 px shows of a picture of 144 x 108 px."""
    fit = LAYOUTS[layout].fit
    if fit == "stretch":  # 1.5 and 1.125 pixels of the picture are one of the input
        return 12 * column, 9 * row, 12 * column + 12, 9 * row + 9
    above = 18 if fit == "centre" else 0
    return 12 * column, 12 * row - above, 12 * column + 12, 12 * row + 12 - above


def painted(box: tuple[int, int, int, int], colour: tuple[int, int, int]) -> np.ndarray:
    picture = np.zeros((108, 144, 3), np.uint8)
    picture[box[1] : box[3], box[0] : box[2]] = colour
    return picture


@pytest.mark.parametrize(
    ("layout", "dynamic"),
    [*((name, False) for name in PHOTO_LAYOUTS), *((name, True) for name in FREE)],
)
def test_person_is_found_at_its_place(layout: str, dynamic: bool) -> None:
    size = SIDE if dynamic else None
    named = {"layout": layout} if layout == "end2end" and dynamic else {}
    detector = Detector(net(layout, dynamic=dynamic), size_px=size, **named)
    assert detector.layout == layout
    assert detector.provider == "cpu"
    box = cell(layout, 3, 5)
    found = detector.detect(painted(box, RED))
    assert len(found) == 1
    np.testing.assert_allclose(found.boxes_xyxy[0], np.array(box) - 0.5, atol=1e-4)
    assert found.scores[0] > 0.9
    assert found.class_ids.tolist() == [0]
    assert len(detector.detect(painted(box, BLUE))) == 0


@pytest.mark.parametrize("layout", PHOTO_LAYOUTS)
def test_layout_can_be_said(layout: str) -> None:
    names = [layout, *(alias for alias, name in ALIASES.items() if name == layout)]
    for name in names:
        assert Detector(net(layout), name).layout == layout


@pytest.mark.parametrize("layout", PHOTO_LAYOUTS)
def test_batch_equals_one_by_one(layout: str) -> None:
    rng = np.random.default_rng(3)
    views = []
    for _ in range(5):
        box = cell(layout, int(rng.integers(2, 8)), int(rng.integers(0, 11)))
        views.append(painted(box, RED))
    views.insert(2, np.zeros((40, 50, 3), np.uint8))
    for batch in (1, 4, "b"):
        detector = Detector(net(layout, batch=batch))
        together = detector.detect_batch(views)
        assert [len(found) for found in together] == [1, 1, 0, 1, 1, 1]
        for view, found in zip(views, together, strict=True):
            alone = detector.detect(view)
            np.testing.assert_array_equal(found.boxes_xyxy, alone.boxes_xyxy)
            np.testing.assert_array_equal(found.scores, alone.scores)


@pytest.mark.parametrize("layout", PHOTO_LAYOUTS)
def test_large_views_are_cut_and_nothing_is_lost_at_the_seams(layout: str) -> None:
    picture = np.zeros((200, 260, 3), np.uint8)
    places = np.array([(3, 4), (60, 60), (140, 30), (184, 244), (100, 180), (51, 200), (72, 116)])
    for row, column in places:
        picture[row : row + 16, column : column + 16] = RED
    found = Detector(net(layout, batch="b"), iou=0.3).detect(picture)
    centres = (found.boxes_xyxy[:, :2] + found.boxes_xyxy[:, 2:])[:, ::-1] / 2.0
    away = np.abs(centres[:, None] - (places + 7.5)[None]).max(axis=2)
    assert (away.min(axis=0) <= 4.5).all()  # every square has a box at its middle
    assert (away.min(axis=1) <= 8.0).all()  # and nothing else has one
    assert len(Detector(net(layout), slice_px=0, score=0.7).detect(picture)) < len(places)


def test_overlapping_boxes_become_one() -> None:
    rows = Detector(net("yolov5")).detect(painted(cell("yolov5", 3, 5), RED))
    assert len(rows) == 1  # the network gives each box three times
    red = np.full((SIDE, SIDE, 3), RED, np.uint8)
    every = Detector(net("yolov8")).detect(red)
    assert len(every) == 189  # no two cells overlap by 45 percent
    assert len(Detector(net("yolov8"), iou=0.2).detect(red)) < 189
    assert len(Detector(net("yolov8"), max_finds=7).detect(red)) == 7


def test_person_class_by_name_and_number() -> None:
    three = {"names": "{0: 'car', 1: 'Pedestrian', 2: 'people'}", "stride": "32"}
    box = cell("yolov8", 2, 2)
    detector = Detector(net("yolov8", classes=3, person=2, metadata=three))
    assert detector.people == (1, 2)
    assert len(detector.detect(painted(box, RED))) == 1
    assert len(detector.detect(painted(box, BLUE))) == 0
    car = Detector(net("yolov8", classes=3, person=2, metadata=three), person_class="car")
    assert car.people == (0,)
    assert len(car.detect(painted(box, BLUE))) == 1
    assert Detector(net("yolov8", classes=3, person=2), person_class=2).people == (2,)
    assert Detector(net("yolov8", classes=1)).people == (0,)
    assert Detector(net("rfdetr")).people == (1,)
    assert Detector(net("dfine")).notes == (
        "the network names no classes: class 0 is taken for people, as in COCO",
    )


def test_one_class_networks_of_six_values_are_told_apart() -> None:
    assert Detector(net("yolov5", classes=1)).layout == "yolov5"
    assert Detector(net("end2end", classes=1)).layout == "end2end"
    for layout in ("yolov5", "yolox"):
        assert Detector(net(layout, classes=1, dynamic=True)).layout == layout
    # 189 boxes: a cell of 96 x 96 px each, or at most 300 final ones
    with pytest.raises(ValueError, match="may be end2end or yolox; say layout="):
        Detector(net("yolox", classes=1))
    assert Detector(net("yolox", classes=1), "yolox").layout == "yolox"
    # 378 boxes of 6 values fit nothing but what the metadata say
    names = {"names": "{0: 'person', 1: 'car'}", "task": "detect", "end2end": "True"}
    odd = net("end2end", classes=2, strides=(8, 16, 32), metadata=names)
    assert Detector(odd).layout == "end2end"


def test_half_precision() -> None:
    box = cell("yolov8", 3, 5)
    found = Detector(net("yolov8", half=True)).detect(painted(box, RED))
    np.testing.assert_allclose(found.boxes_xyxy[0], np.array(box) - 0.5, atol=0.1)
