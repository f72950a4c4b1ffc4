"""Where trees, bushes, grass and dead wood stand and lie."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.forest_settings import CARDS, ForestSettings
from hsvaos.simulate.ground import Ground
from hsvaos.simulate.instances import Instances, Kind
from hsvaos.simulate.mesh import Mesh
from hsvaos.simulate.seasons import Season
from hsvaos.simulate.tree import broadleaf, conifer
from hsvaos.simulate.undergrowth import GRASS_TILE_M, bush, fern, grass_tile, log

Array = NDArray[np.float64]

VARIANTS = 2
"""Differently grown trees of each species."""
_REFERENCE_HEIGHT_M = 12.0


def glade_circles(settings: ForestSettings) -> Array:
    """Return the places kept free of trees, shape (N, 3): north, east and radius [m]."""
    half = settings.half_m
    rng = np.random.default_rng([settings.seed, 32])
    count = max(int((2.0 * half / 24.0) ** 2 * 1.2), 1)
    radius = np.sqrt(settings.glades * (2.0 * half) ** 2 / (np.pi * count)) * 1.06
    places = rng.uniform(-half, half, (count, 2))
    radii = radius * rng.uniform(0.6, 1.35, (count, 1))
    return np.concatenate([places, radii], axis=1)


def stem_places(settings: ForestSettings) -> Array:
    """Return where trees stand, shape (N, 2), north and east [m].

    Trees keep a distance that shrinks with density (dart throwing in a fixed order, so that two
    densities share the places of the sparser one as far as distances allow).

    Raises:
        ValueError: If the area cannot hold that many trees.
    """
    half = settings.half_m
    area = (2.0 * half) ** 2 / 1e4
    wanted = round(settings.density * area)
    if wanted == 0:
        return np.empty((0, 2))
    rng = np.random.default_rng([settings.seed, 31])
    spacing = max(0.62 * np.sqrt(1e4 / settings.density), 1.0)
    cell = spacing / np.sqrt(2.0)
    side = int(np.ceil(2.0 * half / cell)) + 1
    taken: dict[tuple[int, int], tuple[float, float]] = {}
    places: list[tuple[float, float]] = []
    tries = wanted * 60
    darts = rng.uniform(-half, half, (tries, 2))
    if settings.glades > 0.0:
        free = np.ones(tries, dtype=bool)
        for north, east, radius in glade_circles(settings):
            free &= np.hypot(darts[:, 0] - north, darts[:, 1] - east) > radius
        darts = darts[free]
    for n, e in darts:
        i, j = int((n + half) / cell), int((e + half) / cell)
        near = (
            taken.get((a, b))
            for a in range(max(i - 2, 0), min(i + 3, side))
            for b in range(max(j - 2, 0), min(j + 3, side))
        )
        if all(p is None or (p[0] - n) ** 2 + (p[1] - e) ** 2 >= spacing**2 for p in near):
            taken[(i, j)] = (n, e)
            places.append((n, e))
            if len(places) == wanted:
                return np.array(places)
    raise ValueError(
        f"density {settings.density:g} stems a hectare cannot be reached: with glades of "
        f"{settings.glades:g} and trees {spacing:.1f} m apart, {len(places) / area:.0f} fit"
    )


def _upright(rng: np.random.Generator, scale: float, height: float) -> Array:
    turn = rng.uniform(0.0, 2.0 * np.pi)
    lean = rng.normal(0.0, 0.025, 2)
    c, s = np.cos(turn), np.sin(turn)
    matrix = np.array([[c, -s, lean[0]], [s, c, lean[1]], [0.0, 0.0, 1.0]])
    return np.asarray(matrix * np.array([scale, scale, height]))


def _shade_of(rng: np.random.Generator, spread: float) -> tuple[float, float, float]:
    level = np.exp(spread * rng.standard_normal())
    r, g, b = (level * np.exp(0.4 * spread * rng.standard_normal(3))).tolist()
    return (r, g, b)


def _tree_mesh(settings: ForestSettings, look: Season, number: int, variant: int) -> Mesh:
    kind = look.species[number]
    count = int(CARDS[settings.detail] * settings.leaf_density)
    # Heavy trees have more and smaller cards for the same leaf area.
    finer = np.sqrt(CARDS["light"] / CARDS[settings.detail])
    shape = replace(kind.shape, card_m=kind.shape.card_m * float(finer))
    palette = np.array(kind.palette)
    seed = [settings.seed, 41, number, variant]
    if kind.kind == "conifer":
        return conifer(seed, shape, palette, int(0.7 * count))
    if kind.kind == "bare":
        return broadleaf(seed, shape, palette, int(0.36 * count), leafy=False)
    return broadleaf(seed, shape, palette, count)


def add_trees(
    instances: Instances, settings: ForestSettings, look: Season, ground: Ground
) -> Array:
    """Plant the trees and return their stems, shape (N, 3): north, east and height [m].

    Args:
        instances: Changed in place.
        settings: How many, and from which seed.
        look: Which species.
        ground: Where they stand.

    Raises:
        ValueError: If the density cannot be reached.
    """
    places = stem_places(settings)
    rng = np.random.default_rng([settings.seed, 42])
    share = np.array([s.share for s in look.species])
    kinds = rng.choice(len(share), size=len(places), p=share / share.sum())
    meshes = {
        (k, v): instances.add_mesh(_tree_mesh(settings, look, k, v))
        for k in range(len(share))
        for v in range(VARIANTS)
    }
    stems = np.empty((len(places), 3))
    for row, ((north, east), k) in enumerate(zip(places, kinds, strict=True)):
        height = rng.uniform(*look.species[k].heights_m)
        scale = height / _REFERENCE_HEIGHT_M
        wide = scale * rng.uniform(0.85, 1.2)
        matrix = _upright(rng, wide, scale)
        mesh = meshes[(int(k), int(rng.integers(VARIANTS)))]
        down = float(ground.down_at(north, east))
        instances.add(mesh, Kind.TREE, matrix, (north, east, down), _shade_of(rng, 0.12))
        stems[row] = north, east, height
    return stems


def add_bushes(
    instances: Instances, settings: ForestSettings, look: Season, ground: Ground
) -> tuple[int, ...]:
    """Plant bushes and ferns, in groups, and return the mesh numbers of bushes.

    Args:
        instances: Changed in place.
        settings: How many, and from which seed.
        look: Their colours.
        ground: Where they stand.
    """
    rng = np.random.default_rng([settings.seed, 51])
    leafy = look.name != "snow"
    palette = np.array(look.bush)
    meshes = [
        instances.add_mesh(bush([settings.seed, 52, k], palette, leafy=leafy)) for k in range(3)
    ]
    ferns = [
        instances.add_mesh(fern([settings.seed, 53, k], np.array(look.fern))) for k in range(2)
    ]
    half = settings.half_m
    count = int(settings.bushes * (2.0 * half) ** 2 / 1e4)
    # Bushes come in groups.
    centres = rng.uniform(-half, half, (max(count // 6, 1), 2))
    places = centres[rng.integers(0, len(centres), count)] + rng.normal(0.0, 2.6, (count, 2))
    for north, east in np.clip(places, -half, half):
        pool = meshes if rng.uniform() < 0.5 else ferns
        scale = rng.uniform(0.55, 1.1)
        matrix = _upright(rng, scale, scale)
        place = (north, east, float(ground.down_at(north, east)))
        instances.add(
            pool[int(rng.integers(len(pool)))], Kind.BUSH, matrix, place, _shade_of(rng, 0.15)
        )
    return tuple(meshes)


def add_litter(
    instances: Instances, settings: ForestSettings, look: Season, ground: Ground
) -> tuple[int, ...]:
    """Lay grass, fallen leaves and dead wood and return the mesh numbers of meadow squares.

    Args:
        instances: Changed in place.
        settings: The area and the seed.
        look: Their colours.
        ground: What they lie on.
    """
    rng = np.random.default_rng([settings.seed, 61])
    half = settings.half_m
    grass, litter = np.array(look.grass), np.array([rgb for _, rgb in look.litter])
    plenty = 1.0 - 0.8 * look.ground_snow
    # (tufts, cards of fallen leaves) a tile, from bare forest floor to meadow.
    kinds = [(4, 90), (22, 70), (90, 40), (330, 10)]
    meshes = [
        instances.add_mesh(
            grass_tile(
                [settings.seed, 62, k, v], grass, litter, int(t * plenty) + 1, int(f * plenty) + 1
            )
        )
        for k, (t, f) in enumerate(kinds)
        for v in range(2)
    ]
    count = int(np.ceil(2.0 * half / GRASS_TILE_M))
    centres = (np.arange(count) + 0.5) * GRASS_TILE_M - count * GRASS_TILE_M / 2
    meadow = rng.standard_normal((count + 2, count + 2))
    meadow = (meadow[:-2, 1:-1] + meadow[2:, 1:-1] + meadow[1:-1, :-2] + meadow[1:-1, 2:]) / 2
    glades = glade_circles(settings)
    for i, north in enumerate(centres):
        for j, east in enumerate(centres):
            kind = int(np.clip(1.0 + meadow[i, j] + rng.normal(0.0, 0.4), 0, 2))
            if (np.hypot(glades[:, 0] - north, glades[:, 1] - east) < glades[:, 2]).any():
                kind = 3 if rng.uniform() < 0.6 else 2
            slope = ground.slope_at(north, east, GRASS_TILE_M / 2)
            # Quarter turns and a shear along the slope keep the square's blades on the ground.
            quarter = int(rng.integers(4))
            c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            shear = np.eye(3)
            shear[2, :2] = slope
            place = (north, east, float(ground.down_at(north, east)))
            mesh = meshes[2 * kind + int(rng.integers(2))]
            instances.add(mesh, Kind.LITTER, shear @ turn, place, _shade_of(rng, 0.12))
    logs = [instances.add_mesh(log([settings.seed, 63, k])) for k in range(3)]
    for _ in range(int(70 * (2.0 * half) ** 2 / 1e4)):
        north, east = rng.uniform(-half, half, 2)
        slope = ground.slope_at(north, east, 1.0)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        c, s = np.cos(angle), np.sin(angle)
        matrix = np.array([[c, -s, 0.0], [s, c, 0.0], [0, 0, 1.0]])
        shear = np.eye(3)
        shear[2, :2] = slope
        scale = rng.uniform(0.5, 1.1)
        place = (north, east, float(ground.down_at(north, east)))
        instances.add(
            logs[int(rng.integers(3))],
            Kind.WOOD,
            shear @ matrix * scale,
            place,
            _shade_of(rng, 0.2),
        )
    return tuple(meshes[4:8])
