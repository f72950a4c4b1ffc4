"""What stands in a scene: meshes and their places, being collected."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.simulate.mesh import Mesh

Array = NDArray[np.float64]


class Kind(IntEnum):
    """What an instance is."""

    GROUND = 0
    TREE = 1
    BUSH = 2
    LITTER = 3
    WOOD = 4
    PERSON = 5
    STAKE = 6


@dataclass
class Instances:
    """Meshes and where they stand, being collected.

    Args:
        meshes: Every mesh once.
        mesh: Mesh number of each instance.
        place: world_from_mesh of each instance, shape (3, 4), NED [m].
        tint: Factor on the colours of each instance, linear RGB.
        kind: What each instance is.
    """

    meshes: list[Mesh] = field(default_factory=list)
    mesh: list[int] = field(default_factory=list)
    place: list[Array] = field(default_factory=list)
    tint: list[tuple[float, float, float]] = field(default_factory=list)
    kind: list[Kind] = field(default_factory=list)

    def add_mesh(self, mesh: Mesh) -> int:
        """Add a mesh and return its number."""
        self.meshes.append(mesh)
        return len(self.meshes) - 1

    def add(
        self,
        mesh: int,
        kind: Kind,
        matrix: ArrayLike,
        position: ArrayLike,
        tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> int:
        """Add an instance at a position with a linear part and return its number."""
        place = np.empty((3, 4))
        place[:, :3] = matrix
        place[:, 3] = position
        self.mesh.append(mesh)
        self.place.append(place)
        self.tint.append(tint)
        self.kind.append(kind)
        return len(self.mesh) - 1

    def copy(self) -> Instances:
        """Return a collection that can grow without changing this one."""
        return Instances(
            list(self.meshes), list(self.mesh), list(self.place), list(self.tint), list(self.kind)
        )
