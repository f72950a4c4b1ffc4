"""Focal surfaces: where the rays of the virtual camera meet the ground."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from hsvaos.flight import Origin

Array = NDArray[np.float64]


@dataclass(frozen=True, init=False, eq=False)
class FocalPlane:
    """A synthetic focal plane, horizontal at `down_m` or through `point` with a `normal`.

    Args:
        down_m: Down coordinate of a horizontal plane, world NED [m].
        point: Shape (3,), a point of a tilted plane, world NED [m]; replaces down_m.
        normal: Shape (3,), its normal, of any length and either sign; vertical if not given.

    Raises:
        ValueError: If a number is not finite, or the normal has no length.
    """

    point: Array
    normal: Array

    def __init__(
        self,
        down_m: float = 0.0,
        *,
        point: ArrayLike | None = None,
        normal: ArrayLike = (0.0, 0.0, 1.0),
    ) -> None:
        at = np.array([0.0, 0.0, down_m] if point is None else point, dtype=np.float64)
        direction = np.array(normal, dtype=np.float64)
        if at.shape != (3,) or not np.isfinite(at).all():
            raise ValueError(f"a focal plane needs a finite point (down_m or 3 numbers), got {at}")
        length = float(np.linalg.norm(direction)) if direction.shape == (3,) else 0.0
        if not (np.isfinite(length) and length > 0.0):
            raise ValueError(f"normal must be 3 finite numbers, not all zero, got {normal!r}")
        object.__setattr__(self, "point", at)
        object.__setattr__(self, "normal", direction / length)


@dataclass(frozen=True, eq=False)
class FocalTerrain:
    """A focal surface given as a height field on a regular north-east grid.

    Between the nodes the surface is bilinear; NaN nodes are holes, which rays pass through unseen.

    Args:
        north0_m: North of node (0, 0), world NED [m].
        east0_m: East of node (0, 0) [m].
        spacing_m: Distance of neighbouring nodes, both ways [m].
        down_m: Shape (rows, columns), float32 down of the surface [m]; rows run to the north,
            columns to the east. NaN where unknown. Copied; not writeable after that.

    Raises:
        ValueError: If the grid is smaller than 2 x 2, has no finite node or no positive spacing, or
            its corner is not finite.
        TypeError: If the corner or the spacing is no number.
    """

    north0_m: float
    east0_m: float
    spacing_m: float
    down_m: NDArray[np.float32]

    def __post_init__(self) -> None:
        down = np.array(self.down_m, dtype=np.float32, order="C")
        if down.ndim != 2 or min(down.shape) < 2:
            raise ValueError(f"down_m must be a grid of at least 2 x 2, got shape {down.shape}")
        if np.isinf(down).any() or np.isnan(down).all():
            raise ValueError("down_m must hold finite metres (NaN for holes), and some of them")
        for name in ("north0_m", "east0_m", "spacing_m"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real):
                raise TypeError(f"{name} must be a number, got {value!r}")
            if not np.isfinite(float(value)):
                raise ValueError(f"{name} must be finite, got {value!r}")
            object.__setattr__(self, name, float(value))
        if self.spacing_m <= 0.0:
            raise ValueError(f"spacing_m must be a positive distance, got {self.spacing_m!r}")
        down.flags.writeable = False  # devices hold copies of it
        object.__setattr__(self, "down_m", down)

    @classmethod
    def from_arrays(cls, north_m: ArrayLike, east_m: ArrayLike, down_m: ArrayLike) -> FocalTerrain:
        """Return a terrain from a height field and its axes.

        Args:
            north_m: Shape (rows,), evenly spaced, rising or falling [m].
            east_m: Shape (columns,), evenly spaced, rising or falling, same spacing [m].
            down_m: Shape (rows, columns) [m], NaN where unknown.

        Raises:
            ValueError: If shapes differ, or the axes are not evenly spaced or turn back.
        """
        north = np.asarray(north_m, dtype=np.float64)
        east = np.asarray(east_m, dtype=np.float64)
        down = np.asarray(down_m, dtype=np.float32)
        if down.shape != (north.size, east.size) or min(north.size, east.size) < 2:
            raise ValueError(
                f"down_m must have shape (len(north_m), len(east_m)) = ({north.size}, {east.size}) "
                f"and at least 2 x 2 nodes, got {down.shape}"
            )
        for name, axis in (("north_m", north), ("east_m", east)):
            if not np.isfinite(axis).all():
                raise ValueError(f"{name} must hold finite metres, got NaN or infinity")
            if abs(np.sign(np.diff(axis)).sum()) != axis.size - 1:
                raise ValueError(f"{name} must rise or fall all along, got {str(axis)[:60]}")
        steps = np.concatenate([np.abs(np.diff(north)), np.abs(np.diff(east))])
        spacing = float(steps.mean())
        if not np.allclose(steps, spacing, rtol=1e-3, atol=0.0):
            raise ValueError("north_m and east_m must be evenly spaced by the same distance")
        down = down[:: 1 if north[1] > north[0] else -1, :: 1 if east[1] > east[0] else -1]
        return cls(float(north.min()), float(east.min()), spacing, down)

    @classmethod
    def from_mesh(
        cls, vertices: ArrayLike, faces: ArrayLike, spacing_m: float | None = None
    ) -> FocalTerrain:
        """Return the height field of a triangle mesh, seen from above.

        Args:
            vertices: Shape (V, 3), world NED [m].
            faces: Shape (F, 3), vertex numbers.
            spacing_m: Distance of the grid's nodes [m]; by default a quarter of the mean edge.

        Raises:
            ValueError: If the mesh is empty or a face names a vertex that is not there.
        """
        from hsvaos.formats.mesh import rasterise_mesh

        return rasterise_mesh(vertices, faces, spacing_m)

    @classmethod
    def from_file(
        cls, path: str | Path, origin: Origin | tuple[float, float, float] | None = None
    ) -> FocalTerrain:
        """Read a terrain file.

        Args:
            path: GeoTIFF digital elevation model (extra `geo`; needs the origin), `.obj` mesh with
                axes x = east, y = south, z = down (JKU's), or `.npz` with north_m, east_m, down_m.
            origin: The world's origin: latitude [deg], longitude [deg] and height [m].

        Raises:
            FlightError: If the file cannot be read or its format is not known.
        """
        from hsvaos.formats.terrain import read_terrain

        return read_terrain(Path(path), origin)

    @cached_property
    def lowest_m(self) -> float:
        """Greatest down of the surface [m]."""
        return float(np.nanmax(self.down_m))

    @cached_property
    def highest_m(self) -> float:
        """Least down of the surface [m]."""
        return float(np.nanmin(self.down_m))


FocalSurface = FocalPlane | FocalTerrain
