"""The forest floor: an undulating height field and its painted colour."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.simulate.mesh import Material, Mesh
from hsvaos.simulate.seasons import Season

Array = NDArray[np.float64]

_SPACING_M = 0.5
_TILE_CELLS = 32
_BAND_ROWS = 256


def noise(rng: np.random.Generator, size: int, cells: int) -> NDArray[np.float32]:
    """Return smooth noise of unit deviation, shape (size, size), `cells` bumps across."""
    coarse = rng.standard_normal((cells + 3, cells + 3)).astype(np.float32)
    field = cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
    return np.asarray(field / max(float(field.std()), 1e-6), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Ground:
    """Height field on a square grid, rows to the north, columns to the east.

    Args:
        half_m: The grid covers [-half_m, half_m] both ways [m].
        down_m: Shape (n, n), down of the nodes [m].
        colour: Shape (m, m, 3), uint8, square roots of linear RGB; row 0 lies in the north.
    """

    half_m: float
    down_m: Array
    colour: NDArray[np.uint8]

    @property
    def spacing_m(self) -> float:
        """Distance of neighbouring nodes [m]."""
        return 2.0 * self.half_m / (len(self.down_m) - 1)

    @property
    def texel_m(self) -> float:
        """Side of a texel of `colour` [m]."""
        return 2.0 * self.half_m / len(self.colour)

    def down_at(self, north: ArrayLike, east: ArrayLike) -> Array:
        """Return the down of the ground [m] at places [m], on the triangles that are drawn."""
        last = len(self.down_m) - 1
        y = np.clip((np.asarray(north) + self.half_m) / self.spacing_m, 0.0, last - 1e-9)
        x = np.clip((np.asarray(east) + self.half_m) / self.spacing_m, 0.0, last - 1e-9)
        r, c = y.astype(int), x.astype(int)
        fy, fx = y - r, x - c
        d = self.down_m
        d00, d01, d10, d11 = d[r, c], d[r, c + 1], d[r + 1, c], d[r + 1, c + 1]
        lower = d00 + fx * (d01 - d00) + fy * (d10 - d00)
        upper = d11 + (1.0 - fx) * (d10 - d11) + (1.0 - fy) * (d01 - d11)
        return np.asarray(np.where(fx + fy <= 1.0, lower, upper))

    def slope_at(self, north: ArrayLike, east: ArrayLike, reach_m: float = 0.6) -> Array:
        """Return d down / d north and d down / d east, shape (..., 2), over `reach_m` [m]."""
        n, e = np.asarray(north, dtype=float), np.asarray(east, dtype=float)
        north_slope = (self.down_at(n + reach_m, e) - self.down_at(n - reach_m, e)) / 2 / reach_m
        east_slope = (self.down_at(n, e + reach_m) - self.down_at(n, e - reach_m)) / 2 / reach_m
        return np.stack([north_slope, east_slope], axis=-1)

    def with_meadow(self, circles: Array, colours: Array, seed: list[int]) -> Ground:
        """Return the ground with grass painted over circles.

        Args:
            circles: Shape (N, 3): north, east and radius [m].
            colours: Shape (K, 3), linear RGB of grass.
            seed: Of the paint.
        """
        rng = np.random.default_rng(seed)
        size = len(self.colour)
        axis = self.half_m - (np.arange(size, dtype=np.float32) + 0.5) * self.texel_m
        rough = noise(rng, size, max(int(2.0 * self.half_m / 1.7), 1))
        fine = noise(rng, size, max(int(2.0 * self.half_m / 0.25), 1))
        patch = noise(rng, size, max(int(2.0 * self.half_m / 4.0), 1))
        first, second = colours[0].astype(np.float32), colours[-1].astype(np.float32)
        painted = self.colour.copy()
        for rows in _bands(size):
            inside = np.full((rows.stop - rows.start, size), -1e3, dtype=np.float32)
            for north, east, radius in circles:
                away = np.hypot((axis[rows] - north)[:, None], (-axis - east)[None, :])
                inside = np.maximum(inside, np.float32(radius) - away.astype(np.float32))
            if float(inside.max()) < -6.0:
                continue
            cover = 0.45 + 0.25 * inside + 0.35 * rough[rows] + 0.22 * fine[rows]
            cover = np.where(inside < -6.0, 0.0, np.clip(cover, 0.0, 0.93))[..., None]
            share = np.clip(0.5 + 0.4 * (patch[rows] + 0.5 * fine[rows]), 0.0, 1.0)[..., None]
            speckle = rng.standard_normal(inside.shape, dtype=np.float32)
            blade = np.exp(0.22 * fine[rows] + 0.22 * speckle)[..., None]
            grass = (first * share + second * (1.0 - share)) * blade * np.float32(0.62)
            old = (self.colour[rows].astype(np.float32) / 255.0) ** 2
            painted[rows] = _encode(old * (1.0 - cover) + grass * cover)
        return replace(self, colour=painted)

    def tiles(self) -> list[tuple[Mesh, Array]]:
        """Return the meshes of square parts of the ground, each with its place, shape (3,)."""
        n = len(self.down_m) - 1
        parts = []
        axis = -self.half_m + self.spacing_m * np.arange(n + 1)
        for row in range(0, n, _TILE_CELLS):
            for column in range(0, n, _TILE_CELLS):
                r = slice(row, min(row + _TILE_CELLS, n) + 1)
                c = slice(column, min(column + _TILE_CELLS, n) + 1)
                north, east = np.meshgrid(axis[r], axis[c], indexing="ij")
                nodes = np.stack([north, east, self.down_m[r, c]], axis=-1)
                place = np.array([north.mean(), east.mean(), 0.0])
                nodes = nodes - place
                p00, p01 = nodes[:-1, :-1], nodes[:-1, 1:]
                p10, p11 = nodes[1:, :-1], nodes[1:, 1:]
                corner = np.concatenate([p00.reshape(-1, 3), p11.reshape(-1, 3)])
                a = np.concatenate([(p01 - p00).reshape(-1, 3), (p10 - p11).reshape(-1, 3)])
                b = np.concatenate([(p10 - p00).reshape(-1, 3), (p01 - p11).reshape(-1, 3)])
                mesh = Mesh.build(corner, a, b, Material.GROUND, (0.1, 0.1, 0.1), triangle=True)
                parts.append((mesh, place))
        return parts


def make_ground(
    seed: int, season: Season, half_m: float, relief_m: float, texture_size: int
) -> Ground:
    """Make the ground of a scene.

    Args:
        seed: Of every random choice.
        season: For its colours and snow.
        half_m: The ground covers [-half_m, half_m] both ways [m].
        relief_m: Standard deviation of the heights [m].
        texture_size: Side of the colour texture [px].

    Raises:
        ValueError: If half_m is not positive or relief_m is negative.
    """
    if not half_m > 0.0:
        raise ValueError(f"half_m must be a positive number of metres, got {half_m!r}")
    if not (np.isfinite(relief_m) and relief_m >= 0.0):
        raise ValueError(f"relief_m must be 0 or more metres, got {relief_m!r}")
    rng = np.random.default_rng([seed, 21])
    nodes = int(np.ceil(2.0 * half_m / _SPACING_M)) + 1
    down = np.zeros((nodes, nodes), dtype=np.float64)
    for wavelength, weight in ((28.0, 0.85), (11.0, 0.45), (4.5, 0.14), (1.6, 0.05)):
        down += weight * noise(rng, nodes, max(int(2.0 * half_m / wavelength), 1))
    down = (down - down.mean()) * relief_m
    return Ground(half_m, down, _paint(rng, season, texture_size, half_m))


def _paint(rng: np.random.Generator, season: Season, size: int, half_m: float) -> NDArray[np.uint8]:
    """Paint litter, soil, moss and snow; shape (size, size, 3), square roots of linear RGB."""
    across = 2.0 * half_m
    # What lies on top wins, piece by piece; row bands keep the working memory small.
    best = np.full((size, size), -np.inf, dtype=np.float32)
    winner = np.zeros((size, size), dtype=np.uint8)
    for number, (share, _) in enumerate(season.litter):
        field = np.float32(0.8) * noise(rng, size, int(across / 7.0))
        field += np.float32(0.7) * noise(rng, size, int(across / 1.3))
        # Single leaves: grains of about 7 cm.
        field += np.float32(1.2) * noise(rng, size, int(across / 0.07))
        field += np.float32(1.6 * np.log(share))
        winner[field > best] = number
        np.maximum(best, field, out=best)
    del best, field
    colours = np.array([rgb for _, rgb in season.litter], dtype=np.float32)
    leaves = noise(rng, size, int(across / 0.07))
    patches = noise(rng, size, int(across / 2.2))
    snowed = season.ground_snow > 0.0
    if snowed:
        depth = noise(rng, size, int(across / 3.0))
        depth += np.float32(0.6) * noise(rng, size, int(across / 0.4))
        drift = noise(rng, size, int(across / 0.5))
    bare = np.float32(np.sqrt(1.36) * _normal_quantile(season.ground_snow))
    white = np.array([0.78, 0.815, 0.87], dtype=np.float32)
    painted = np.empty((size, size, 3), dtype=np.uint8)
    for rows in _bands(size):
        speckle = rng.standard_normal(winner[rows].shape, dtype=np.float32)
        grain = np.exp(0.22 * leaves[rows] + 0.20 * speckle + 0.18 * patches[rows])
        picture = colours[winner[rows]] * grain[..., None]
        if snowed:
            cover = np.clip((bare - depth[rows]) * 2.2 + 0.5, 0.0, 1.0)[..., None]
            speckle = rng.standard_normal(winner[rows].shape, dtype=np.float32)
            level = np.exp(0.035 * drift[rows] + 0.015 * speckle)[..., None]
            picture = picture * (1.0 - cover) + white * level * cover
        painted[rows] = _encode(picture)
    return painted


def _bands(size: int) -> list[slice]:
    return [slice(k, min(k + _BAND_ROWS, size)) for k in range(0, size, _BAND_ROWS)]


def _encode(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return square roots of linear colours as 8 bits."""
    root = np.sqrt(np.clip(linear, 0.0, 1.0)) * np.float32(255.0)
    return np.asarray(np.rint(root), dtype=np.uint8)


def _normal_quantile(share: float) -> float:
    from statistics import NormalDist

    return NormalDist().inv_cdf(min(max(share, 1e-3), 1.0 - 1e-3))
