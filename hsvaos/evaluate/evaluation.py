"""From the results of flights to figures: boxes in views, persons on the ground, flight by flight.

results = [FlightResult.from_run(run(flight, settings), read_truth(flight)) for flight in ...]
evaluation = evaluate_flights(results)
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from hsvaos.evaluate.detection import Curve, Matches, match_boxes
from hsvaos.evaluate.persons import match_persons
from hsvaos.evaluate.results import FlightResult, JudgedView
from hsvaos.evaluate.truth import TruthPerson

ALL, UNREACHED, EVERYONE = "all", "unreached", "all and unreached"
"""Groups beside the occlusion classes: who is reached by rays, who is not, and both together."""

CLASSES = ("full", "half", "bush", "open")
"""Occlusion classes in the order of tables; others follow."""

_CURVE_POINTS = 201


@dataclass(frozen=True)
class Rules:
    """What counts.

    Args:
        ious: Thresholds of intersection over union.
        score: Least score of a box for hits, false finds and misses; all count if None. Curves and
            average precision take all anyway.
        person_score: The same for persons on the ground.
        radius_m: Greatest horizontal distance of a person found to the true one [m].
        min_rays: People reached by fewer unoccluded rays a point on average are listed apart.
        min_inside: Share of a person's box that a view must hold; less is ignored there.
        most: Strongest boxes that count in a view.

    Raises:
        ValueError: If a value is out of range.
    """

    ious: tuple[float, ...] = (0.10, 0.25, 0.50)
    score: float | None = None
    person_score: float | None = None
    radius_m: float = 2.0
    min_rays: float = 1.5
    min_inside: float = 0.5
    most: int = 100

    def __post_init__(self) -> None:
        object.__setattr__(self, "ious", tuple(self.ious))
        if not self.ious or not all(0.0 < iou <= 1.0 for iou in self.ious):
            raise ValueError(f"ious must be above 0 and at most 1, got {self.ious!r}")
        if len(set(self.ious)) < len(self.ious):
            raise ValueError(f"ious must differ, got {self.ious!r}")
        for name, value in (("score", self.score), ("person_score", self.person_score)):
            if value is not None and not np.isfinite(value):
                raise ValueError(f"{name} must be a finite number, got {value!r}")
        if not 0.0 < self.radius_m < np.inf:
            raise ValueError(f"radius_m must be a positive length, got {self.radius_m!r}")
        if not 0.0 <= self.min_rays < np.inf:
            raise ValueError(f"min_rays must be 0 or more, got {self.min_rays!r}")
        if not 0.0 <= self.min_inside <= 1.0:
            raise ValueError(f"min_inside must be a share, 0 to 1, got {self.min_inside!r}")
        if self.most < 1:
            raise ValueError(f"most must be at least 1, got {self.most!r}")


@dataclass(frozen=True)
class DetectionRow:
    """Boxes of one group of people at one threshold. None where there is nothing to count.

    Args:
        group: An occlusion class, or `ALL`, `UNREACHED`, `EVERYONE`. Finds of people of other
            groups count neither way; false finds count in each group.
        iou: Threshold.
        boxes: True boxes to be found.
        ap_coco101: Average precision at 101 recalls.
        ap_voc11: At 11 recalls.
        ap_all: At all.
        tp: Hits at the score threshold.
        fp: False finds.
        fn: Misses.
        precision: tp / (tp + fp).
        recall: tp / (tp + fn).
    """

    group: str
    iou: float
    boxes: int
    ap_coco101: float | None
    ap_voc11: float | None
    ap_all: float | None
    tp: int
    fp: int
    fn: int
    precision: float | None
    recall: float | None


@dataclass(frozen=True)
class PersonRow:
    """Persons on the ground of one group. None where there is nothing to count.

    Args:
        group: As for `DetectionRow`.
        people: To be found.
        found: Found within the radius, at the score threshold.
        recall: found / people.
        false_alarms: Finds of nobody, or of somebody found already.
        precision: found / (found + false_alarms).
        per_flight: False alarms a flight.
        per_ha: False alarms a hectare of ground seen.
        ap_all: Average precision over the whole range of scores.
        error_median_m: Median horizontal distance of the found to the truth [m].
        error_p90_m: 90th percentile of it [m].
    """

    group: str
    people: int
    found: int
    recall: float | None
    false_alarms: int
    precision: float | None
    per_flight: float
    per_ha: float
    ap_all: float | None
    error_median_m: float | None
    error_p90_m: float | None


@dataclass(frozen=True)
class FlightRow:
    """One flight, people that are reached.

    Args:
        flight: Its name.
        views: Views with finds and truth.
        boxes: True boxes to be found.
        ap_coco101: Average precision at each threshold of the rules.
        people: To be found.
        unreached: People listed apart.
        found: People found.
        false_alarms: Persons found that are none.
        area_ha: Ground seen [ha].
        error_median_m: Median horizontal distance [m].
    """

    flight: str
    views: int
    boxes: int
    ap_coco101: tuple[float | None, ...]
    people: int
    unreached: int
    found: int
    false_alarms: int
    area_ha: float
    error_median_m: float | None


@dataclass(frozen=True)
class CurvePoints:
    """A precision-recall curve to draw, for the people that are reached.

    Args:
        iou: Threshold.
        recall: Rising.
        precision: As measured, without envelope.
        score: Of each point.
    """

    iou: float
    recall: tuple[float, ...]
    precision: tuple[float, ...]
    score: tuple[float, ...]


@dataclass(frozen=True)
class Evaluation:
    """The figures of one method over some flights.

    Args:
        rules: What counted.
        area_ha: Ground seen in all flights [ha].
        detection: Boxes, a row for each group and threshold.
        persons: Persons, a row for each group.
        flights: A row for each flight.
        curves: A curve for each threshold.
    """

    rules: Rules
    area_ha: float
    detection: tuple[DetectionRow, ...]
    persons: tuple[PersonRow, ...]
    flights: tuple[FlightRow, ...]
    curves: tuple[CurvePoints, ...] = field(repr=False)

    def boxes(self, group: str, iou: float) -> DetectionRow:
        """Return the row of a group at a threshold.

        Raises:
            KeyError: If there is none.
        """
        for row in self.detection:
            if row.group == group and row.iou == iou:
                return row
        raise KeyError(f"no row for {group!r} at IoU {iou}")

    def to_json(self) -> str:
        """Return it as JSON."""
        return json.dumps(asdict(self), indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Evaluation:
        """Return what `to_json` made.

        Raises:
            ValueError: If it is something else.
        """
        content = json.loads(text)
        try:
            return cls(
                Rules(**content["rules"]),
                float(content["area_ha"]),
                tuple(DetectionRow(**row) for row in content["detection"]),
                tuple(PersonRow(**row) for row in content["persons"]),
                tuple(FlightRow(**_tuples(row)) for row in content["flights"]),
                tuple(CurvePoints(**_tuples(row)) for row in content["curves"]),
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"expected an evaluation, got something else ({error!r})") from None


def _tuples(row: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(v) if isinstance(v, list) else v for name, v in row.items()}


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
        parts += [_view_boxes(view, wanted, iou, rules) for view in result.views]
    return Matches.join(parts)


def _view_boxes(view: JudgedView, wanted: set[str], iou: float, rules: Rules) -> Matches:
    truth = np.array([box.xyxy for box in view.truth], dtype=np.float64).reshape(-1, 4)
    return match_boxes(
        view.found.boxes_xyxy,
        view.found.scores,
        truth,
        iou,
        ignore=[box.person not in wanted for box in view.truth],
        # of somebody at the border any part may be found, and need not
        regions=[box.inside < rules.min_inside for box in view.truth],
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
    """Return at most 201 points of a curve; the drops between them are too fine to be seen."""
    count = len(curve.scores) if curve.positives else 0
    at = np.unique(np.linspace(0, count - 1, min(count, _CURVE_POINTS)).round().astype(int))
    return CurvePoints(
        iou,
        tuple(curve.recall[at].tolist()),
        tuple(curve.precision[at].tolist()),
        tuple(curve.scores[at].tolist()),
    )
