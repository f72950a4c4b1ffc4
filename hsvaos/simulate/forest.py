"""A forest from a seed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hsvaos.simulate.forest_settings import ForestSettings
from hsvaos.simulate.ground import Ground, make_ground
from hsvaos.simulate.instances import Instances, Kind
from hsvaos.simulate.planting import add_bushes, add_litter, add_trees, glade_circles
from hsvaos.simulate.scene import Lighting, Scene
from hsvaos.simulate.seasons import Season, season, sun_direction
from hsvaos.simulate.textures import draw_atlas

__all__ = ["Forest", "ForestSettings", "grow_forest"]

Array = NDArray[np.float64]

_MARGIN_M = 8.0


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

    def cleared(self, north: float, east: float, radius_m: float, *, paint: bool = True) -> Forest:
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
    meadow = add_litter(instances, settings, look, ground)
    bushes = add_bushes(instances, settings, look, ground)
    stems = add_trees(instances, settings, look, ground)
    atlas = draw_atlas(settings.seed)
    return Forest(settings, look, ground, instances, stems, bushes, meadow, atlas)
