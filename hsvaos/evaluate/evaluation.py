"""From the results of flights to figures: boxes in views, persons on the ground, flight by flight.

results = [FlightResult.from_run(run(flight, settings), read_truth(flight)) for flight in ...]
evaluation = evaluate_flights(results)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hsvaos.evaluate.detection import Curve, Matches, match_boxes
from hsvaos.evaluate.measures import (
    ALL,
    EVERYONE,
    UNREACHED,
    CurvePoints,
    DetectionRow,
    Evaluation,
    FlightRow,
    PersonRow,
    Rules,
)
from hsvaos.evaluate.persons import match_persons
from hsvaos.evaluate.results import FlightResult, JudgedView
from hsvaos.evaluate.truth import TruthPerson

CLASSES = ("full", "half", "bush", "open")
"""Occlusion classes in the order of tables; others follow."""

_CURVE_POINTS = 201


Chosen = Callable[[TruthPerson], bool]


def evaluate_flights(results: Sequence[FlightResult], rules: Rules | None = None) -> Evaluation:
    """Evaluate what one method found in some flights, all flights as one set.

    Args:
        results: One for each flight.
        rules: What counts.

    Raises:
        ValueError: If there is no flight, two have the same name, or there are no people.
    """
    rules = Rules() if rules is None else rules
    names = [result.name for result in results]
    if not names:
        raise ValueError("expected results of at least one flight, got none")
    if len(set(names)) < len(names):
        raise ValueError(f"flights must have different names, got {', '.join(sorted(names))}")
    people = [person for result in results for person in result.people]
    if not people:
        raise ValueError("there are no people in any flight: there is nothing to evaluate")
    groups = _groups(people, rules)
    whole = [(iou, _boxes(results, groups[ALL], iou, rules)) for iou in rules.ious]
    return Evaluation(
        rules,
        sum(result.area_ha for result in results),
        tuple(
            _detection_row(group, iou, _boxes(results, chosen, iou, rules), rules)
            for group, chosen in groups.items()
            for iou in rules.ious
        ),
        tuple(_person_row(group, results, chosen, rules) for group, chosen in groups.items()),
        tuple(_flight_row(result, groups[ALL], rules) for result in results),
        tuple(_points(iou, matches.curve()) for iou, matches in whole),
    )


def _groups(people: Sequence[TruthPerson], rules: Rules) -> dict[str, Chosen]:
    """Return who belongs to each group; occlusion classes hold only those who are reached."""

    def reached(person: TruthPerson) -> bool:
        return person.rays >= rules.min_rays

    def of_class(name: str) -> Chosen:
        return lambda person: reached(person) and person.occlusion == name

    there = {person.occlusion for person in people if reached(person)}
    ordered = [*(c for c in CLASSES if c in there), *sorted(there - set(CLASSES))]
    groups: dict[str, Chosen] = {ALL: reached} | {name: of_class(name) for name in ordered}
    if not all(reached(person) for person in people):
        groups |= {UNREACHED: lambda person: not reached(person), EVERYONE: lambda person: True}
    return groups


def _boxes(results: Sequence[FlightResult], chosen: Chosen, iou: float, rules: Rules) -> Matches:
    parts = []
    for result in results:
        wanted = {person.id for person in result.people if chosen(person)}
        unreached = {person.id for person in result.people if person.rays < rules.min_rays}
        apart = unreached - wanted
        parts += [_view_boxes(view, wanted, apart, iou, rules) for view in result.views]
    return Matches.join(parts)


def _view_boxes(
    view: JudgedView, wanted: set[str], apart: set[str], iou: float, rules: Rules
) -> Matches:
    truth = np.array([box.xyxy for box in view.truth], dtype=np.float64).reshape(-1, 4)
    return match_boxes(
        view.found.boxes_xyxy,
        view.found.scores,
        truth,
        iou,
        ignore=[box.person not in wanted for box in view.truth],
        # of whom nothing is asked, any part may be found, any number of times
        regions=[box.inside < rules.min_inside or box.person in apart for box in view.truth],
        most=rules.most,
    )


def _detection_row(group: str, iou: float, matches: Matches, rules: Rules) -> DetectionRow:
    curve, counts = matches.curve(), matches.counts(rules.score)
    return DetectionRow(
        group=group,
        iou=iou,
        boxes=matches.positives,
        ap_coco101=curve.ap_coco101,
        ap_voc11=curve.ap_voc11,
        ap_all=curve.ap_all,
        tp=counts.tp,
        fp=counts.fp,
        fn=counts.fn,
        precision=counts.precision,
        recall=counts.recall,
    )


def _person_row(
    group: str, results: Sequence[FlightResult], chosen: Chosen, rules: Rules
) -> PersonRow:
    pairs = [_persons(result, chosen, rules) for result in results]
    matches = Matches.join([matches for matches, _ in pairs])
    counts = matches.counts(rules.person_score)
    errors = _errors(pairs, rules)
    return PersonRow(
        group=group,
        people=matches.positives,
        found=counts.tp,
        recall=counts.recall,
        false_alarms=counts.fp,
        precision=counts.precision,
        per_flight=counts.fp / len(results),
        per_ha=counts.fp / sum(result.area_ha for result in results),
        ap_all=matches.curve().ap_all,
        error_median_m=_percentile(errors, 50.0),
        error_p90_m=_percentile(errors, 90.0),
    )


def _persons(
    result: FlightResult, chosen: Chosen, rules: Rules
) -> tuple[Matches, np.ndarray[Any, np.dtype[np.float64]]]:
    skip = [not chosen(person) for person in result.people]
    return match_persons(result.persons, result.people, rules.radius_m, skip)


def _errors(pairs: Sequence[tuple[Matches, Any]], rules: Rules) -> Any:
    least = -np.inf if rules.person_score is None else rules.person_score
    parts = [away[matches.hit & (matches.scores >= least)] for matches, away in pairs]
    return np.concatenate(parts)


def _percentile(values: Any, percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


def _flight_row(result: FlightResult, chosen: Chosen, rules: Rules) -> FlightRow:
    matched = [_boxes([result], chosen, iou, rules) for iou in rules.ious]
    matches, away = _persons(result, chosen, rules)
    counts = matches.counts(rules.person_score)
    return FlightRow(
        flight=result.name,
        views=len(result.views),
        boxes=matched[0].positives,
        ap_coco101=tuple(matches.curve().ap_coco101 for matches in matched),
        people=matches.positives,
        unreached=len(result.people) - matches.positives,
        found=counts.tp,
        false_alarms=counts.fp,
        area_ha=result.area_ha,
        error_median_m=_percentile(_errors([(matches, away)], rules), 50.0),
    )


def _points(iou: float, curve: Curve) -> CurvePoints:
    """Return some 400 points of a curve: by recall, and by rank where recall stands still."""
    count = len(curve.scores) if curve.positives else 0
    ranks = np.linspace(0, count - 1, min(count, _CURVE_POINTS)).round()
    # where a hit comes: many weak finds must not leave the head of the curve without points
    hits = np.flatnonzero(np.diff(curve.recall[:count], prepend=0.0) > 0.0)
    chosen = np.linspace(0, len(hits) - 1, min(len(hits), _CURVE_POINTS)).round().astype(int)
    at = np.unique(np.concatenate([ranks.astype(int), hits[chosen]]))
    return CurvePoints(
        iou,
        tuple(curve.recall[at].tolist()),
        tuple(curve.precision[at].tolist()),
        tuple(curve.scores[at].tolist()),
    )
