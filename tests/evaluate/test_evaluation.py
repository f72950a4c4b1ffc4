"""Persons on the ground, groups of people, and whole evaluations."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.evaluate.evaluation import evaluate_flights
from hsvaos.evaluate.measures import Evaluation, Rules
from hsvaos.evaluate.persons import match_persons
from hsvaos.evaluate.results import FlightResult, JudgedView
from hsvaos.evaluate.truth import truth_boxes
from tests.evaluate.scenes import above, detections, find, lying, perfect

PEOPLE = [
    lying("a", 0.0, 0.0, "full", 2.0),
    lying("b", 5.0, 3.0, "half"),
    lying("c", -5.0, 4.0, "open", 18.0),
    lying("d", 4.0, -4.0, "full", 1.0),  # reached by too few rays
]


def test_persons_are_matched_one_to_one_by_score() -> None:
    people = [lying("a", 0.0, 0.0), lying("b", 3.0, 0.0)]
    persons = [find(0.5, 0.0, 4.0), find(0.1, 0.0, 9.0), find(3.0, 1.0, 2.0), find(9.0, 9.0, 8.0)]
    matches, away = match_persons(persons, people, 2.0)
    assert matches.scores.tolist() == [9.0, 8.0, 4.0, 2.0]
    assert matches.truth.tolist() == [0, -1, -1, 1]  # the second find of "a" is a false alarm
    np.testing.assert_allclose(away[[0, 3]], [0.1, 1.0])
    assert matches.positives == 2
    counts = matches.counts()
    assert (counts.tp, counts.fp, counts.fn) == (2, 2, 0)


def test_ignored_persons_count_neither_way() -> None:
    people = [lying("a", 0.0, 0.0), lying("b", 1.0, 0.0)]
    matches, _ = match_persons([find(0.0, 0.0, 2.0)], people, 2.0, [True, False])
    assert matches.truth.tolist() == [1]  # the one to be found, though the other is nearer
    matches, _ = match_persons([find(0.0, 0.0, 2.0)], people[:1], 2.0, [True])
    assert matches.ignored.tolist() == [True]
    assert matches.counts().precision is None


@given(seed=st.integers(0, 1000), radius=st.floats(0.5, 5.0))
def test_matches_are_one_to_one_and_within_the_radius(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    people = [lying(str(k), *rng.uniform(-8, 8, 2)) for k in range(rng.integers(0, 6))]
    persons = [find(*rng.uniform(-8, 8, 2), float(rng.normal())) for _ in range(rng.integers(0, 9))]
    matches, away = match_persons(persons, people, radius)
    taken = matches.truth[matches.truth >= 0]
    assert len(set(taken.tolist())) == len(taken)
    assert (away[matches.truth >= 0] <= radius).all()
    assert np.isnan(away[matches.truth < 0]).all()


def test_perfect_finds_and_who_is_listed_apart() -> None:
    evaluation = evaluate_flights([perfect("x", PEOPLE), perfect("y", PEOPLE[:2])])
    groups = [row.group for row in evaluation.persons]
    assert groups == ["all", "full", "half", "open", "unreached", "everyone"]
    assert len(evaluation.detection) == 3 * len(groups)
    for row in evaluation.detection:
        assert row.ap_coco101 == row.ap_voc11 == row.ap_all == row.precision == row.recall == 1.0
        assert row.fp == row.fn == 0
    boxes = {row.group: row.boxes for row in evaluation.detection if row.iou == 0.25}
    assert boxes == {
        "all": 10, "full": 4, "half": 4, "open": 2, "unreached": 2, "everyone": 12
    }  # fmt: skip
    people = {row.group: row.people for row in evaluation.persons}
    assert people == {
        "all": 5, "full": 2, "half": 2, "open": 1, "unreached": 1, "everyone": 6
    }  # fmt: skip
    for row in evaluation.persons:
        assert row.recall == 1.0
        assert row.false_alarms == 0
        assert row.error_median_m == pytest.approx(0.0, abs=1e-9)
    assert evaluation.area_ha == 1.0
    assert [row.unreached for row in evaluation.flights] == [1, 0]


def test_without_anybody_apart_there_are_no_such_rows() -> None:
    evaluation = evaluate_flights([perfect("x", PEOPLE[1:3])])
    assert [row.group for row in evaluation.persons] == ["all", "half", "open"]


def test_false_finds_count_in_every_class_and_by_area() -> None:
    evaluation = evaluate_flights([perfect("x", PEOPLE, extra=2), perfect("y", PEOPLE)])
    for row in evaluation.detection:
        assert row.fp == 4  # two in each view of one flight
        assert row.ap_coco101 == 1.0  # they are weaker than every hit
    for person in evaluation.persons:
        assert person.false_alarms == 2
        assert person.per_flight == 1.0
        assert person.per_ha == 2.0
    above_them = Rules(score=6.0, person_score=6.0)
    strict = evaluate_flights([perfect("x", PEOPLE, extra=2)], above_them)
    assert all(row.fp == 0 for row in strict.detection)
    assert all(row.false_alarms == 0 for row in strict.persons)


def test_poor_finds_of_the_unreached_are_no_false_finds() -> None:
    people = tuple(PEOPLE[2:])  # "d" is unreached
    truth = truth_boxes(people, above())
    left, top, right, _ = truth[1].xyxy
    poor = [(left, top, right, top + 4.0, 9.0), (left, top + 4.0, right, top + 8.0, 8.0)]
    view = JudgedView("p", detections([*poor, (*truth[0].xyxy, 7.0)]), truth)
    evaluation = evaluate_flights([FlightResult("x", (view,), (), people, 0.5)])
    for group in ("all", "open"):
        row = evaluation.boxes(group, 0.5)
        assert (row.tp, row.fp, row.fn, row.ap_all) == (1, 0, 0, 1.0)
    assert evaluation.boxes("unreached", 0.5).fp == 2  # where they are asked for, they are poor


def test_finds_of_another_class_are_ignored() -> None:
    view = above()
    truth = truth_boxes(PEOPLE[:2], view)
    found = detections([(*truth[0].xyxy, 9.0)])  # "a" only, who is of class full
    result = FlightResult("x", (JudgedView("p", found, truth),), (), tuple(PEOPLE[:2]), 0.5)
    evaluation = evaluate_flights([result])
    half, full = evaluation.boxes("half", 0.25), evaluation.boxes("full", 0.25)
    assert (half.tp, half.fp, half.fn) == (0, 0, 1)
    assert (full.tp, full.fp, full.fn) == (1, 0, 0)
    with pytest.raises(KeyError, match="no row"):
        evaluation.boxes("bush", 0.25)


def test_who_is_cut_by_the_border_need_not_be_found() -> None:
    people = [lying("a", 0.0, 10.1), lying("b", 0.0, 0.0)]
    truth = truth_boxes(people, above())
    assert truth[0].inside == pytest.approx(2.5 / 6.0)
    part = truth[0].xyxy
    rows = [(part[0], part[1], part[2], part[1] + 4.0, 9.0), (*part, 8.0)]
    view = JudgedView("p", detections(rows), truth)
    result = FlightResult("x", (view,), (), tuple(people), 0.5)
    row = evaluate_flights([result]).boxes("all", 0.5)
    assert (row.boxes, row.tp, row.fp, row.fn) == (1, 0, 0, 1)
    row = evaluate_flights([result], Rules(min_inside=0.0)).boxes("all", 0.5)
    assert (row.boxes, row.tp, row.fp, row.fn) == (2, 1, 1, 1)


def test_json_keeps_every_figure() -> None:
    result = perfect("x", PEOPLE, extra=3)
    again = FlightResult.from_json(result.to_json())
    assert again.to_dict() == result.to_dict()
    evaluation = evaluate_flights([result])
    assert evaluate_flights([again]) == evaluation
    assert Evaluation.from_json(evaluation.to_json()) == evaluation
    assert json.loads(evaluation.to_json())["persons"][0]["recall"] == 1.0


def test_nothing_found_is_zero_not_an_error() -> None:
    people = tuple(PEOPLE)
    view = JudgedView("p", detections([]), truth_boxes(people, above()))
    evaluation = evaluate_flights([FlightResult("x", (view,), (), people, 0.5)])
    row = evaluation.boxes("all", 0.25)
    assert (row.ap_coco101, row.recall, row.precision) == (0.0, 0.0, None)
    assert evaluation.persons[0].recall == 0.0
    assert evaluation.persons[0].error_median_m is None
    assert Evaluation.from_json(evaluation.to_json()) == evaluation


def test_bad_input_is_named() -> None:
    good = perfect("x", PEOPLE)
    with pytest.raises(ValueError, match="at least one flight"):
        evaluate_flights([])
    with pytest.raises(ValueError, match="different names"):
        evaluate_flights([good, good])
    with pytest.raises(ValueError, match="no people"):
        evaluate_flights([FlightResult("x", (), (), (), 0.5)])
    with pytest.raises(ValueError, match="boxes of nobody: a"):
        FlightResult("x", good.views, (), tuple(PEOPLE[1:]), 0.5)
    with pytest.raises(ValueError, match="same id"):
        FlightResult("x", (), (), (PEOPLE[0], PEOPLE[0]), 0.5)
    with pytest.raises(ValueError, match="area_ha"):
        FlightResult("x", (), (), (), 0.0)
    with pytest.raises(ValueError, match="flight result"):
        FlightResult.from_json("{}")
    with pytest.raises(ValueError, match="evaluation"):
        Evaluation.from_json("{}")
    with pytest.raises(ValueError, match="radius_m"):
        match_persons([], [], 0.0)
    for wrong in (
        {"ious": ()},
        {"ious": (0.0,)},
        {"ious": (0.5, 0.5)},
        {"score": float("nan")},
        {"radius_m": -1.0},
        {"min_rays": -1.0},
        {"min_inside": 2.0},
        {"most": 0},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            Rules(**wrong)  # type: ignore[arg-type]
