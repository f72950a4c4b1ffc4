"""From boxes in views to persons on the ground."""

from __future__ import annotations

from collections.abc import Sequence

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


def merge_views(
    finds: Sequence[tuple[Detections, Points, Points]],
    person_m: float,
    origin: Origin | None,
) -> tuple[Person, ...]:
    """Merge the finds of all views into persons, strongest first.

    From the strongest find down, a find within one person's length of a person already there
    joins it, else it starts a new one. A person lies at the mean of its finds weighted by score;
    its variance is theirs plus their scatter. Views share the error of the poses, so variances
    are not divided by their number.

    Args:
        finds: Detections, places and variances (see `box_places`) of each view.
        person_m: Length of a person [m].
        origin: Ties the local frame to the Earth, or None.
    """
    rows = [
        (float(score), view, place, variance)
        for view, (found, places, variances) in enumerate(finds)
        for score, place, variance in zip(found.scores, places, variances, strict=True)
        if np.isfinite(place).all()
    ]
    groups: list[list[tuple[float, int, Points, float]]] = []
    for row in sorted(rows, key=lambda r: -r[0]):
        near = [g for g in groups if np.linalg.norm(row[2][:2] - g[0][2][:2]) <= person_m]
        if near:
            near[0].append(row)
        else:
            groups.append([row])
    return tuple(_person(group, origin) for group in groups)


def _person(group: list[tuple[float, int, Points, float]], origin: Origin | None) -> Person:
    weights = np.array([score for score, *_ in group])
    places = np.array([place for _, _, place, _ in group])
    middle = np.average(places, axis=0, weights=weights)
    scatter = np.average(((places - middle)[:, :2] ** 2).mean(axis=1), weights=weights)
    variance = np.average([variance for *_, variance in group], weights=weights)
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
        score=float(weights.max()),
        views=len({view for _, view, *_ in group}),
    )
