import re
from xml.etree import ElementTree

import numpy as np
import pytest

from hsvaos.detect.detections import Person
from hsvaos.report.svg import hue_histogram, site_map


def _rects(drawing: str, kind: str) -> list[tuple[float, float]]:
    return [
        (float(r.attrib["x"]), float(r.attrib["width"]))
        for r in ElementTree.fromstring(drawing).iter("rect")
        if r.attrib.get("class") == kind
    ]


def test_map_has_north_up_and_one_scale() -> None:
    track = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 40.0]])
    person = Person(15.0, 20.0, 0.0, None, None, 1.0, 5.0, 2)
    drawing = site_map(track, 1, [np.array([[0, 0], [30, 0], [30, 40.0]])], [person])
    root = ElementTree.fromstring(drawing)
    line = next(e for e in root.iter("polyline")).attrib["points"].split()
    (x0, y0), (x1, y1), (x2, y2) = (tuple(map(float, p.split(","))) for p in line)
    assert x0 == x1
    assert y1 < y0
    assert y2 == y1
    assert (y0 - y1) / 30 == pytest.approx((x2 - x1) / 40, rel=0.01)
    shown = [c for c in root.iter("circle") if c.attrib.get("class") == "shot shown"]
    assert float(shown[0].attrib["cy"]) == y1
    assert [t.text for t in root.iter("text")][:1] == ["1"]


def test_map_of_a_single_place_is_drawn() -> None:
    drawing = site_map(np.array([[5.0, 5.0]]), 0, [], [])
    assert "nan" not in drawing.lower()
    assert "<circle" in drawing


@pytest.mark.parametrize(("mean", "spans"), [(100.0, 1), (10.0, 2), (350.0, 2)])
def test_histogram_greys_exactly_the_removed_hues(mean: float, spans: int) -> None:
    drawing = hue_histogram(np.ones(36), mean, 30.0)
    removed = _rects(drawing, "removed")
    assert len(removed) == spans
    assert sum(width for _, width in removed) == pytest.approx(60.0, abs=0.2)
    inside = [x <= mean <= x + width for x, width in removed]
    assert any(inside)
    assert len(re.findall('class="cut"', drawing)) == 2


def test_histogram_without_a_common_hue_has_no_cuts() -> None:
    drawing = hue_histogram(np.zeros(36), None, None)
    assert "removed" not in drawing
    assert 'class="mean"' not in drawing
    ElementTree.fromstring(drawing)
