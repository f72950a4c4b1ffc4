"""Tables and the picture of the curve."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

from hsvaos.evaluate.evaluation import evaluate_flights
from hsvaos.evaluate.figures import Line, curve_picture, lines_of
from hsvaos.evaluate.measures import CurvePoints, Evaluation, Rules
from hsvaos.evaluate.tables import (
    comparison_table,
    evaluation_csv,
    flight_table,
    markdown_report,
    markdown_table,
)
from tests.evaluate.scenes import perfect
from tests.evaluate.test_evaluation import PEOPLE


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    return evaluate_flights([perfect("x", PEOPLE, extra=2), perfect("y", PEOPLE[:2])])


def test_numbers_stand_to_the_right_and_bars_are_escaped() -> None:
    text = markdown_table(("a", "b"), [("x|y", "1"), ("-", "-")])
    assert text.splitlines() == ["| a | b |", "| --- | ---: |", "| x\\|y | 1 |", "| - | - |"]


def test_csv_has_a_row_for_each_group_and_threshold(evaluation: Evaluation) -> None:
    rows = list(csv.DictReader(io.StringIO(evaluation_csv(evaluation))))
    assert len(rows) == len(evaluation.detection)
    first = rows[0]
    assert (first["group"], first["iou"], first["ap_coco101"]) == ("all", "0.1", "1")
    assert first["person_recall"] == "1"
    assert first["person_false_alarms"] == "2"
    assert first["person_per_flight"] == "1"


def test_report_names_rules_groups_and_flights(evaluation: Evaluation) -> None:
    page = markdown_report(evaluation, "Title", ["one note"])
    assert page.startswith("# Title\n\n- one note\n")
    for text in ("unreached", "everyone", "1.5 unoccluded rays", "within 2 m", "| y |"):
        assert text in page
    widths = {line.count("|") for line in flight_table(evaluation).splitlines()}
    assert len(widths) == 1


def test_methods_side_by_side(evaluation: Evaluation) -> None:
    lines = comparison_table({"ours": evaluation, "theirs": evaluation}).splitlines()
    assert lines[0].startswith("| method | AP 0.10 | AP 0.25 | AP 0.50 |")
    assert lines[2].startswith("| ours | 1.000 | 1.000 | 1.000 |")
    assert comparison_table({"ours": evaluation}, "full").splitlines()[2].startswith("| ours")
    with pytest.raises(ValueError, match="at least one method"):
        comparison_table({})
    with pytest.raises(ValueError, match="nobody of the group 'bush'"):
        comparison_table({"ours": evaluation}, "bush")
    other = evaluate_flights([perfect("x", PEOPLE)], Rules(ious=(0.3,)))
    with pytest.raises(ValueError, match="same thresholds"):
        comparison_table({"ours": evaluation, "theirs": other})


def test_the_curve_is_drawn_where_it_lies() -> None:
    points = CurvePoints(0.5, (0.25, 0.5), (1.0, 0.5), (2.0, 1.0))
    blank = curve_picture([], "title")
    drawn = curve_picture([Line("a", points, 0.4)], "title")
    assert drawn.shape == blank.shape
    assert (drawn[..., 3] == 255).all()
    plot = (blank[52:572, 76:596] != drawn[52:572, 76:596]).any(axis=-1)
    rows, columns = np.nonzero(plot)
    assert rows.max() == pytest.approx(260, abs=6)  # precision .5, with its end mark
    assert columns.max() == pytest.approx(260, abs=6)  # recall .5
    assert rows.min() <= 2
    assert columns.min() <= 2


def test_empty_curves_are_drawn_and_too_many_are_not(evaluation: Evaluation) -> None:
    assert len(lines_of(evaluation)) == 3
    nothing = CurvePoints(0.5, (), (), ())
    assert curve_picture([Line("none", nothing)], "title").shape[2] == 4
    with pytest.raises(ValueError, match="at most 8"):
        curve_picture([Line("a", nothing)] * 9, "title")
