"""Triangle meshes: Wavefront .obj files, and the height field of a mesh seen from above."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.flight import FlightError
from hsvaos.formats.poses import NED_FROM_JKU
from hsvaos.formats.text import read_text
from hsvaos.surface import FocalTerrain

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

MOST_NODES = 64_000_000
"""Largest grid made without asking: 256 MB of float32."""
_BATCH = 1 << 21
"""Candidate nodes looked at in one go, to keep the memory small [nodes]."""
_EDGE = 1e-9
"""Nodes on a common edge belong to both triangles in spite of rounding (barycentric)."""


def rasterise_mesh(
    vertices: ArrayLike, faces: ArrayLike, spacing_m: float | None = None
) -> FocalTerrain:
    """Return the height field of a mesh seen from above: the highest surface where several lie.

    Nodes lie at whole multiples of the spacing; those under no triangle are NaN. Triangles seen
    edge-on cover nothing.

    Args:
        vertices: Shape (V, 3), world NED [m].
        faces: Shape (F, 3), vertex numbers.
        spacing_m: Distance of the nodes [m]; by default a quarter of the mean edge.

    Raises:
        ValueError: If the mesh is empty, not finite, names a vertex that is not there, covers
            no node, or needs a grid of more than `MOST_NODES`.
    """
    points = np.asarray(vertices, dtype=np.float64)
    triangles = np.asarray(faces)
    if points.ndim != 2 or points.shape[1:] != (3,) or points.size == 0:
        raise ValueError(f"vertices must have shape (V, 3), got {points.shape}")
    if triangles.ndim != 2 or triangles.shape[1:] != (3,) or triangles.size == 0:
        raise ValueError(f"faces must have shape (F, 3), got {triangles.shape}")
    if not np.issubdtype(triangles.dtype, np.integer):
        raise ValueError(f"faces must be vertex numbers, got {triangles.dtype}")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise ValueError(
            f"faces must name vertices 0 to {len(points) - 1}, "
            f"got {triangles.min()} to {triangles.max()}"
        )
    corners = points[triangles]
    if not np.isfinite(corners).all():
        raise ValueError("vertices must be finite, got NaN or infinity")
    if spacing_m is None:
        edges = corners - np.roll(corners, 1, axis=1)
        spacing_m = float(np.linalg.norm(edges, axis=2).mean()) / 4.0
    if not (np.isfinite(spacing_m) and spacing_m > 0.0):
        raise ValueError(f"spacing_m must be a positive distance, got {spacing_m!r}")

    low = np.floor(corners[..., :2].min(axis=(0, 1)) / spacing_m)
    high = np.ceil(corners[..., :2].max(axis=(0, 1)) / spacing_m)
    rows, columns = (int(n) for n in np.maximum(high - low, 1.0) + 1.0)
    if rows * columns > MOST_NODES:
        raise ValueError(
            f"a grid of {rows} x {columns} nodes is too large: give a spacing above {spacing_m} m"
        )
    down = np.full(rows * columns, np.inf)
    for index, values in _covered(corners, low, spacing_m, columns):
        np.minimum.at(down, index, values)
    down[np.isinf(down)] = np.nan
    if np.isnan(down).all():
        raise ValueError(f"no node lies on the mesh: give a spacing below {spacing_m} m")
    north0, east0 = (float(value) for value in low * spacing_m)
    grid = down.reshape(rows, columns).astype(np.float32)
    return FocalTerrain(north0, east0, float(spacing_m), grid)


def _covered(
    corners: Array, low: Array, spacing_m: float, columns: int
) -> Iterator[tuple[Faces, Array]]:
    """Yield flat numbers of nodes and the down of a triangle there, batch by batch."""
    plan = corners[..., :2] / spacing_m - low  # in units of nodes: row, column
    a, b, c = plan[:, 0], plan[:, 1], plan[:, 2]
    area = _cross(b - a, c - a)
    usable = np.flatnonzero(np.abs(area) > 1e-12)
    first = np.ceil(plan.min(axis=1) - _EDGE).astype(np.int64)
    size = np.floor(plan.max(axis=1) + _EDGE).astype(np.int64) - first + 1
    size = np.maximum(size, 0)
    counts = size[usable].prod(axis=1)
    bounds = np.searchsorted(np.cumsum(counts), np.arange(0, counts.sum() + _BATCH, _BATCH))
    for start, stop in zip(bounds[:-1], bounds[1:] + 1, strict=True):
        chosen = usable[start:stop]
        number = size[chosen].prod(axis=1)
        face = np.repeat(chosen, number)
        within = np.arange(face.size) - np.repeat(np.cumsum(number) - number, number)
        row = first[face, 0] + within // np.maximum(size[face, 1], 1)
        column = first[face, 1] + within % np.maximum(size[face, 1], 1)
        node = np.stack([row, column], axis=1).astype(np.float64)
        weight_b = _cross(node - a[face], (c - a)[face]) / area[face]
        weight_c = _cross((b - a)[face], node - a[face]) / area[face]
        weight_a = 1.0 - weight_b - weight_c
        inside = np.minimum(np.minimum(weight_a, weight_b), weight_c) >= -_EDGE
        heights = corners[face[inside], :, 2]
        values = (
            weight_a[inside] * heights[:, 0]
            + weight_b[inside] * heights[:, 1]
            + weight_c[inside] * heights[:, 2]
        )
        yield row[inside] * columns + column[inside], values


def _cross(u: Array, v: Array) -> Array:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def read_obj(path: Path) -> tuple[Array, Faces]:
    """Read a Wavefront .obj mesh with JKU's axes (x = east, y = south, z = down).

    Polygons are cut into triangles; negative vertex numbers count from the last vertex.

    Returns:
        Vertices, shape (V, 3), world NED [m], and faces, shape (F, 3).

    Raises:
        FlightError: If the file cannot be read or is malformed.
    """
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = (float(word) for word in words[1:4])
                if not math.isfinite(x + y + z):
                    raise ValueError
                vertices.append([x, y, z])
                continue
            corners = [int(word.split("/")[0]) for word in words[1:]]
            if len(corners) < 3 or 0 in corners:
                raise ValueError
        except ValueError:
            raise FlightError(
                f"{path}: line {number}: malformed .obj line: {line.strip()[:60]!r}"
            ) from None
        corners = [i - 1 if i > 0 else len(vertices) + i for i in corners]
        faces += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
    if not faces:
        raise FlightError(f"{path}: expected a mesh with vertices and faces, got none")
    return np.array(vertices) @ NED_FROM_JKU.T, np.array(faces, dtype=np.int64)
