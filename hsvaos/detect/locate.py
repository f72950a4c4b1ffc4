"""From boxes in views to persons on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.flight import Origin
from hsvaos.geodesy import geodetic_from_ned

Points = NDArray[np.float64]

_LEAST_WEIGHT = 1e-6
"""Of a find in a mean: scores of 0 have no sum to divide by."""


def box_places(
    found: Detections,
    hits: NDArray[np.float32],
    view: VirtualCamera,
    pose_covariance: ArrayLike | None = None,
) -> tuple[Points, Points]:
    """Return where boxes lie on the focal surface, and how sure that is.

    Args:
        found: Boxes in a view.
        hits: Shape (H, W, 4), focal point of each pixel relative to the view's centre [m] and 1,
            or 0 where there is none, as `kernels.rays.focal_points` gives them.
        view: The view.
        pose_covariance: Shape (6, 6), of the view's pose: north, east, down [m], then the rotation
            vector of the attitude error about them [rad], as `Trajectory.camera_covariance` gives
            it. By default the pose is taken as known.

    Returns:
        places, shape (K, 3), world NED [m], NaN where a box has no ground; and covariances, shape
        (K, 2, 2), north and east [m^2]: of a place spread evenly over the box on the surface, plus
        what the pose makes of it.

    Raises:
        ValueError: If the pose's covariance is none, or the view is a ground grid and has no pose.
    """
    height, width = hits.shape[:2]
    places = np.full((len(found), 3), np.nan)
    covariances = np.zeros((len(found), 2, 2))
    pose = None if pose_covariance is None else _checked_covariance(pose_covariance, view)

    def point(row: int, column: int) -> Points:
        hit = hits[row, column].astype(np.float64)
        return hit[:3] + view.world_from_camera[:3, 3] if hit[3] > 0.0 else np.full(3, np.nan)

    for k, (left, top, right, bottom) in enumerate(found.boxes_xyxy.astype(np.float64)):
        c = np.clip(np.round([left, (left + right) / 2, right]), 0, width - 1).astype(int)
        r = np.clip(np.round([top, (top + bottom) / 2, bottom]), 0, height - 1).astype(int)
        places[k] = point(r[1], c[1])
        across = point(r[1], c[2]) - point(r[1], c[0])
        along = point(r[2], c[1]) - point(r[0], c[1])
        covariances[k] = _even_spread(across[:2], along[:2])
        if pose is not None and np.isfinite(places[k]).all():
            covariances[k] += _from_pose(places[k] - view.world_from_camera[:3, 3], pose)
    return places, covariances


def pose_spread(
    places: ArrayLike, camera: Camera, world_from_camera: ArrayLike, covariances: ArrayLike
) -> Points:
    """Return what errors of the photos' poses make of places that an integral image shows.

    A place is where the mean of the rays of the photos that hold it puts it. Photos of one flight
    err alike, so the covariance of that mean is the mean of theirs, however many they are.

    Args:
        places: Shape (K, 3), on the focal surface, world NED [m]; may be NaN.
        camera: Of the photos.
        world_from_camera: Shape (N, 4, 4), poses of the photos.
        covariances: Shape (N, 6, 6), of the poses, see `flight.Frame`.

    Returns:
        Shape (K, 2, 2), north and east [m^2]; 0 for places that no photo holds.
    """
    points = np.asarray(places, dtype=np.float64).reshape(-1, 3)
    poses = np.asarray(world_from_camera, dtype=np.float64)
    spreads = np.asarray(covariances, dtype=np.float64)
    found = np.zeros((len(points), 2, 2))
    for k, place in enumerate(points):
        if not np.isfinite(place).all():
            continue
        rays = place - poses[:, :3, 3]
        pixels = camera.project(np.einsum("nji,nj->ni", poses[:, :3, :3], rays))
        inside = ((pixels >= -0.5) & (pixels <= [camera.width - 0.5, camera.height - 0.5])).all(1)
        holding = np.flatnonzero(inside & (rays[:, 2] > 0.0))
        if holding.size:
            found[k] = np.mean([_from_pose(rays[n], spreads[n]) for n in holding], axis=0)
    return found


def _even_spread(across: Points, along: Points) -> Points:
    """Covariance of a point anywhere in a parallelogram; of a square where a side is not known."""
    known = [side for side in (across, along) if np.isfinite(side).all()]
    if len(known) == 2:
        return np.asarray((np.outer(across, across) + np.outer(along, along)) / 12.0)
    square = sum(float(side @ side) for side in known) / 12.0
    return np.eye(2) * square


def _from_pose(ray: Points, pose: Points) -> Points:
    """Covariance of where a ray meets level ground, from that of the pose it starts from.

    With the ray r from the camera to the ground and n = down, an error of position and attitude
    moves the place by P (e_p - [r]x e_phi), P = I - r n' / (n r): along the ray back onto the
    ground.
    """
    x, y, z = ray
    slide = np.array([[1.0, 0.0, -x / z], [0.0, 1.0, -y / z]])
    turn = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # -[r]x
    J = slide @ np.hstack([np.eye(3), turn])
    return np.asarray(J @ pose @ J.T)


def _checked_covariance(values: ArrayLike, view: VirtualCamera) -> Points:
    if view.is_ortho:
        raise ValueError("pose_covariance: a ground grid is taken from no pose, expected None")
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
        raise ValueError(f"pose_covariance must be 6 x 6 finite numbers, got shape {matrix.shape}")
    return matrix


@dataclass(frozen=True, eq=False)
class ViewFinds:
    """The finds of one view, on the ground.

    Args:
        view: The virtual camera.
        found: Its boxes and scores: probabilities of a network, or local z of peaks.
        places: Shape (K, 3), world NED [m], NaN where a box has no ground.
        covariances: Shape (K, 2, 2), north and east [m^2].
    """

    view: VirtualCamera
    found: Detections
    places: Points
    covariances: Points

    def above(self, score: float) -> ViewFinds:
        """Return those that score at least so much."""
        kept = self.found.scores >= score
        places, covariances = self.places[kept], self.covariances[kept]
        return ViewFinds(self.view, self.found.above(score), places, covariances)


class _Find(NamedTuple):
    score: float
    view: int
    place: Points
    covariance: Points


def merge_views(
    finds: Sequence[ViewFinds], person_m: float, min_score: float, origin: Origin | None
) -> tuple[Person, ...]:
    """Merge the finds of all views into persons, strongest first.

    From the strongest find down, a find within one person's length of a person already there
    joins it, else it starts a new one. A person lies at the mean of its finds weighted by score;
    its covariance is theirs plus their scatter. Views share the error of the poses, so covariances
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
        _Find(float(score), view, place, covariance)
        for view, one in enumerate(finds)
        for score, place, covariance in zip(
            one.found.scores, one.places, one.covariances, strict=True
        )
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
    weights = np.array([max(find.score, _LEAST_WEIGHT) for find in group])
    places = np.array([find.place for find in group])
    middle = np.average(places, axis=0, weights=weights)
    away = (places - middle)[:, :2]
    scatter = np.average(away[:, :, None] * away[:, None, :], axis=0, weights=weights)
    spread = np.average([find.covariance for find in group], axis=0, weights=weights) + scatter
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
        std_m=float(np.sqrt(np.trace(spread) / 2.0)),
        score=sum(best.values()) / max(holding, len(best)),
        views=len(best),
        covariance_m2=(
            (float(spread[0, 0]), float(spread[0, 1])),
            (float(spread[1, 0]), float(spread[1, 1])),
        ),
    )


def _holds(view: VirtualCamera, place: Points) -> bool:
    u, v = view.project(place)
    return bool(0.0 <= u <= view.width - 1.0 and 0.0 <= v <= view.height - 1.0)
