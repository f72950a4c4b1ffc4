"""What a method found in one flight, beside the truth: the raw material of an evaluation."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.evaluate.seen import ground_seen_ha
from hsvaos.evaluate.truth import TruthBox, TruthPerson, truth_boxes
from hsvaos.result import Result


class JudgedView(NamedTuple):
    """The finds of one view, and the boxes that are really there.

    Args:
        frame: Name of the view.
        found: Boxes and scores.
        truth: The true boxes, from `truth_boxes` with the view that made the integral image.
    """

    frame: str
    found: Detections
    truth: tuple[TruthBox, ...]


def rendered_views(result: Result) -> list[VirtualCamera]:
    """Return the virtual camera of every view of a run, in the order of `result.views`."""
    number = {frame.name: k for k, frame in enumerate(result.flight.frames)}
    return [
        result.main.view if frame == result.main.frame else result.flight.view(number[frame])
        for frame, _ in result.views
    ]


@dataclass(frozen=True, eq=False)
class FlightResult:
    """What a method found in one flight.

    Args:
        name: Of the flight; unique within an evaluation.
        views: Finds and true boxes of each view; tuples of the three are taken too.
        persons: Finds on the ground, merged over the views.
        people: Who lies there.
        area_ha: Ground that the photos see [ha].

    Raises:
        ValueError: If a box belongs to nobody, two people have one id, or the area is not positive.
    """

    name: str
    views: tuple[JudgedView, ...]
    persons: tuple[Person, ...]
    people: tuple[TruthPerson, ...]
    area_ha: float

    def __post_init__(self) -> None:
        views = tuple(JudgedView(*view) for view in self.views)
        object.__setattr__(self, "views", views)
        object.__setattr__(self, "persons", tuple(self.persons))
        object.__setattr__(self, "people", tuple(self.people))
        ids = [person.id for person in self.people]
        if len(set(ids)) < len(ids):
            raise ValueError(f"{self.name}: two people have the same id, got {', '.join(ids)}")
        strangers = {box.person for view in views for box in view.truth} - set(ids)
        if strangers:
            raise ValueError(f"{self.name}: boxes of nobody: {', '.join(sorted(strangers))}")
        if not 0.0 < self.area_ha < np.inf:
            raise ValueError(f"{self.name}: area_ha must be positive, got {self.area_ha!r}")

    @classmethod
    def from_run(
        cls, result: Result, people: Sequence[TruthPerson], name: str | None = None
    ) -> FlightResult:
        """Return what `hsvaos.run` found; true boxes go through the views that it rendered.

        Args:
            result: The run, best with every stored pose as a view (`view.frame = "all"`).
            people: From `read_truth`.
            name: What to call the flight; its own name if None.
        """
        cameras = rendered_views(result)
        views = tuple(
            JudgedView(frame, found, truth_boxes(people, view))
            for (frame, found), view in zip(result.views, cameras, strict=True)
        )
        area_ha = ground_seen_ha(result.flight, result.surface)
        return cls(name or result.flight.name, views, result.persons, tuple(people), area_ha)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON types."""
        return {
            "name": self.name,
            "area_ha": self.area_ha,
            "people": [
                {
                    "id": person.id,
                    "outline_ned_m": person.outline.tolist(),
                    "occlusion": person.occlusion,
                    "visible": person.visible,
                    "photos": person.photos,
                }
                for person in self.people
            ],
            "persons": [asdict(person) for person in self.persons],
            "views": [
                {
                    "frame": view.frame,
                    "boxes_xyxy": view.found.boxes_xyxy.tolist(),
                    "scores": view.found.scores.tolist(),
                    "class_ids": view.found.class_ids.tolist(),
                    "truth": [asdict(box) for box in view.truth],
                }
                for view in self.views
            ],
        }

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> FlightResult:
        """Return what `to_dict` made.

        Raises:
            ValueError: If it is something else.
        """
        try:
            people = tuple(
                TruthPerson(
                    p["id"],
                    np.array(p["outline_ned_m"], dtype=np.float64),
                    p["occlusion"],
                    float(p["visible"]),
                    float(p["photos"]),
                )
                for p in content["people"]
            )
            persons = tuple(
                Person(**{name: _as_tuple(value) for name, value in person.items()})
                for person in content["persons"]
            )
            views = tuple(
                JudgedView(
                    view["frame"],
                    Detections(
                        np.array(view["boxes_xyxy"], dtype=np.float32).reshape(-1, 4),
                        np.array(view["scores"], dtype=np.float32),
                        np.array(view["class_ids"], dtype=np.int64),
                    ),
                    tuple(
                        TruthBox(box["person"], tuple(box["xyxy"]), float(box["inside"]))
                        for box in view["truth"]
                    ),
                )
                for view in content["views"]
            )
            return cls(content["name"], views, persons, people, float(content["area_ha"]))
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"expected a flight result, got something else ({error!r})") from None

    def to_json(self) -> str:
        """Return it as JSON."""
        return json.dumps(self.to_dict(), ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> FlightResult:
        """Return what `to_json` made.

        Raises:
            ValueError: If it is something else.
        """
        content = json.loads(text)
        if not isinstance(content, dict):
            raise ValueError(f"expected a flight result, got {text:.40}")
        return cls.from_dict(content)


def _as_tuple(value: Any) -> Any:
    """Return lists of JSON as the tuples they were."""
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value
