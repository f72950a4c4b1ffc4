"""The figures of an evaluation: what counted, rows of tables, points of curves; JSON in and out."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

ALL, UNREACHED, EVERYONE = "all", "unreached", "everyone"
"""Groups beside the occlusion classes: who is reached by rays, who is not, and both together."""


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
            groups count neither way, and where somebody unreached lies any find may; false finds
            count in each group.
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
