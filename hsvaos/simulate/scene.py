"""A scene: instances of meshes on a device, its shadow maps, and pictures of it."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera
from hsvaos.kernels import depth_map, raster, shade
from hsvaos.simulate.ground import Ground
from hsvaos.simulate.instances import Instances
from hsvaos.simulate.mesh import MATERIALS, WARMTH, Mesh
from hsvaos.simulate.seasons import Season

Array = NDArray[np.float64]

SKY_DIRECTIONS = 8
_DEEPEST_M = 4.0
_HIGHEST_M = 20.0


@dataclass(frozen=True)
class Lighting:
    """Sun and sky of a scene.

    Args:
        to_sun: Shape (3,), unit vector to the sun, NED.
        cloud: 0 for a clear sky, 1 for a closed cover without shadows.
    """

    to_sun: Array
    cloud: float = 0.0


class Scene:
    """A scene on a device that can be photographed.

    Args:
        instances: Everything in it.
        ground: Its ground colours.
        season: Its lights and snow.
        lighting: Its sun.
        half_m: Shadows are computed within [-half_m, half_m] [m].
        device: Warp device name.
        seed: Of the leaf textures.
        sun_map_size: Side of the sun's depth map [px].
        sky_map_size: Side of each of the sky's depth maps [px].
    """

    def __init__(
        self,
        instances: Instances,
        ground: Ground,
        season: Season,
        lighting: Lighting,
        half_m: float,
        *,
        device: str = "cpu",
        seed: int = 0,
        sun_map_size: int = 4096,
        sky_map_size: int = 1024,
        atlas: NDArray[np.uint8],
    ) -> None:
        if len(instances.mesh) >= raster.MAX_INSTANCES:
            raise ValueError(
                f"a scene may have {raster.MAX_INSTANCES - 1} instances at most, "
                f"got {len(instances.mesh)}: ask for a lower density or a smaller area"
            )
        self.instances = instances
        self.ground = ground
        self.season = season
        self.lighting = lighting
        self.half_m = half_m
        self.device = device
        self.kind = np.array(instances.kind, dtype=np.int32)
        self._mesh = np.array(instances.mesh, dtype=np.int32)
        self._place = np.array(instances.place, dtype=np.float64)
        counts = np.array([len(m) for m in instances.meshes])
        self._count = counts
        self._first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int32)
        joined = Mesh.join(instances.meshes)
        self._patches = raster.Patches()
        self._patches.corner = self._array(joined.corner, wp.vec3)
        self._patches.side_a = self._array(joined.side_a, wp.vec3)
        self._patches.side_b = self._array(joined.side_b, wp.vec3)
        self._patches.info = self._array(joined.info, wp.int32)
        self._patches.colour = self._array(joined.colour, wp.uint32)
        self._alpha = self._array(np.ascontiguousarray(atlas[:, 0]), wp.uint8)
        self._texels = self._array(atlas.reshape(-1), wp.uint8)
        self._tint = self._array(np.array(instances.tint, dtype=np.float32), wp.vec3)
        self._first_of = self._array(self._first[self._mesh], wp.int32)
        self._materials = self._array(MATERIALS, wp.vec4)
        self._warmth = self._array(WARMTH, wp.vec4)
        self._texture = self._array(ground.colour.reshape(-1), wp.uint8)
        spheres = [self._sphere(m) for m in instances.meshes]
        stretch = np.linalg.norm(self._place[:, :, :3], axis=1).max(axis=1)
        middle = np.array([s[0] for s in spheres])[self._mesh]
        self._centre = np.einsum("nij,nj->ni", self._place[:, :, :3], middle) + self._place[:, :, 3]
        self._radius = np.array([s[1] for s in spheres])[self._mesh] * stretch
        self._sun_size = sun_map_size
        self._sky_size = sky_map_size
        self._light: Any = None
        self._lock = threading.Lock()

    def _array(self, values: NDArray[Any], dtype: Any) -> Any:
        return wp.array(values, dtype=dtype, device=self.device)

    @staticmethod
    def _sphere(mesh: Mesh) -> tuple[Array, float]:
        points = mesh.vertices().astype(np.float64)
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        return middle, float(np.linalg.norm(points - middle, axis=1).max())

    # ---- shadow maps ------------------------------------------------------------------------

    def map_frame(self, toward: Array, size: int) -> Array:
        """Return map_from_world, shape (3, 4), of a depth map that looks away from a light.

        Args:
            toward: Shape (3,), unit vector to the light, NED.
            size: Side of the map [px].
        """
        z = -toward / np.linalg.norm(toward)
        helper = np.array([1.0, 0.0, 0.0]) if abs(z[2]) > 0.9 else np.array([0.0, 0.0, 1.0])
        x = np.cross(helper, z)
        x /= np.linalg.norm(x)
        axes = np.stack([x, np.cross(z, x), z])
        side = (-self.half_m, self.half_m)
        box = np.array([[n, e, d] for n in side for e in side for d in (-_HIGHEST_M, _DEEPEST_M)])
        reach = box @ axes[:2].T
        low, high = reach.min(axis=0), reach.max(axis=0)
        scale = (size - 1) / (high - low)
        frame = np.zeros((3, 4))
        frame[:2, :3] = axes[:2] * scale[:, None]
        frame[:2, 3] = -low * scale
        frame[2, :3] = z
        return frame

    def depth_map(
        self, frame: Array, columns: int, rows: int, kinds: ArrayLike | None = None
    ) -> Any:
        """Draw an orthographic depth map.

        Args:
            frame: Shape (3, 4), map_from_world.
            columns: Width [px].
            rows: Height [px].
            kinds: Only instances of these kinds; all if None.

        Returns:
            wp.array of float32, shape (rows columns,) [m]; 1e9 where nothing was hit.
        """
        depth = wp.full(rows * columns, 1.0e9, dtype=float, device=self.device)
        wanted = np.ones(len(self.kind), bool) if kinds is None else np.isin(self.kind, kinds)
        for mesh in range(len(self._count)):
            which = np.flatnonzero((self._mesh == mesh) & wanted)
            if which.size:
                depth_map.draw_depth(
                    self._patches,
                    int(self._first[mesh]),
                    int(self._count[mesh]),
                    _compose(frame, self._place[which]),
                    self._alpha,
                    columns,
                    rows,
                    depth,
                )
        return depth

    def _make_maps(self) -> None:
        self._sun_frame = self.map_frame(self.lighting.to_sun, self._sun_size)
        turn = np.arange(SKY_DIRECTIONS) * 2.4
        # Directions spread evenly over the sky above 25 degrees, weighted by the cosine.
        rise = np.arcsin(np.sqrt(np.linspace(0.25, 0.985, SKY_DIRECTIONS)))
        toward = np.stack(
            [np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), -np.sin(rise)], axis=1
        )
        self._sky_frames = np.stack([self.map_frame(t, self._sky_size) for t in toward])
        jobs = [(self._sun_frame, self._sun_size)] + [(f, self._sky_size) for f in self._sky_frames]
        with ThreadPoolExecutor(2 if self.device == "cpu" else 1) as pool:
            maps = list(pool.map(lambda job: self.depth_map(job[0], job[1], job[1]), jobs))
        self._sun_depth = maps[0]
        sky = wp.empty(SKY_DIRECTIONS * self._sky_size**2, dtype=float, device=self.device)
        for m, depth in enumerate(maps[1:]):
            wp.copy(sky, depth, dest_offset=m * self._sky_size**2, count=self._sky_size**2)
        self._sky_depth = sky
        self._light = self._make_light()

    def prepare(self) -> None:
        """Draw the shadow maps now; the first `radiance` does it otherwise."""
        with self._lock:
            if self._light is None:
                self._make_maps()

    def _make_light(self) -> Any:
        light = shade.Light()
        season, cloud = self.season, self.lighting.cloud
        low = float(np.clip(-self.lighting.to_sun[2], 0.0, 1.0))
        # A low sun is dimmer and redder (longer way through the air).
        air = np.exp(-np.array([0.08, 0.13, 0.24]) * (1.0 / max(low, 0.1) - 1.0))
        light.sun_direction = wp.vec3(*self.lighting.to_sun.tolist())
        light.sun = wp.vec3(*(np.array(season.sun) * air * (1.0 - cloud)).tolist())
        light.sky = wp.vec3(*(np.array(season.sky) * (1.0 + 1.6 * cloud)).tolist())
        light.bounce = wp.vec3(*(np.array(season.bounce) * (0.35 + 0.65 * (1.0 - cloud))).tolist())
        light.sun_size, light.sky_size = self._sun_size, self._sky_size
        light.sky_count = SKY_DIRECTIONS
        light.sun_bias, light.sky_bias = 0.05, 0.22
        light.snow = season.snow
        return light

    # ---- pictures ---------------------------------------------------------------------------

    def visible_instances(self, camera: Camera, camera_from_world: Array) -> NDArray[np.int64]:
        """Return the numbers of the instances whose spheres reach into the picture, near first."""
        centre = self._centre @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
        edge = _border(camera)
        inside = centre[:, 2] > raster.NEAR_M - self._radius
        for axis in (0, 1):
            for bound, sign in ((edge[axis].min(), -1.0), (edge[axis].max(), 1.0)):
                distance = sign * (centre[:, axis] - bound * centre[:, 2]) / np.hypot(1.0, bound)
                inside &= distance < self._radius
        found = np.flatnonzero(inside)
        return found[np.argsort(centre[found, 2] - self._radius[found], kind="stable")]

    def keys(
        self,
        camera: Camera,
        world_from_camera: ArrayLike,
        rays: Any,
        only: ArrayLike | None = None,
    ) -> Any:
        """Draw the key buffer of a photo.

        Args:
            camera: Its lens.
            world_from_camera: Shape (4, 4), its pose.
            rays: From `ray_table`.
            only: Numbers of the instances to draw; all if None.

        Returns:
            wp.array of uint64, shape (H W,).
        """
        camera_from_world = np.linalg.inv(np.asarray(world_from_camera, dtype=np.float64))
        keys = wp.full(
            camera.width * camera.height, int(raster.EMPTY), dtype=wp.uint64, device=self.device
        )
        seen = self.visible_instances(camera, camera_from_world)
        if only is not None:
            seen = seen[np.isin(seen, only)]
        lens = raster.lens_of(camera)
        # Trees first: most of what lies beneath them is then rejected before any texture is read.
        for mesh in sorted(set(self._mesh[seen].tolist()), key=lambda m: -m):
            which = seen[self._mesh[seen] == mesh]
            raster.draw(
                self._patches,
                int(self._first[mesh]),
                int(self._count[mesh]),
                _compose(camera_from_world[:3], self._place[which]),
                which.astype(np.int32),
                lens,
                rays,
                self._alpha,
                keys,
            )
        return keys

    def radiance(
        self, camera: Camera, world_from_camera: ArrayLike, rays: Any, keys: Any
    ) -> NDArray[np.float32]:
        """Shade a key buffer.

        Args:
            camera: Its lens.
            world_from_camera: Shape (4, 4), its pose.
            rays: From `ray_table`.
            keys: From `keys`.

        Returns:
            Shape (H, W, 4), float32: linear R, G, B and surface temperature [deg C].
        """
        self.prepare()
        pose = np.asarray(world_from_camera, dtype=np.float64)
        inverse = np.asarray(np.linalg.inv(pose), dtype=np.float64)
        moved = _compose(inverse[:3], self._place).astype(np.float32)
        ground = shade.Ground()
        ground.texel, ground.size = self.ground.texel_m, len(self.ground.colour)
        ground.north0 = self.ground.half_m - 0.5 * self.ground.texel_m
        ground.east0 = -self.ground.half_m + 0.5 * self.ground.texel_m
        out = wp.empty(keys.shape[0], dtype=wp.vec4, device=self.device)
        shade.shade(
            [
                keys,
                rays,
                raster.lens_of(camera),
                self._patches,
                self._first_of,
                self._array(np.ascontiguousarray(moved[:, :, :3]), wp.mat33),
                self._array(np.ascontiguousarray(moved[:, :, 3]), wp.vec3),
                self._tint,
                wp.mat33(*pose[:3, :3].ravel().tolist()),
                wp.vec3(*pose[:3, 3].tolist()),
                self._texels,
                self._materials,
                self._warmth,
                self._light,
                wp.mat33(*self._sun_frame[:, :3].ravel().tolist()),
                wp.vec3(*self._sun_frame[:, 3].tolist()),
                self._sun_depth,
                self._array(self._sky_frames[:, :, :3].astype(np.float32), wp.mat33),
                self._array(self._sky_frames[:, :, 3].astype(np.float32), wp.vec3),
                self._sky_depth,
                ground,
                self._texture,
            ],
            out,
        )
        light: NDArray[np.float32] = out.numpy()  # type: ignore[no-untyped-call]
        return light.reshape(camera.height, camera.width, 4)


def _border(camera: Camera) -> Array:
    """Return x/z and y/z along the border of the picture, shape (2, K)."""
    x = np.linspace(-0.5, camera.width - 0.5, 33)
    y = np.linspace(-0.5, camera.height - 0.5, 33)
    pixels = np.concatenate(
        [
            np.stack([x, np.full(33, y[0])], 1),
            np.stack([x, np.full(33, y[-1])], 1),
            np.stack([np.full(33, x[0]), y], 1),
            np.stack([np.full(33, x[-1]), y], 1),
        ]
    )
    return camera.back_project(pixels)[:, :2].T.copy()


def _compose(outer: Array, inner: Array) -> Array:
    """Return outer (3, 4) after each inner (N, 3, 4)."""
    result = np.asarray(np.einsum("ij,njk->nik", outer[:, :3], inner), dtype=np.float64)
    result[:, :, 3] += outer[:, 3]
    return result
