"""What grows and lies under the trees: bushes, ferns, grass, fallen leaves, dead wood."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.mesh import Material, Mesh, tube
from hsvaos.simulate.textures import Tile
from hsvaos.simulate.tree import cards

Array = NDArray[np.float64]
_NED = np.diag([1.0, 1.0, -1.0])

GRASS_TILE_M = 4.0
"""Side of a square of grass and litter [m]."""


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9))


def bush(seed: list[int], palette: Array, *, leafy: bool) -> Mesh:
    """Grow a bush, 1.3 m high and 2.2 m wide, NED axes, foot at the origin."""
    rng = np.random.default_rng(seed)
    stems = 34
    turn = rng.uniform(0.0, 2.0 * np.pi, stems)
    rise = np.radians(rng.uniform(25.0, 85.0, stems))
    direction = np.stack(
        [np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1
    )
    length = rng.uniform(0.8, 1.35, stems) * (1.0 - 0.12 * np.sin(rise))
    start = rng.normal(0.0, 0.12, (stems, 3)) * (1.0, 1.0, 0.0)
    end = start + direction * length[:, None]
    corner, a, b = tube(np.stack([start, end], 1), np.tile([[0.014, 0.004]], (stems, 1)), 3)
    wood = Mesh.build(corner, a, b, Material.BARK, (0.09, 0.07, 0.05))
    per = 17 if leafy else 5
    t = rng.uniform(0.2, 1.08, (stems, per))
    foot = (start[:, None] + (end - start)[:, None] * t[..., None]).reshape(-1, 3)
    foot += rng.normal(0.0, 0.09, foot.shape)
    axis = _unit(direction.repeat(per, 0) + 0.8 * rng.standard_normal(foot.shape))
    normal = _unit(np.array([0.0, 0.0, 1.0]) + 0.5 * rng.standard_normal(foot.shape))
    size = rng.uniform(0.22, 0.36, len(foot))
    colour = palette[rng.integers(0, len(palette), len(foot))]
    colour = np.clip(colour * np.exp(0.2 * rng.standard_normal((len(foot), 1))), 0.0, 1.0)
    if leafy:
        leaves = cards(rng, foot, axis, normal, size, size, colour, Tile.SMALL, Material.LEAF)
    else:
        leaves = cards(rng, foot, axis, normal, 1.7 * size, size, colour, Tile.TWIGS, Material.BARK)
    return Mesh.join([wood, leaves]).moved(_NED)


def fern(seed: list[int], palette: Array) -> Mesh:
    """Grow a clump of ferns, 1.4 m wide, NED axes, foot at the origin."""
    rng = np.random.default_rng(seed)
    fronds = 13
    turn = np.arange(fronds) * 2.399 + rng.normal(0.0, 0.2, fronds)
    rise = np.radians(rng.uniform(18.0, 50.0, fronds))
    direction = np.stack(
        [np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1
    )
    foot = np.tile([[0.0, 0.0, 0.08]], (fronds, 1))
    length = rng.uniform(0.5, 0.85, fronds)
    colour = palette[rng.integers(0, len(palette), fronds)]
    colour = np.clip(colour * np.exp(0.2 * rng.standard_normal((fronds, 1))), 0.0, 1.0)
    up = np.tile([[0.0, 0.0, 1.0]], (fronds, 1))
    mesh = cards(rng, foot, direction, up, length, 0.42 * length, colour, Tile.FERN, Material.GRASS)
    return mesh.moved(_NED)


def grass_tile(seed: list[int], grass: Array, litter: Array, tufts: int, leaves: int) -> Mesh:
    """Fill a square of GRASS_TILE_M with tufts of grass and fallen leaves, NED axes.

    Args:
        seed: Of every random choice.
        grass: Shape (K, 3), linear RGB of the blades.
        litter: Shape (L, 3), linear RGB of the fallen leaves.
        tufts: Number of tufts.
        leaves: Number of cards with a few fallen leaves each.
    """
    rng = np.random.default_rng(seed)
    half = GRASS_TILE_M / 2
    parts = []
    if tufts:
        foot = np.concatenate(
            [rng.uniform(-half, half, (tufts, 2)), np.full((tufts, 1), -0.02)], axis=1
        )
        axis = _unit(rng.normal(0.0, 0.55, (tufts, 3)) * (1.0, 1.0, 0.0) + (0.0, 0.0, 0.7))
        normal = rng.standard_normal((tufts, 3)) * (1.0, 1.0, 0.3)
        size = rng.uniform(0.18, 0.42, tufts)
        colour = grass[rng.integers(0, len(grass), tufts)]
        colour = np.clip(colour * np.exp(0.22 * rng.standard_normal((tufts, 1))), 0.0, 1.0)
        parts.append(
            cards(rng, foot, axis, normal, size, 1.3 * size, colour, Tile.GRASS, Material.GRASS)
        )
    if leaves:
        foot = np.concatenate(
            [rng.uniform(-half, half, (leaves, 2)), rng.uniform(0.01, 0.05, (leaves, 1))], axis=1
        )
        turn = rng.uniform(0.0, 2.0 * np.pi, leaves)
        tilt = rng.normal(0.0, 0.15, leaves)
        axis = _unit(np.stack([np.cos(turn), np.sin(turn), tilt], axis=1))
        normal = _unit(np.array([0.0, 0.0, 1.0]) + 0.15 * rng.standard_normal((leaves, 3)))
        size = rng.uniform(0.22, 0.40, leaves)
        colour = litter[rng.integers(0, len(litter), leaves)]
        colour = np.clip(colour * np.exp(0.2 * rng.standard_normal((leaves, 1))), 0.0, 1.0)
        parts.append(cards(rng, foot, axis, normal, size, size, colour, Tile.FALLEN, Material.WOOD))
    return Mesh.join(parts).moved(_NED)


def log(seed: list[int]) -> Mesh:
    """Make a fallen trunk with stumps of branches, about 4 m long, NED axes, lying along north."""
    rng = np.random.default_rng(seed)
    length = rng.uniform(2.5, 5.5)
    thick = rng.uniform(0.07, 0.16)
    x = np.linspace(-length / 2, length / 2, 5)
    y = np.cumsum(rng.normal(0.0, 0.05, 5))
    line = np.stack([x, y, np.full(5, thick * 0.7)], axis=1)
    radius = thick * np.linspace(1.0, 0.55, 5)
    pieces = [tube(np.stack([line[:-1], line[1:]], 1), np.stack([radius[:-1], radius[1:]], 1), 8)]
    count = 7
    start = line[rng.integers(1, 5, count)]
    turn = rng.uniform(0.0, np.pi, count)
    tip = start + np.stack(
        [rng.uniform(0.1, 0.5, count), np.cos(turn) * 0.7, np.abs(np.sin(turn)) * 0.5], axis=1
    )
    pieces.append(tube(np.stack([start, tip], 1), np.tile([[0.028, 0.010]], (count, 1)), 4))
    corner, a, b = (np.concatenate(part) for part in zip(*pieces, strict=True))
    tone = np.array([0.13, 0.11, 0.085]) * rng.uniform(0.7, 1.5)
    colour = np.clip(tone * np.exp(0.2 * rng.standard_normal((len(corner), 1))), 0.0, 1.0)
    return Mesh.build(corner, a, b, Material.WOOD, colour).moved(_NED)
