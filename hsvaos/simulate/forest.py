"""A forest from a seed: which trees, bushes, grass and dead wood stand where."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.ground import Ground, make_ground
from hsvaos.simulate.mesh import Mesh
from hsvaos.simulate.scene import Instances, Kind, Lighting, Scene
from hsvaos.simulate.seasons import SEASONS, Season, season, sun_direction
from hsvaos.simulate.textures import draw_atlas
from hsvaos.simulate.tree import broadleaf, conifer
from hsvaos.simulate.undergrowth import GRASS_TILE_M, bush, fern, grass_tile, log

Array = NDArray[np.float64]

CARDS = {"light": 5500, "heavy": 26000}
"""Leaf cards a tree by detail."""
VARIANTS = 2
"""Differently grown trees of each species."""
_MARGIN_M = 8.0
_REFERENCE_HEIGHT_M = 12.0


@dataclass(frozen=True)
class ForestSettings:
    """What forest to grow.

    Args:
        season: "summer", "fall" or "snow".
        density: Stems a hectare.
        seed: Of everything.
        half_m: Trees stand within [-half_m, half_m] both ways [m].
        leaf_density: Factor on the number of leaf cards a tree.
        relief_m: Standard deviation of the ground's heights [m].
        glades: Share of the area kept free of trees, in patches of about 12 m (0-0.8).
        bushes: Bushes and ferns a hectare.
        sun_elevation_deg: Above the horizon [deg].
        sun_azimuth_deg: From north over east [deg].
        cloud: 0 for clear sky, 1 for closed cover.
        detail: "light" or "heavy" trees.

    Raises:
        ValueError: If a value is out of its range.
    """

    season: str = "summer"
    density: float = 450.0
    seed: int = 0
    half_m: float = 66.0
    leaf_density: float = 1.0
    relief_m: float = 0.25
    glades: float = 0.08
    bushes: float = 160.0
    sun_elevation_deg: float = 48.0
    sun_azimuth_deg: float = 150.0
    cloud: float = 0.0
    detail: str = "light"

    def __post_init__(self) -> None:
        if self.season not in SEASONS:
            raise ValueError(f"season must be one of {', '.join(SEASONS)}, got {self.season!r}")
        if self.detail not in CARDS:
            raise ValueError(f"detail must be one of {', '.join(CARDS)}, got {self.detail!r}")
        checks = (
            ("density", self.density, 0.0, 5000.0, "stems a hectare"),
            ("half_m", self.half_m, 2.0, 500.0, "metres"),
            ("leaf_density", self.leaf_density, 0.05, 8.0, "a factor"),
            ("relief_m", self.relief_m, 0.0, 3.0, "metres"),
            ("glades", self.glades, 0.0, 0.8, "a share"),
            ("bushes", self.bushes, 0.0, 2000.0, "a hectare"),
            ("cloud", self.cloud, 0.0, 1.0, "a share"),
        )
        for name, value, low, high, unit in checks:
            if not (np.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} must lie in {low:g} to {high:g} ({unit}), got {value!r}")
        if self.seed < 0:
            raise ValueError(f"seed must be 0 or more, got {self.seed!r}")
        sun_direction(self.sun_elevation_deg, self.sun_azimuth_deg)

    def replace(self, **changes: object) -> ForestSettings:
        """Return the settings with some changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Forest:
    """A grown forest, before people come.

    Args:
        settings: What was asked for.
        season: Its colours and lights.
        ground: Its floor.
        instances: Everything that stands and lies on it.
        stems: Shape (N, 3): north, east [m] and height [m] of every tree.
        bush_mesh: Mesh numbers of leafy bushes, for hiding people under one.
        meadow_mesh: Mesh numbers of squares of meadow, for clearings.
        atlas: Leaf textures.
    """

    settings: ForestSettings
    season: Season
    ground: Ground
    instances: Instances
    stems: Array
    bush_mesh: tuple[int, ...]
    meadow_mesh: tuple[int, ...]
    atlas: NDArray[np.uint8]

    def cleared(
        self, north: float, east: float, radius_m: float, *, paint: bool = True
    ) -> Forest:
        """Return the forest without the trees that stand within a circle.

        Args:
            north: Middle of the clearing [m].
            east: Middle of the clearing [m].
            radius_m: Its radius [m].
            paint: Whether to paint the ground as a meadow too, which takes a few seconds.
        """
        old = self.instances
        kept = [
            k
            for k in range(len(old.mesh))
            if old.kind[k] != Kind.TREE
            or np.hypot(old.place[k][0, 3] - north, old.place[k][1, 3] - east) >= radius_m
        ]
        kept_mesh = [
            self.meadow_mesh[k * 7 % 5 % len(self.meadow_mesh)]
            if old.kind[k] == Kind.LITTER
            and np.hypot(old.place[k][0, 3] - north, old.place[k][1, 3] - east) < radius_m - 2.0
            else old.mesh[k]
            for k in kept
        ]
        instances = Instances(
            list(old.meshes),
            kept_mesh,
            [old.place[k] for k in kept],
            [old.tint[k] for k in kept],
            [old.kind[k] for k in kept],
        )
        away = np.hypot(self.stems[:, 0] - north, self.stems[:, 1] - east) >= radius_m
        ground = self.ground
        if paint and self.season.ground_snow == 0.0:
            circle = np.array([[north, east, radius_m]])
            grass = np.array(self.season.grass)
            ground = ground.with_meadow(circle, grass, [self.settings.seed, 23])
        return replace(self, instances=instances, stems=self.stems[away], ground=ground)

    def lighting(self) -> Lighting:
        """Return the sun of the settings."""
        s = self.settings
        return Lighting(sun_direction(s.sun_elevation_deg, s.sun_azimuth_deg), s.cloud)

    def scene(
        self,
        instances: Instances | None = None,
        *,
        device: str = "cpu",
        sun_map_size: int = 4096,
        sky_map_size: int = 1024,
    ) -> Scene:
        """Return the scene of this forest, or of it with more instances.

        Args:
            instances: Copy of `self.instances` with people and stakes; the bare forest if None.
            device: Warp device.
            sun_map_size: Side of the sun's depth map [px].
            sky_map_size: Side of the sky's depth maps [px].
        """
        return Scene(
            self.instances if instances is None else instances,
            self.ground,
            self.season,
            self.lighting(),
            self.settings.half_m + _MARGIN_M,
            device=device,
            sun_map_size=sun_map_size,
            sky_map_size=sky_map_size,
            atlas=self.atlas,
        )


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
    wanted = int(round(settings.density * area))
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


def grow_forest(settings: ForestSettings) -> Forest:
    """Grow a forest.

    Args:
        settings: What forest.

    Raises:
        ValueError: If the density cannot be reached.
    """
    look = season(settings.season)
    half = settings.half_m
    texture = int(np.clip(2.0 * (half + _MARGIN_M) / 0.036, 256, 4096))
    ground = make_ground(settings.seed, look, half + _MARGIN_M, settings.relief_m, texture)
    if look.ground_snow == 0.0 and settings.glades > 0.0:
        circles = glade_circles(settings) - (0.0, 0.0, 1.0)
        ground = ground.with_meadow(circles, np.array(look.grass), [settings.seed, 22])
    instances = Instances()
    # Meshes drawn last come first: ground, then what lies on it, then bushes, then trees.
    for mesh, place in ground.tiles():
        instances.add(instances.add_mesh(mesh), Kind.GROUND, np.eye(3), place)
    meadow = _add_litter(instances, settings, look, ground)
    bushes = _add_bushes(instances, settings, look, ground)
    stems = _add_trees(instances, settings, look, ground)
    atlas = draw_atlas(settings.seed)
    return Forest(settings, look, ground, instances, stems, bushes, meadow, atlas)


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


def _add_trees(
    instances: Instances, settings: ForestSettings, look: Season, ground: Ground
) -> Array:
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


def _add_bushes(
    instances: Instances, settings: ForestSettings, look: Season, ground: Ground
) -> tuple[int, ...]:
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


def _add_litter(
    instances: Instances, settings: ForestSettings, look: Season, ground: Ground
) -> tuple[int, ...]:
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
        turn = rng.uniform(0.0, 2.0 * np.pi)
        matrix = np.array(
            [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0, 0, 1.0]]
        )
        shear = np.eye(3)
        shear[2, :2] = slope
        scale = rng.uniform(0.5, 1.1)
        place = (north, east, float(ground.down_at(north, east)))
        instances.add(
            logs[int(rng.integers(3))], Kind.WOOD, shear @ matrix * scale, place, _shade_of(rng, 0.2)
        )
    return tuple(meshes[4:8])
