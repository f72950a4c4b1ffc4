"""Meshes of patches (triangles and parallelograms), the only geometry the simulator knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.kernels.raster import OPAQUE

Points = NDArray[np.float32]


class Material(IntEnum):
    """What a patch is made of: how it scatters light, carries snow and warms in the sun."""

    LEAF = 0
    NEEDLE = 1
    BARK = 2
    GROUND = 3
    GRASS = 4
    WOOD = 5
    CLOTH = 6
    SKIN = 7
    HAIR = 8
    TARGET = 9


MATERIALS = np.array(
    # translucency, carries snow, shine, textured ground
    [
        [0.75, 1.0, 0.012, 0.0],
        [0.30, 1.0, 0.008, 0.0],
        [0.00, 0.6, 0.000, 0.0],
        [0.00, 0.0, 0.000, 1.0],
        [0.60, 0.3, 0.010, 0.0],
        [0.00, 1.0, 0.000, 0.0],
        [0.00, 0.0, 0.000, 0.0],
        [0.00, 0.0, 0.020, 0.0],
        [0.00, 0.0, 0.010, 0.0],
        [0.00, 0.0, 0.000, 0.0],
    ],
    dtype=np.float32,
)
"""Optical properties by material."""

WARMTH = np.array(
    # temperature in the open shade [deg C], gain in full sun [K], gain under cover [K], unused
    [
        [17.0, 7.0, 0.8, 0.0],
        [17.0, 6.0, 0.8, 0.0],
        [16.5, 6.0, 0.5, 0.0],
        [15.0, 9.0, 0.5, 0.0],
        [15.5, 6.0, 0.5, 0.0],
        [16.0, 9.0, 0.5, 0.0],
        [25.5, 5.0, 0.0, 0.0],
        [31.5, 2.0, 0.0, 0.0],
        [28.0, 4.0, 0.0, 0.0],
        [17.0, 9.0, 0.0, 0.0],
    ],
    dtype=np.float32,
)
"""Surface temperature by material: plausible summer values, not measured ones."""


def pack_colour(linear: ArrayLike) -> NDArray[np.uint32]:
    """Pack linear RGB (..., 3) in [0, 1] as square roots of 8 bits each."""
    root = np.sqrt(np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0))
    code = np.rint(root * 255.0).astype(np.uint32)
    return np.asarray(code[..., 0] | code[..., 1] << 8 | code[..., 2] << 16, dtype=np.uint32)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Patches {c + u a + v b} with their looks.

    Args:
        corner: Shape (P, 3), c, mesh frame (NED axes) [m].
        side_a: Shape (P, 3), a [m].
        side_b: Shape (P, 3), b [m].
        info: Shape (P,), int32: tile | material << 8 | triangle << 16.
        colour: Shape (P,), uint32, from `pack_colour`.
    """

    corner: Points
    side_a: Points
    side_b: Points
    info: NDArray[np.int32]
    colour: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.corner)

    @classmethod
    def build(
        cls,
        corner: ArrayLike,
        side_a: ArrayLike,
        side_b: ArrayLike,
        material: Material,
        colour: ArrayLike,
        tile: ArrayLike = OPAQUE,
        *,
        triangle: bool = False,
    ) -> Mesh:
        """Return a mesh of one material.

        Args:
            corner: Shape (P, 3) [m].
            side_a: Shape (P, 3) [m].
            side_b: Shape (P, 3) [m].
            material: Of all patches.
            colour: Linear RGB, shape (3,) or (P, 3).
            tile: Texture tile of all, or of each; OPAQUE for none.
            triangle: Whether the patches are triangles rather than parallelograms.
        """
        c = np.ascontiguousarray(corner, dtype=np.float32).reshape(-1, 3)
        count = len(c)
        info = np.broadcast_to(
            np.asarray(tile, dtype=np.int32) | int(material) << 8 | int(triangle) << 16, (count,)
        )
        packed = np.broadcast_to(pack_colour(colour), (count,))
        return cls(
            c,
            np.ascontiguousarray(side_a, dtype=np.float32).reshape(-1, 3),
            np.ascontiguousarray(side_b, dtype=np.float32).reshape(-1, 3),
            np.array(info, dtype=np.int32),
            np.array(packed, dtype=np.uint32),
        )

    @classmethod
    def join(cls, meshes: Sequence[Mesh]) -> Mesh:
        """Return all patches of several meshes as one mesh."""
        return cls(
            np.concatenate([m.corner for m in meshes]),
            np.concatenate([m.side_a for m in meshes]),
            np.concatenate([m.side_b for m in meshes]),
            np.concatenate([m.info for m in meshes]),
            np.concatenate([m.colour for m in meshes]),
        )

    def moved(self, matrix: ArrayLike, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
        """Return the mesh after x -> matrix x + offset."""
        m = np.asarray(matrix, dtype=np.float64)
        return Mesh(
            (self.corner @ m.T + np.asarray(offset)).astype(np.float32),
            (self.side_a @ m.T).astype(np.float32),
            (self.side_b @ m.T).astype(np.float32),
            self.info,
            self.colour,
        )

    def vertices(self) -> Points:
        """Return the corners of all patches, shape (n P, 3) [m]."""
        c, a, b = self.corner, self.side_a, self.side_b
        quad = (self.info >> 16 & 1) == 0
        return np.concatenate([c, c + a, c + b, (c + a + b)[quad]])


def tube(points: ArrayLike, radii: ArrayLike, sides: int) -> tuple[Points, Points, Points]:
    """Return the parallelograms of tapered prisms around straight pieces.

    Args:
        points: Shape (S, 2, 3), both ends of each piece [m].
        radii: Shape (S, 2), radius at each end [m].
        sides: Sides of the prism.

    Returns:
        corner, side_a, side_b, each shape (S sides, 3).
    """
    ends = np.asarray(points, dtype=np.float64)
    radius = np.asarray(radii, dtype=np.float64)
    axis = ends[:, 1] - ends[:, 0]
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    helper = np.where(np.abs(axis[:, 2:]) > 0.9, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    e1 = np.cross(axis, helper)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = np.cross(axis, e1)
    angle = np.arange(sides + 1) * (2.0 * np.pi / sides)
    ring = np.cos(angle)[None, :, None] * e1[:, None] + np.sin(angle)[None, :, None] * e2[:, None]
    low = ends[:, None, 0] + ring * radius[:, None, :1]
    high = ends[:, None, 1] + ring * radius[:, None, 1:]
    corner = low[:, :-1]
    shape = (-1, 3)
    return (
        corner.reshape(shape).astype(np.float32),
        (high[:, :-1] - corner).reshape(shape).astype(np.float32),
        (low[:, 1:] - corner).reshape(shape).astype(np.float32),
    )
