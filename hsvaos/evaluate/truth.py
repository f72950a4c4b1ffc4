"""The truth of a simulated flight: who lies where, how well the photos see them, and their boxes.

Boxes are left, top, right, bottom in pixels whose centres lie at integers: a shape that fills pixel
3 spans 2.5 to 3.5, and a picture spans -0.5 to its width - 0.5. `Detections` have the same edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.flight import Flight, FlightError
from hsvaos.formats.text import read_json

Array = NDArray[np.float64]

UNSEEN = "unseen"
"""Occlusion class of who is in no photo."""


@dataclass(frozen=True, eq=False)
class TruthPerson:
    """One person who really lies there.

    Args:
        id: Name in truth.json.
        outline: Shape (K, 3), outline seen from above, world NED [m].
        occlusion: Class in truth.json ("full", "half", "bush", "open"), or `UNSEEN`.
        visible: Mean over the photos of the share of the person's pixels that nothing hides, 0..1.
        photos: How many photos have a point of the person in their picture, on average over it.

    Raises:
        ValueError: If the outline is no polygon of finite points, or a number is not usable.
    """

    id: str
    outline: Array
    occlusion: str
    visible: float
    photos: float

    def __post_init__(self) -> None:
        outline = np.asarray(self.outline, dtype=np.float64)
        if outline.ndim != 2 or outline.shape[1:] != (3,) or len(outline) < 3:
            raise ValueError(
                f"{self.id}: outline must be at least 3 points (K, 3), got shape {outline.shape}"
            )
        if not np.isfinite(outline).all():
            raise ValueError(f"{self.id}: outline must be finite, got NaN or infinity")
        if not 0.0 <= self.visible <= 1.0:
            raise ValueError(f"{self.id}: visible must be a share, 0 to 1, got {self.visible!r}")
        if not 0.0 <= self.photos < np.inf:
            raise ValueError(f"{self.id}: photos must be 0 or more, got {self.photos!r}")
        object.__setattr__(self, "outline", outline)

    @property
    def place(self) -> Array:
        """Shape (2,), north and east of the middle of the outline [m]."""
        return np.asarray(0.5 * (self.outline.min(axis=0) + self.outline.max(axis=0))[:2])

    @property
    def rays(self) -> float:
        """Unoccluded rays that reach a point of the person, on average."""
        return self.visible * self.photos


@dataclass(frozen=True)
class TruthBox:
    """A person's box in one view.

    Args:
        person: Its `TruthPerson.id`.
        xyxy: Left, top, right, bottom, clipped to the picture [px].
        inside: Share of the whole box's area that lies in the picture, 0..1.
    """

    person: str
    xyxy: tuple[float, float, float, float]
    inside: float


def truth_box(person: str, outline: ArrayLike, view: VirtualCamera) -> TruthBox | None:
    """Return the box of an outline projected through a view, or None where the view has none of it.

    Args:
        person: The person's id.
        outline: Shape (K, 3), world NED [m].
        view: The view that made the integral image; a photo's own, with distortion, works too.

    Returns:
        The box, clipped to the picture. A person with points that the view cannot show (behind the
        camera) is at its side, not in the picture.
    """
    pixels = view.project(outline)
    if not np.isfinite(pixels).all():
        return None
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    size = np.array(view.size, dtype=np.float64)
    clipped_low, clipped_high = np.maximum(low, -0.5), np.minimum(high, size - 0.5)
    sides = clipped_high - clipped_low
    if not ((sides > 0.0).all() and (high > low).all()):
        return None
    left, top = clipped_low.tolist()
    right, bottom = clipped_high.tolist()
    inside = float(sides.prod() / (high - low).prod())
    return TruthBox(person, (left, top, right, bottom), min(inside, 1.0))


def truth_boxes(people: Sequence[TruthPerson], view: VirtualCamera) -> tuple[TruthBox, ...]:
    """Return the boxes of all people that a view has in its picture, see `truth_box`."""
    boxes = (truth_box(person.id, person.outline, view) for person in people)
    return tuple(box for box in boxes if box is not None)


def truth_file(flight: Flight) -> Path:
    """Return where the truth.json of a flight is, or would be."""
    folder = flight.source if flight.source.is_dir() else flight.source.parent
    return folder / "truth.json"


def read_truth(flight: Flight) -> tuple[TruthPerson, ...]:
    """Read the people of a flight from its truth.json.

    Args:
        flight: The flight, with poses: they say how many photos have a person in their picture.
            Give the same poses for all methods that are compared, the true ones where they are
            known, so that the same people count as reached.

    Raises:
        FlightError: If there is no truth.json, it is malformed or names no people, or the flight
            has no poses.
    """
    people = read_people(truth_file(flight))
    photos = [VirtualCamera(flight.camera, pose) for pose in flight.poses]
    return tuple(_counted(person, photos) for person in people)


def read_people(path: Path) -> tuple[TruthPerson, ...]:
    """Read a truth.json by itself, without the number of photos that have each person.

    Raises:
        FlightError: If it is not there, malformed or names no people.
    """
    if not path.is_file():
        raise FlightError(
            f"{path}: no such file: expected a flight with known truth, such as hsvaos simulate "
            f"writes"
        )
    content = read_json(path)
    entries = content.get("people") if isinstance(content, dict) else None
    if not isinstance(entries, list):
        raise FlightError(f"{path}: expected an object with a list of people")
    if not entries:
        raise FlightError(f"{path}: no people: there is nothing to evaluate")
    people = [_person(entry, f"{path}: people[{k}]") for k, entry in enumerate(entries)]
    if len({person.id for person in people}) < len(people):
        raise FlightError(f"{path}: two people have the same id")
    return tuple(people)


def _person(entry: Any, where: str) -> TruthPerson:
    if not isinstance(entry, dict):
        raise FlightError(f"{where}: expected an object, got {entry!r:.60}")
    missing = [key for key in ("id", "outline_ned_m", "visible_fraction_mean") if key not in entry]
    if missing:
        raise FlightError(f"{where}: lacks {', '.join(missing)}")
    visible, occlusion = entry["visible_fraction_mean"], entry.get("occlusion")
    try:
        outline = np.array(entry["outline_ned_m"], dtype=np.float64)
        share = 0.0 if visible is None else float(visible)
        return TruthPerson(str(entry["id"]), outline, str(occlusion or UNSEEN), share, 0.0)
    except (TypeError, ValueError) as error:
        raise FlightError(f"{where}: {error}") from None


def _counted(person: TruthPerson, photos: Sequence[VirtualCamera]) -> TruthPerson:
    boxes = (truth_box(person.id, person.outline, photo) for photo in photos)
    return replace(person, photos=sum(box.inside for box in boxes if box is not None))
