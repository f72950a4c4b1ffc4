"""The finds as data: detections.json and detections.geojson."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

from hsvaos.detect.detections import Detections, Person
from hsvaos.flight import Origin
from hsvaos.result import Result

_LOCAL_NOTE = (
    "The flight has no WGS-84 origin, so these finds have no place on Earth: geometry is null and "
    "the local coordinates (north, east, down in metres) are in the properties."
)


def detections_json(result: Result) -> str:
    """Return the content of detections.json: boxes of every view, and persons on the ground."""
    return views_json(result.views, result.persons)


def views_json(views: Iterable[tuple[str, Detections]], persons: Iterable[Person] = ()) -> str:
    """Return the content of detections.json.

    Args:
        views: Frame name and boxes of each view.
        persons: On the ground.
    """
    return _dump(
        {
            "views": [{"frame": frame, "boxes": _boxes(found)} for frame, found in views],
            "persons": [person_record(person) for person in persons],
        }
    )


def detections_geojson(result: Result) -> str:
    """Return the content of detections.geojson, see `persons_geojson`."""
    return persons_geojson(result.persons, result.flight.origin)


def persons_geojson(persons: Iterable[Person], origin: Origin | None) -> str:
    """Return persons as GeoJSON (RFC 7946, WGS-84): one point a person.

    GeoJSON knows no local coordinates. Without an origin every feature is "unlocated" (geometry
    null, which the standard allows), has its local place in the properties, and a note says why.

    Args:
        persons: On the ground.
        origin: Ties the local frame to the Earth, or None.
    """
    collection: dict[str, Any] = {"type": "FeatureCollection"}
    if origin is None:
        collection["note"] = _LOCAL_NOTE
    collection["features"] = [
        {
            "type": "Feature",
            "id": number,
            "geometry": _point(person),
            "properties": person_record(person),
        }
        for number, person in enumerate(persons, start=1)
    ]
    return _dump(collection)


def _boxes(found: Detections) -> list[dict[str, Any]]:
    return [
        {"xyxy": [_number(v) for v in box], "score": _number(score)}
        for box, score in zip(found.boxes_xyxy.tolist(), found.scores.tolist(), strict=True)
    ]


def person_record(person: Person) -> dict[str, Any]:
    """Return a person as the files hold one."""
    return {
        "north_m": _number(person.north_m),
        "east_m": _number(person.east_m),
        "down_m": _number(person.down_m),
        "lat_deg": _number(person.lat_deg),
        "lon_deg": _number(person.lon_deg),
        "std_m": _number(person.std_m),
        "covariance_m2": None
        if person.covariance_m2 is None
        else [[_number(value) for value in row] for row in person.covariance_m2],
        "score": _number(person.score),
        "views": int(person.views),
    }


def _point(person: Person) -> dict[str, Any] | None:
    if person.lat_deg is None or person.lon_deg is None:
        return None
    # Nine decimals are a tenth of a millimetre; more would only pretend.
    return {
        "type": "Point",
        "coordinates": [round(float(person.lon_deg), 9), round(float(person.lat_deg), 9)],
    }


def _number(value: float | None) -> float | None:
    """Return a JSON number; JSON has no NaN, so what is not finite becomes null."""
    return None if value is None or not math.isfinite(value) else float(value)


def _dump(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
