"""Procedural trees: trunk, three levels of branches, leaf cards at their ends.

Everything is built with z up and turned to NED at the end (`_to_ned`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.mesh import Material, Mesh, tube
from hsvaos.simulate.textures import Tile

Array = NDArray[np.float64]
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_NED = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class TreeShape:
    """Measures of a tree of height 1; an instance scales them.

    Args:
        crown_radius: Of the widest part, per height.
        crown_base: Height of the lowest branches, per height.
        primaries: Branches at the trunk.
        secondaries: Branches on each of those.
        tertiaries: Branches on each of those.
        card_m: Side of a leaf card at 12 m height [m].
        bark: Linear RGB.
        tile: Texture of the leaf cards.
    """

    crown_radius: float = 0.26
    crown_base: float = 0.32
    primaries: int = 15
    secondaries: int = 7
    tertiaries: int = 5
    card_m: float = 0.42
    bark: tuple[float, float, float] = (0.10, 0.08, 0.06)
    tile: Tile = Tile.OVATE


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9))


def cards(
    rng: np.random.Generator,
    base: Array,
    along: Array,
    normal: Array,
    length: Array,
    width: Array,
    colour: Array,
    tile: Tile,
    material: Material,
) -> Mesh:
    """Return textured cards that start at `base` and reach out `along`.

    Args:
        rng: Turns each card a little about its axis.
        base: Shape (N, 3) [m].
        along: Shape (N, 3), unit.
        normal: Shape (N, 3), wished normal.
        length: Shape (N,) [m].
        width: Shape (N,) [m].
        colour: Shape (N, 3), linear RGB.
        tile: Texture.
        material: Of all cards.
    """
    across = _unit(np.cross(along, normal + 0.15 * rng.standard_normal(normal.shape)))
    side = across * width[:, None]
    return Mesh.build(base - 0.5 * side, side, along * length[:, None], material, colour, int(tile))


def _branches(
    start: Array, direction: Array, length: Array, radius: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return branches of two pieces each: ends (N, 2, 2, 3), radii (N, 2, 2)."""
    bend = direction + np.array([0.0, 0.0, 0.35]) + 0.25 * rng.standard_normal(direction.shape)
    middle = start + direction * length[:, None] * 0.5
    end = middle + _unit(bend) * length[:, None] * 0.5
    ends = np.stack([np.stack([start, middle], 1), np.stack([middle, end], 1)], axis=1)
    radii = radius[:, None, None] * np.array([[1.0, 0.7], [0.7, 0.3]])
    return ends, radii


def _along(ends: Array, t: Array) -> Array:
    """Return points at share t (N, K) of two-piece branches (N, 2, 2, 3): (N, K, 3)."""
    first = (
        ends[:, None, 0, 0]
        + (ends[:, None, 0, 1] - ends[:, None, 0, 0]) * np.minimum(2.0 * t, 1.0)[..., None]
    )
    rest = (ends[:, None, 1, 1] - ends[:, None, 1, 0]) * np.maximum(2.0 * t - 1.0, 0.0)[..., None]
    return np.asarray(first + rest)


def _children(
    rng: np.random.Generator, ends: Array, count: int, spread: float, first: float
) -> tuple[Array, Array]:
    """Return start points and directions of `count` side branches on each branch."""
    n = len(ends)
    t = first + (1.0 - first) * (np.arange(count) + rng.uniform(0.2, 0.8, (n, count))) / count
    start = _along(ends, t).reshape(-1, 3)
    parent = _unit(ends[:, 1, 1] - ends[:, 0, 0])[:, None].repeat(count, 1).reshape(-1, 3)
    side = rng.standard_normal(parent.shape) * (1.0, 1.0, 0.6)
    side = _unit(side - (side * parent).sum(1, keepdims=True) * parent)
    return start, _unit(parent * (1.0 - 0.5 * spread) + side * spread)


def _leaf_colours(
    rng: np.random.Generator, palette: Array, clusters: int, per_cluster: int
) -> Array:
    """Return colours (clusters per_cluster, 3) between palette entries, alike within a cluster."""
    pick = rng.integers(0, len(palette), (2, clusters))
    mix = rng.uniform(0.0, 1.0, (clusters, 1))
    base = palette[pick[0]] * mix + palette[pick[1]] * (1.0 - mix)
    base = np.repeat(base, per_cluster, axis=0)
    jitter = np.exp(0.16 * rng.standard_normal((len(base), 1)))
    tilt = np.exp(0.07 * rng.standard_normal((len(base), 3)))
    return np.asarray(np.clip(base * jitter * tilt, 0.0, 1.0))


def broadleaf(
    seed: list[int], shape: TreeShape, palette: Array, card_count: int, *, leafy: bool = True
) -> Mesh:
    """Grow a broadleaf tree of 12 m.

    Args:
        seed: Of every random choice.
        shape: Its measures.
        palette: Shape (K, 3), linear RGB of its leaves.
        card_count: About how many leaf cards it gets.
        leafy: False for a bare winter tree, with twigs in place of leaves.

    Returns:
        The mesh, foot of the trunk at the origin, NED axes.
    """
    rng = np.random.default_rng(seed)
    height = 12.0
    crown = shape.crown_radius * height
    base = shape.crown_base * height
    # Trunk: six pieces that wander a little.
    levels = np.linspace(-0.3, 0.88 * height, 7)
    sway = np.cumsum(rng.normal(0.0, 0.10, (7, 2)), axis=0)
    trunk = np.concatenate([sway - sway[0], levels[:, None]], axis=1)
    thick = 0.016 * height * np.linspace(1.15, 0.2, 7)
    pieces = [tube(np.stack([trunk[:-1], trunk[1:]], 1), np.stack([thick[:-1], thick[1:]], 1), 8)]
    # Primaries: up the trunk by the golden angle; they end on an ellipsoid.
    n = shape.primaries
    share = (np.arange(n) + rng.uniform(0.2, 0.8, n)) / n
    z = base + share * (0.88 * height - base)
    at = np.stack([np.interp(z, levels, trunk[:, k]) for k in (0, 1)] + [z], axis=1)
    turn = np.arange(n) * _GOLDEN + rng.normal(0.0, 0.3, n)
    rise = np.radians(12.0 + 55.0 * share + rng.normal(0.0, 8.0, n))
    direction = np.stack(
        [np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1
    )
    level = (z - base) / (height - base)
    reach = crown * (np.sin(np.pi * np.clip(0.18 + 0.72 * level, 0.0, 1.0)) ** 0.7)
    length = np.maximum(reach, 0.12 * crown) * rng.uniform(0.8, 1.1, n)
    ends1, radii1 = _branches(at, direction, length, 0.045 * length, rng)
    # Secondaries and tertiaries.
    start, direction = _children(rng, ends1, shape.secondaries, 0.75, 0.25)
    length2 = np.repeat(length, shape.secondaries) * rng.uniform(0.32, 0.55, len(start))
    ends2, radii2 = _branches(start, direction, length2, 0.028 * length2, rng)
    start, direction = _children(rng, ends2, shape.tertiaries, 0.8, 0.2)
    length3 = np.repeat(length2, shape.tertiaries) * rng.uniform(0.40, 0.65, len(start))
    ends3, radii3 = _branches(start, direction, length3, 0.02 * length3, rng)
    for ends, radii, sides in (
        (ends1, radii1, 5),
        (ends2, radii2, 3),
        (ends3[:, :1], radii3[:, :1], 2),
    ):
        pieces.append(tube(ends.reshape(-1, 2, 3), radii.reshape(-1, 2), sides))
    corner, a, b = (np.concatenate(part) for part in zip(*pieces, strict=True))
    bark = np.array(shape.bark) * np.exp(0.15 * rng.standard_normal((len(corner), 1)))
    wood = Mesh.build(corner, a, b, Material.BARK, bark)
    # Cards along the tertiaries.
    twigs = len(ends3)
    per = max(card_count // twigs, 1)
    t = np.clip(rng.uniform(0.15, 1.1, (twigs, per)), 0.0, 1.0)
    foot = _along(ends3, t).reshape(-1, 3)
    foot += rng.normal(0.0, 0.10, foot.shape)
    axis = _unit(ends3[:, 1, 1] - ends3[:, 0, 0]).repeat(per, axis=0)
    axis = _unit(axis + 0.7 * rng.standard_normal(axis.shape) - (0.0, 0.0, 0.25))
    out = _unit(foot - (0.0, 0.0, base + 0.35 * (height - base)))
    normal = _unit(
        0.9 * np.array([0.0, 0.0, 1.0]) + 0.5 * out + 0.45 * rng.standard_normal(foot.shape)
    )
    size = shape.card_m * rng.uniform(0.75, 1.25, len(foot))
    if leafy:
        colour = _leaf_colours(rng, palette, twigs, per)
        leaves = cards(rng, foot, axis, normal, size, size, colour, shape.tile, Material.LEAF)
    else:
        colour = np.array(shape.bark) * np.exp(0.2 * rng.standard_normal((len(foot), 1)))
        leaves = cards(rng, foot, axis, normal, 1.5 * size, size, colour, Tile.TWIGS, Material.BARK)
    return Mesh.join([wood, leaves]).moved(_NED)


def conifer(seed: list[int], shape: TreeShape, palette: Array, card_count: int) -> Mesh:
    """Grow a conifer of 12 m: whorls of drooping branches with flat sprays.

    Args:
        seed: Of every random choice.
        shape: Its measures.
        palette: Shape (K, 3), linear RGB of its needles.
        card_count: About how many spray cards it gets.

    Returns:
        The mesh, foot of the trunk at the origin, NED axes.
    """
    rng = np.random.default_rng(seed)
    height = 12.0
    crown = shape.crown_radius * height
    base = shape.crown_base * height
    levels = np.linspace(-0.3, height, 7)
    trunk = np.stack([np.zeros(7), np.zeros(7), levels], axis=1)
    thick = 0.013 * height * np.linspace(1.1, 0.06, 7)
    pieces = [tube(np.stack([trunk[:-1], trunk[1:]], 1), np.stack([thick[:-1], thick[1:]], 1), 7)]
    whorls = 26
    share = np.repeat(np.linspace(0.0, 0.97, whorls), 7) + rng.normal(0.0, 0.008, whorls * 7)
    share = np.clip(share, 0.0, 0.985)
    z = base + share * (height - base)
    turn = np.tile(np.arange(7) * 2.0 * np.pi / 7, whorls) + np.repeat(
        rng.uniform(0.0, 6.3, whorls), 7
    )
    turn += rng.normal(0.0, 0.15, turn.size)
    length = crown * (1.0 - share) ** 0.85 * rng.uniform(0.75, 1.1, share.size) + 0.15
    droop = np.radians(-14.0 + 42.0 * share + rng.normal(0.0, 5.0, share.size))
    direction = np.stack(
        [np.cos(turn) * np.cos(droop), np.sin(turn) * np.cos(droop), np.sin(droop)], axis=1
    )
    start = np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=1)
    end = start + direction * length[:, None]
    radius = 0.010 * length + 0.006
    pieces.append(tube(np.stack([start, end], 1), np.stack([radius, 0.3 * radius], 1), 3))
    corner, a, b = (np.concatenate(part) for part in zip(*pieces, strict=True))
    bark = np.array(shape.bark) * np.exp(0.15 * rng.standard_normal((len(corner), 1)))
    wood = Mesh.build(corner, a, b, Material.BARK, bark)
    weight = length / length.sum()
    owner = np.repeat(
        np.arange(length.size), np.maximum(np.rint(weight * card_count), 2).astype(int)
    )
    t = rng.uniform(0.12, 1.0, owner.size) ** 0.8
    foot = start[owner] + direction[owner] * (length[owner] * t)[:, None]
    side = np.cross(direction[owner], [0.0, 0.0, 1.0]) * rng.choice([-1.0, 1.0], (owner.size, 1))
    axis = _unit(
        direction[owner]
        + 0.8 * side * (1.0 - 0.6 * t[:, None])
        - (0.0, 0.0, 0.22)
        + 0.12 * rng.standard_normal(foot.shape)
    )
    normal = _unit(np.array([0.0, 0.0, 1.0]) + 0.22 * rng.standard_normal(foot.shape))
    size = shape.card_m * rng.uniform(0.75, 1.3, owner.size) * (0.65 + 0.5 * (1.0 - share[owner]))
    colour = _leaf_colours(rng, palette, owner.size, 1)
    # Young growth at the tips is paler.
    colour = np.clip(colour * (0.8 + 0.45 * t[:, None]), 0.0, 1.0)
    sprays = cards(
        rng, foot, axis, normal, size, 0.75 * size, colour, Tile.NEEDLES, Material.NEEDLE
    )
    return Mesh.join([wood, sprays]).moved(_NED)
