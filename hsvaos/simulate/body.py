"""The human body as fifteen rounded parts: its measures, its clothes, its mesh.

Part frames: x forward, y left, z up along the standing body, origin in the middle of the part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.clothes import Outfit
from hsvaos.simulate.mesh import Material, Mesh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """One rounded part of the body.

    Args:
        name: Plain name.
        parent: Name of the part it hangs on; empty for the pelvis.
        joint: Place of the joint in the standing body [m], pelvis at the origin.
        centre: Place of the part's middle in the standing body [m].
        half: Half the length of its straight middle, along `axis` [m].
        depth: Radius forward [m].
        breadth: Radius sideways [m].
        axis: 2 for parts along z (limbs), 0 for parts along x (feet), 1 for parts along y.
        mass: [kg].
        limits_deg: Range of the joint about x, y, z [deg], three pairs.
        wears: What covers it: "top", "sleeve", "bottom", "shoe", "skin" or "head".
    """

    name: str
    parent: str
    joint: tuple[float, float, float]
    centre: tuple[float, float, float]
    half: float
    depth: float
    breadth: float
    axis: int
    mass: float
    limits_deg: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    wears: str


def _sides() -> list[Part]:
    parts = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out = (-20.0, 75.0) if sign > 0 else (-75.0, 20.0)
        parts += [
            Part(
                f"{side} upper arm",
                "chest",
                (0.0, 0.19 * sign, 0.42),
                (0.0, 0.20 * sign, 0.28),
                0.11,
                0.052,
                0.052,
                2,
                2.0,
                ((-20.0, 110.0) if sign > 0 else (-110.0, 20.0), (-120.0, 40.0), (-50.0, 50.0)),
                "sleeve",
            ),
            Part(
                f"{side} forearm",
                f"{side} upper arm",
                (0.0, 0.20 * sign, 0.14),
                (0.0, 0.20 * sign, 0.02),
                0.10,
                0.042,
                0.042,
                2,
                1.3,
                ((-2.0, 2.0), (-135.0, 0.0), (-60.0, 60.0)),
                "sleeve",
            ),
            Part(
                f"{side} hand",
                f"{side} forearm",
                (0.0, 0.20 * sign, -0.10),
                (0.0, 0.20 * sign, -0.16),
                0.04,
                0.022,
                0.042,
                2,
                0.5,
                ((-20.0, 20.0), (-50.0, 50.0), (-5.0, 5.0)),
                "skin",
            ),
            Part(
                f"{side} thigh",
                "pelvis",
                (0.0, 0.09 * sign, -0.06),
                (0.0, 0.10 * sign, -0.27),
                0.15,
                0.080,
                0.080,
                2,
                8.5,
                (out, (-110.0, 25.0), (-35.0, 35.0)),
                "bottom",
            ),
            Part(
                f"{side} shank",
                f"{side} thigh",
                (0.0, 0.10 * sign, -0.48),
                (0.0, 0.10 * sign, -0.68),
                0.16,
                0.056,
                0.056,
                2,
                3.6,
                ((-2.0, 2.0), (0.0, 130.0), (-10.0, 10.0)),
                "bottom",
            ),
            Part(
                f"{side} foot",
                f"{side} shank",
                (0.0, 0.10 * sign, -0.88),
                (0.06, 0.10 * sign, -0.91),
                0.085,
                0.042,
                0.046,
                0,
                1.1,
                ((-15.0, 15.0), (-20.0, 45.0), (-10.0, 10.0)),
                "shoe",
            ),
        ]
    return parts


PARTS: tuple[Part, ...] = (
    Part(
        "pelvis",
        "",
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        0.08,
        0.105,
        0.125,
        1,
        11.0,
        ((0.0, 0.0),) * 3,
        "bottom",
    ),
    Part(
        "chest",
        "pelvis",
        (0.0, 0.0, 0.10),
        (0.0, 0.0, 0.29),
        0.15,
        0.115,
        0.175,
        2,
        26.0,
        ((-30.0, 30.0), (-20.0, 60.0), (-35.0, 35.0)),
        "top",
    ),
    Part(
        "head",
        "chest",
        (0.0, 0.0, 0.50),
        (0.015, 0.0, 0.63),
        0.03,
        0.098,
        0.082,
        2,
        5.0,
        ((-35.0, 35.0), (-45.0, 50.0), (-60.0, 60.0)),
        "head",
    ),
    *_sides(),
)
"""A body of 1.75 m and 75 kg."""


def _rounded(part: Part, rings: int = 9, sides: int = 12) -> tuple[Array, Array, Array]:
    """Return triangles (corner, side_a, side_b) of a stretched capsule in the part's frame."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings)
    along = np.sin(angle)
    # The caps are as long as the mean radius; between them lies the straight middle.
    cap = 0.5 * (part.depth + part.breadth)
    length = cap * along + part.half * np.sign(np.round(along, 9))
    turn = np.arange(sides + 1) * (2.0 * np.pi / sides)
    ring = np.stack([part.depth * np.cos(turn), part.breadth * np.sin(turn)], axis=1)
    points = np.empty((rings, sides + 1, 3))
    points[..., :2] = np.cos(angle)[:, None, None] * ring
    points[..., 2] = length[:, None]
    p00, p01 = points[:-1, :-1].reshape(-1, 3), points[:-1, 1:].reshape(-1, 3)
    p10, p11 = points[1:, :-1].reshape(-1, 3), points[1:, 1:].reshape(-1, 3)
    corner = np.concatenate([p00, p11])
    a = np.concatenate([p01 - p00, p10 - p11])
    b = np.concatenate([p10 - p00, p01 - p11])
    keep = np.linalg.norm(np.cross(a, b), axis=1) > 1e-10
    turned = {
        2: np.eye(3),
        0: np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]]),
        1: np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]),
    }[part.axis]
    return corner[keep] @ turned.T, a[keep] @ turned.T, b[keep] @ turned.T


def rotation_of(quaternion: Array) -> Array:
    """Return the rotation matrices, shape (..., 3, 3), of unit quaternions (..., 4), w first."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=np.float64), -1, 0)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        axis=-2,
    )


def body_mesh(places: Array, quaternions: Array, outfit: Outfit, seed: list[int]) -> Mesh:
    """Return the mesh of a posed and dressed person, NED axes, lying on down = 0 at the origin.

    Args:
        places: Shape (15, 3), middle of each part, z up [m].
        quaternions: Shape (15, 4), world from part, w first.
        outfit: Its colours.
        seed: Of the small unevenness of the colours.
    """
    rng = np.random.default_rng(seed)
    turns = rotation_of(quaternions)
    meshes = []
    for k, part in enumerate(PARTS):
        corner, a, b = _rounded(part)
        middle = corner + (a + b) / 3
        colour = np.tile(
            {
                "top": outfit.top,
                "bottom": outfit.bottom,
                "shoe": outfit.shoe,
                "skin": outfit.skin,
                "head": outfit.skin,
                "sleeve": outfit.top,
            }[part.wears],
            (len(corner), 1),
        )
        material = Material.CLOTH
        if part.wears in ("skin", "head") or (
            outfit.short_sleeves and part.name.endswith("forearm")
        ):
            material = Material.SKIN
            if part.wears == "sleeve":
                colour[:] = outfit.skin
        # Folds of cloth: bands of light and dark along the limb.
        fold = 0.10 * np.sin(middle[:, 2] * rng.uniform(45.0, 80.0) + rng.uniform(0.0, 6.0))
        colour = np.clip(
            colour * np.exp(fold + 0.05 * rng.standard_normal(len(corner)))[:, None], 0, 1
        )
        groups = [(np.ones(len(corner), bool), material)]
        if part.wears == "head":
            hair = (middle[:, 2] > 0.025) | (middle[:, 0] < -0.035)
            colour[hair] = outfit.hair
            groups = [(hair, Material.HAIR), (~hair, Material.SKIN)]
        for which, made_of in groups:
            meshes.append(
                Mesh.build(
                    corner[which] @ turns[k].T + places[k],
                    a[which] @ turns[k].T,
                    b[which] @ turns[k].T,
                    made_of,
                    colour[which],
                    triangle=True,
                )
            )
    return Mesh.join(meshes).moved(np.diag([1.0, -1.0, -1.0]))
