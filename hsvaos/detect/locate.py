"""From boxes in views to persons on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.flight import Origin
from hsvaos.geodesy import geodetic_from_ned

Points = NDArray[np.float64]


def box_places(
    found: Detections, hits: NDArray[np.float32], view: VirtualCamera
) -> tuple[Points, Points]:
    """Return where boxes lie on the focal surface, and how sure that is.

    Args:
        found: Boxes in a view.
        hits: Shape (H, W, 4), focal point of each pixel relative to the view's centre [m] and 1,
            or 0 where there is none, as `kernels.rays.focal_points` gives them.
        view: The view.

    Returns:
        places, shape (K, 3), world NED [m], NaN where a box has no ground; and variances, shape
        (K,) [m^2], of a place spread evenly over the box, one axis.
    """
    height, width = hits.shape[:2]
    places = np.full((len(found), 3), np.nan)
    variances = np.zeros(len(found))

    def point(row: int, column: int) -> Points:
        hit = hits[row, column].astype(np.float64)
        return hit[:3] + view.world_from_camera[:3, 3] if hit[3] > 0.0 else np.full(3, np.nan)

    for k, (left, top, right, bottom) in enumerate(found.boxes_xyxy.astype(np.float64)):
        c = np.clip(np.round([left, (left + right) / 2, right]), 0, width - 1).astype(int)
        r = np.clip(np.round([top, (top + bottom) / 2, bottom]), 0, height - 1).astype(int)
        places[k] = point(r[1], c[1])
        across = point(r[1], c[2]) - point(r[1], c[0])
        along = point(r[2], c[1]) - point(r[0], c[1])
        sides = np.array([np.hypot(*side[:2]) for side in (across, along)])
        if np.isfinite(sides).any():
            variances[k] = np.nanmean(sides**2) / 12.0
    return places, variances


@dataclass(frozen=True, eq=False)
class ViewFinds:
    """The finds of one view, on the ground.

    Args:
        view: The virtual camera.
        found: Its boxes and scores.
        places: Shape (K, 3), world NED [m], NaN where a box has no ground.
        variances: Shape (K,) [m^2], one axis.
    """

    view: VirtualCamera
    found: Detections
    places: Points
    variances: Points


class _Find(NamedTuple):
    score: float
    view: int
    place: Points
    variance: float


def merge_views(
    finds: Sequence[ViewFinds], person_m: float, min_score: float, origin: Origin | None
) -> tuple[Person, ...]:
    """Merge the finds of all views into persons, strongest first.

    From the strongest find down, a find within one person's length of a person already there
    joins it, else it starts a new one. A person lies at the mean of its finds weighted by score;
    its variance is theirs plus their scatter. Views share the error of the poses, so variances
    are not divided by their number. A person's score is the mean of the best score in every view
    whose picture holds its place, with 0 where that view did not find it: noise comes and goes
    with the view, a person stays.

    Args:
        finds: Of each view.
        person_m: Length of a person [m].
        min_score: Score below which a person is left out.
        origin: Ties the local frame to the Earth, or None.
    """
    rows = [
        _Find(float(score), view, place, float(variance))
        for view, one in enumerate(finds)
        for score, place, variance in zip(one.found.scores, one.places, one.variances, strict=True)
        if np.isfinite(place).all()
    ]
    groups: list[list[_Find]] = []
    for row in sorted(rows, key=lambda r: -r.score):
        near = [g for g in groups if np.linalg.norm(row.place[:2] - g[0].place[:2]) <= person_m]
        if near:
            near[0].append(row)
        else:
            groups.append([row])
    persons = [_person(group, finds, origin) for group in groups]
    kept = [person for person in persons if person.score >= min_score]
    return tuple(sorted(kept, key=lambda person: -person.score))


def _person(group: list[_Find], finds: Sequence[ViewFinds], origin: Origin | None) -> Person:
    weights = np.array([find.score for find in group])
    places = np.array([find.place for find in group])
    middle = np.average(places, axis=0, weights=weights)
    scatter = np.average(((places - middle)[:, :2] ** 2).mean(axis=1), weights=weights)
    variance = np.average([find.variance for find in group], weights=weights)
    best: dict[int, float] = {}
    for find in group:
        best[find.view] = max(best.get(find.view, 0.0), find.score)
    holding = sum(_holds(one.view, middle) for one in finds)
    lat, lon = None, None
    if origin is not None:
        latitude, longitude, _ = geodetic_from_ned(middle, origin)
        lat, lon = float(latitude), float(longitude)
    return Person(
        north_m=float(middle[0]),
        east_m=float(middle[1]),
        down_m=float(middle[2]),
        lat_deg=lat,
        lon_deg=lon,
        std_m=float(np.sqrt(variance + scatter)),
        score=sum(best.values()) / max(holding, len(best)),
        views=len(best),
    )


def _holds(view: VirtualCamera, place: Points) -> bool:
    u, v = view.project(place)
    return bool(0.0 <= u <= view.width - 1.0 and 0.0 <= v <= view.height - 1.0)
