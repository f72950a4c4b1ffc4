"""People who lie in the forest: pose from the library, clothes, place on the ground, outline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.body import body_mesh
from hsvaos.simulate.clothes import Outfit, dress
from hsvaos.simulate.ground import Ground
from hsvaos.simulate.mesh import Material, Mesh, tube

Array = NDArray[np.float64]

_SINK_M = 0.015


@dataclass(frozen=True, eq=False)
class Person:
    """One person lying on the ground.

    Args:
        number: From 0.
        place: Shape (3,), middle of the pelvis on the ground, NED [m].
        mesh: Relative to `place`, NED axes.
        outfit: Clothes.
        outline: Shape (K, 3), convex outline seen from above, NED [m].
        asked: Occlusion class that was asked for.
    """

    number: int
    place: Array
    mesh: Mesh
    outfit: Outfit
    outline: Array
    asked: str = ""


@cache
def pose_library() -> tuple[Array, Array]:
    """Return the shipped poses: places (N, 15, 3) and quaternions (N, 15, 4), z up."""
    with (files("hsvaos") / "data" / "poses.npz").open("rb") as stream:
        data = np.load(stream)
        return data["places"].astype(np.float64), data["quaternions"].astype(np.float64)


def lay_person(
    number: int,
    ground: Ground,
    north: float,
    east: float,
    seed: int,
    *,
    top: str | None = None,
    asked: str = "",
    fresh: bool = False,
) -> Person:
    """Lay a person on the ground.

    Args:
        number: Of the person, from 0; with the seed it chooses pose, heading and clothes.
        ground: What to lie on.
        north: Where [m].
        east: Where [m].
        seed: Of the simulation.
        top: Colour of the top by name; any if None.
        asked: Occlusion class to note.
        fresh: Let a new body fall onto this very ground (MuJoCo, extra `sim`) instead of taking
            a pose of the library.

    Raises:
        ValueError: If the colour is unknown, or MuJoCo is missing where it is needed.
    """
    rng = np.random.default_rng([seed, 71, number])
    outfit = dress([seed, 72, number], top)
    if fresh:
        from hsvaos.simulate.ragdoll import settle

        axis = np.linspace(-2.0, 2.0, 41)
        # The ragdoll's x is north and its y is west (z up); its rows run along y.
        west, ahead = np.meshgrid(axis, axis, indexing="ij")
        heights = -ground.down_at(north + ahead, east - west)
        parts, quaternions = settle(heights, [seed, 73, number])
        mesh = body_mesh(parts, quaternions, outfit, [seed, 74, number])
        place = np.array([north, east, 0.0])
    else:
        places, turns = pose_library()
        choice = int(rng.integers(len(places)))
        mesh = body_mesh(places[choice], turns[choice], outfit, [seed, 74, number])
        heading = rng.uniform(0.0, 2.0 * np.pi)
        c, s = np.cos(heading), np.sin(heading)
        slope = ground.slope_at(north, east)
        tilt = np.eye(3)
        tilt[2, :2] = slope
        mesh = mesh.moved(tilt @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
        place = np.array([north, east, float(ground.down_at(north, east))])
    points = mesh.vertices().astype(np.float64) + place
    clearance = ground.down_at(points[:, 0], points[:, 1]) - points[:, 2]
    # Rest on the ground, and press a little into leaves and moss.
    place[2] += float(np.quantile(clearance, 0.02)) + _SINK_M
    points = mesh.vertices().astype(np.float64) + place
    return Person(number, place, mesh, outfit, outline_of(points), asked)


def outline_of(points: Array) -> Array:
    """Return the convex outline, seen from above, of points (N, 3) NED: shape (K, 3)."""
    hull = cv2.convexHull(points[:, :2].astype(np.float32), returnPoints=False)
    order = np.asarray(hull).reshape(-1)
    return np.asarray(points[order])


def stake_mesh(height_m: float = 0.5, plate_m: float = 0.30) -> Mesh:
    """Return a survey stake: a thin post with a horizontal white plate, top centre at the origin.

    Args:
        height_m: From the plate down to the ground [m].
        plate_m: Side of the square plate [m].
    """
    half = plate_m / 2
    plate = Mesh.build(
        [[-half, -half, 0.0]],
        [[plate_m, 0, 0]],
        [[0, plate_m, 0]],
        Material.TARGET,
        (0.75, 0.75, 0.75),
    )
    ends = np.array([[[0.0, 0.0, 0.01], [0.0, 0.0, height_m + 0.2]]])
    corner, a, b = tube(ends, np.array([[0.02, 0.02]]), 6)
    return Mesh.join([plate, Mesh.build(corner, a, b, Material.WOOD, (0.2, 0.15, 0.1))])
