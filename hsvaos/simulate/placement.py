"""Where people lie: places chosen by how much of them the photos will see, then measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.simulate.forest import Forest
from hsvaos.simulate.instances import Instances, Kind
from hsvaos.simulate.occlusion import (
    CLASSES,
    LEAST_PIXELS,
    VisibilityMap,
    measure_people,
    smooth,
    visibility_map,
)
from hsvaos.simulate.people import Person, lay_person, stake_mesh

Array = NDArray[np.float64]

_APART_M = 4.0
_ROUNDS = 6
_CLEARINGS_M = (11.0, 14.0, 17.0, 20.0)
_ROOM_M = 2.0
_AIM = {"full": (0.0, 0.045), "half": (0.36, 0.60), "bush": (0.45, 0.95), "open": (0.97, 1.01)}
"""Ranges of the map that are tried first; the map is of the ground, the classes of the body."""


@dataclass(frozen=True, eq=False)
class Cast:
    """The people of a flight and the instances they are.

    Args:
        people: Who lies where.
        forest: The forest, with a clearing where one was needed.
        instances: The forest with them (and their bushes) in it.
        number: Instance number of each person.
        bush: Whether a bush was put over each.
        visible: Mean visible fraction of each over the photos; NaN where it was not measured.
    """

    people: tuple[Person, ...]
    forest: Forest
    instances: Instances
    number: tuple[int, ...]
    bush: tuple[bool, ...]
    visible: tuple[float, ...]


def _with_people(forest: Forest, people: Sequence[Person], bush: Sequence[bool]) -> Cast:
    instances = forest.instances.copy()
    numbers = []
    for person, covered in zip(people, bush, strict=True):
        mesh = instances.add_mesh(person.mesh)
        numbers.append(instances.add(mesh, Kind.PERSON, np.eye(3), person.place))
        if covered:
            rng = np.random.default_rng([forest.settings.seed, 91, person.number])
            over = forest.bush_mesh[int(rng.integers(len(forest.bush_mesh)))]
            middle = person.outline[:, :2].mean(axis=0)
            place = (*middle, float(forest.ground.down_at(*middle)))
            instances.add(over, Kind.BUSH, np.eye(3) * 1.15, place)
    return Cast(tuple(people), forest, instances, tuple(numbers), tuple(bush), ())


def add_stakes(instances: Instances, forest: Forest, places: Array) -> Array:
    """Add survey stakes and return their plates' centres, shape (S, 3), NED [m].

    Args:
        instances: Changed in place.
        forest: For its ground.
        places: Shape (S, 2), north and east [m].
    """
    height = 0.5
    mesh = instances.add_mesh(stake_mesh(height))
    tops = []
    for north, east in places:
        top = np.array([north, east, float(forest.ground.down_at(north, east)) - height])
        instances.add(mesh, Kind.STAKE, np.eye(3), top)
        tops.append(top)
    return np.array(tops).reshape(-1, 3)


def place_people(
    forest: Forest,
    camera: Camera,
    poses: Array,
    half_m: tuple[float, float],
    count: int,
    *,
    classes: Sequence[str] | None = None,
    tops: Sequence[str] | None = None,
    places: Sequence[tuple[float, float]] | None = None,
    fresh: bool = False,
    measure: bool = True,
    device: str = "cpu",
) -> Cast:
    """Lay people where their occlusion class is met.

    A map of the ground's visibility proposes places; the people's visible fraction is then
    measured in the photos, and who misses the class is laid elsewhere, a few times over. For
    people in the open a clearing is cut where the forest is thinnest, if it has none.

    Args:
        forest: Where.
        camera: Of the photos.
        poses: Shape (N, 4, 4), planned world_from_camera.
        half_m: Half the extent of the photo places, north and east [m].
        count: How many people.
        classes: Class of each person in turn (see `CLASSES`); if None they take turns through all
            classes, and one that this forest cannot give is replaced by what it can.
        tops: Colour of the top of each person in turn; any if None.
        places: North and east of each person [m], to lay them just there: nothing is then sought
            or cut, and classes only say who lies under a bush.
        fresh: New ragdolls instead of the pose library.
        measure: Whether to measure how visible people at given `places` are; it costs a few
            seconds, and the photos tell it again. Where places are sought it is always done.
        device: Warp device.

    Raises:
        ValueError: If a class is unknown, or asked for by name and not reached.
    """
    if int(count) != count or count < 0:
        raise ValueError(f"people must be a whole number of at least 0, got {count!r}")
    asked = (
        []
        if not count
        else [(classes or tuple(CLASSES))[k % len(classes or CLASSES)] for k in range(count)]
    )
    for name in asked:
        if name not in CLASSES:
            raise ValueError(f"classes must be among {', '.join(CLASSES)}, got {name!r}")
    if not count:
        return Cast((), forest, forest.instances, (), (), ())

    def lay(k: int, north: float, east: float) -> Person:
        top = tops[k % len(tops)] if tops else None
        seed = forest.settings.seed
        return lay_person(k, forest.ground, north, east, seed, top=top, asked=asked[k], fresh=fresh)

    def measured(laid: Sequence[Person]) -> Cast:
        cast = _with_people(forest, laid, [p.asked == "bush" for p in laid])
        scene = forest.scene(cast.instances, device=device)
        bodies = [p.mesh.vertices()[::5].astype(np.float64) + p.place for p in laid]
        shares = measure_people(scene, camera, poses, cast.number, bodies)
        return replace(cast, visible=tuple(float("nan") if s is None else s for s in shares))

    if places is not None:
        if len(places) != count:
            raise ValueError(f"expected {count} places, one a person, got {len(places)}")
        laid = [lay(k, *place) for k, place in enumerate(places)]
        if not measure:
            cast = _with_people(forest, laid, [p.asked == "bush" for p in laid])
            return replace(cast, visible=(float("nan"),) * count)
        return measured(laid)
    picker = _Picker(forest, camera, poses, half_m, device, clearing="open" in asked)
    forest = picker.forest
    people = [lay(k, *picker.place(asked[k])) for k in range(count)]
    for attempt in range(_ROUNDS):
        cast = measured(people)
        missed = [
            k
            for k in range(count)
            if not CLASSES[asked[k]][0] <= cast.visible[k] <= CLASSES[asked[k]][1]
        ]
        if attempt == _ROUNDS - 1 or all(asked[k] in picker.exhausted for k in missed):
            break
        for k in missed:
            picker.free(people[k].place)
            people[k] = lay(k, *picker.place(asked[k]))
    if missed and classes is not None:
        k = missed[0]
        if np.isnan(cast.visible[k]):
            raise ValueError(
                f"class {asked[k]!r} cannot be measured: in photos of {camera.width} x "
                f"{camera.height} a person has fewer than {LEAST_PIXELS} pixels"
            )
        raise ValueError(
            f"class {asked[k]!r} was not reached in this forest (nearest place: "
            f"{cast.visible[k]:.2f} visible, wanted {CLASSES[asked[k]][0]:g} to "
            f"{CLASSES[asked[k]][1]:g}): change density, leaf density or glades"
        )
    return cast


class _Picker:
    """Proposes places by the visibility of the ground."""

    def __init__(
        self,
        forest: Forest,
        camera: Camera,
        poses: Array,
        half_m: tuple[float, float],
        device: str,
        *,
        clearing: bool,
    ) -> None:
        self._rng = np.random.default_rng([forest.settings.seed, 92])
        reach = max(half_m) + 6.0
        some = poses[np.unique(np.linspace(0, len(poses) - 1, 27).round().astype(int))]

        def look(at: Forest) -> VisibilityMap:
            return visibility_map(at.scene(device=device), camera, some, reach)

        chart = look(forest)
        side = len(chart.visible)
        axis = (np.arange(side) + 0.5) * chart.cell_m - reach
        self._north, self._east = np.meshgrid(axis, axis, indexing="ij")
        inside = (np.abs(self._north) <= half_m[0] + 3.0) & (np.abs(self._east) <= half_m[1] + 3.0)
        self.forest = forest
        if clearing:
            best = np.where(inside, smooth(chart, 3.0), -1.0).argmax()
            north, east = float(self._north.flat[best]), float(self._east.flat[best])
            cut = 0.0
            for radius in _CLEARINGS_M:
                # Not a single gap between crowns, but room for a few people.
                if smooth(chart, _ROOM_M).flat[best] >= _AIM["open"][0]:
                    break
                self.forest = forest.cleared(north, east, radius, paint=False)
                chart = look(self.forest)
                cut = radius
            if cut > 0.0:
                self.forest = forest.cleared(north, east, cut)
        self._visible = smooth(chart, 0.55)
        # People lie where several photos see them, and clear of trunks.
        self._free = inside
        for north, east, _ in self.forest.stems:
            self._free &= np.hypot(self._north - north, self._east - east) > 0.8
        self._taken: list[tuple[float, float]] = []
        self._tried = np.zeros_like(self._free)
        self.exhausted: set[str] = set()

    def place(self, name: str) -> tuple[float, float]:
        """Return a place for the class, the best that is left."""
        free = self._free & ~self._tried
        for north, east in self._taken:
            free &= np.hypot(self._north - north, self._east - east) > _APART_M
        if not free.any():
            raise ValueError("no room is left for people: ask for fewer, or fly a larger area")
        low, high = _AIM[name]
        distance = np.maximum(np.maximum(low - self._visible, self._visible - high), 0.0)
        distance[~free] = np.inf
        best = float(distance.min())
        if best > 0.25:
            self.exhausted.add(name)
        pick = np.flatnonzero(distance.reshape(-1) <= best + 0.002)
        index = int(pick[int(self._rng.integers(pick.size))])
        place = float(self._north.flat[index]), float(self._east.flat[index])
        self._taken.append(place)
        return place

    def free(self, place: Array) -> None:
        """Give a place up: nobody else is proposed within a metre of it."""
        self._taken = [t for t in self._taken if np.hypot(t[0] - place[0], t[1] - place[1]) > 1e-6]
        self._tried |= np.hypot(self._north - place[0], self._east - place[1]) < 1.0
