"""The gather of packed photos on the CPU: 16 x 16 pixels at a time, frames outside, in vectors.

A tile's pixels stay in the nearest cache while all frames pass over it. Frames that cannot see a
tile are skipped by a test of its bounding sphere against the sides of their view, sixteen frames
at once; where the sphere lies inside a view no pixel is tested. The inner loop is plain C, which
the compiler turns into the vector instructions of the machine at hand.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.kernels.arrays import pixel_view
from hsvaos.kernels.device import launch
from hsvaos.kernels.packing import Packed
from hsvaos.kernels.rays import PlaneMap
from hsvaos.kernels.tile_forms import FORMS
from hsvaos.kernels.tile_source import tile_source
from hsvaos.kernels.tile_ways import WAYS

wp.set_module_options({"enable_backward": False})

TILE = 16
"""Side of a tile [px]: one vector of 32-bit numbers."""

_GRAIN = 8
"""Tiles below which a band is not worth a thread."""


@wp.struct
class TileJob:
    """What all tiles of an integral share; see `gather_tiles`."""

    width: int
    height: int
    points: wp.array(dtype=wp.vec4)
    count: int
    poses: wp.array(dtype=float)
    sides: wp.array(dtype=float)
    planes: int
    maps: wp.array(dtype=wp.float64)
    placed: wp.array(dtype=wp.float64)
    distorted: int
    right: float
    bottom: float
    reach: float
    row_stride: int
    frame_stride: int
    weight_unit: float
    white: float
    words: wp.array2d(dtype=wp.uint32)
    image: wp.array(dtype=float)
    footprint: wp.array(dtype=float)


@lru_cache
def _tile_kernel(form: str, way: str) -> Any:
    @wp.func_native(tile_source(FORMS[form], WAYS[way]))
    def gather_tile(index: int, job: TileJob): ...

    @wp.kernel(module="unique", enable_backward=False)
    def tile_kernel(offset: int, band: int, job: TileJob):
        gather_tile(wp.tid() + offset, job)

    return tile_kernel


@dataclass(frozen=True, eq=False)
class TilePhotos:
    """Photos to be gathered, and from where.

    Args:
        camera: Camera of the photos.
        packed: The photos.
        poses: Shape (N, 4, 4), world from camera, relative to the view's centre.
        gains: Shape (N, 3), factors on the channels.
        order: Numbers of the frames to use.
    """

    camera: Camera
    packed: Packed
    poses: NDArray[np.float64]
    gains: NDArray[np.float64]
    order: NDArray[np.int32]


def gather_tiles(
    photos: TilePhotos,
    reach: float,
    points: Any,
    size: tuple[int, int],
    image: Any,
    footprint: Any,
) -> None:
    """Integrate packed photos at given points, on the CPU.

    Args:
        photos: The photos.
        reach: Greatest horizontal distance of a photo from a point [m].
        points: Warp array (H * W) of vec4, see `focal_points`.
        size: (width, height) of the view [px].
        image: Warp array (H * W * C), float32, written.
        footprint: Warp array (H * W), float32, written.
    """
    job = _tile_job(photos, size, image, footprint)
    job.points = points
    job.reach = reach
    job.planes = 1
    _launch(photos, job, "points")


def gather_planes(
    photos: TilePhotos,
    maps: list[PlaneMap],
    size: tuple[int, int],
    image: Any,
    footprint: Any,
) -> None:
    """Integrate packed photos over planes, for a view without distortion, on the CPU.

    Tile by tile, all planes of it: what the photos show of a tile stays in the cache meanwhile.

    Args:
        photos: The photos.
        maps: From pixels of the view to points of each plane, see `rays.plane_map`.
        size: (width, height) of the view [px].
        image: Warp array (D * H * W * C), float32, written.
        footprint: Warp array (D * H * W), float32, written.
    """
    job = _tile_job(photos, size, image, footprint)
    rows = [[*part.points.ravel(), *part.scales, part.least] for part in maps]
    job.maps = wp.array(np.concatenate(rows), dtype=wp.float64, device="cpu")
    rotation, centres = _projections(photos)
    placed = np.concatenate([rotation.reshape(-1, 9).T, centres.T])
    job.placed = wp.array(placed.ravel(), dtype=wp.float64, device="cpu")
    job.planes = len(maps)
    _launch(photos, job, "plane")


def _launch(photos: TilePhotos, job: TileJob, way: str) -> None:
    tiles = -(-job.width // TILE) * -(-job.height // TILE)
    kernel = _tile_kernel(photos.packed.form, way)
    launch(kernel, tiles * job.planes, [job], wp.get_device("cpu"), _GRAIN)


def _projections(photos: TilePhotos) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Matrices that bring directions into the photos, in pixels where no lens distorts; centres."""
    chosen = photos.poses[photos.order]
    rotation = chosen[:, :3, :3].transpose(0, 2, 1)
    if not photos.camera.has_distortion:
        rotation = photos.camera.matrix() @ rotation
    return rotation, chosen[:, :3, 3]


def _tile_job(photos: TilePhotos, size: tuple[int, int], image: Any, footprint: Any) -> TileJob:
    """Return what all tiles share, whichever way leads into the photos."""
    camera, packed, order = photos.camera, photos.packed, photos.order
    rotation, centres = _projections(photos)
    rows = np.empty((16, len(order)), np.float32)
    rows[:9] = rotation.reshape(-1, 9).T
    rows[9:12] = centres.T
    rows[12] = order.astype(np.int32).view(np.float32)
    rows[13:16] = photos.gains[order].T
    job = TileJob()
    job.width, job.height = size
    job.count = len(order)
    job.poses = wp.array(rows.ravel(), dtype=float, device="cpu")
    job.sides = wp.array(_sides(camera), dtype=float, device="cpu")
    job.distorted = int(camera.has_distortion)
    job.right, job.bottom = camera.width - 0.5, camera.height - 0.5
    job.row_stride, job.frame_stride = packed.row, packed.frame
    job.weight_unit, job.white = packed.weight_unit, packed.white
    job.words = packed.words
    job.image = pixel_view(image, wp.float32, (image.size,))
    job.footprint = pixel_view(footprint, wp.float32, (footprint.size,))
    return job


def _sides(camera: Camera) -> NDArray[np.float32]:
    """Return the sides of a camera's view, and its lens, as the tile gather wants them.

    A side is a plane x = a z through the camera's centre, x in pixels (of normalised coordinates
    where the lens distorts): the four a, 0, the four factors that make x - a z a distance [m],
    and the intrinsics, the distortion and the square of the greatest radius.
    """
    if camera.has_distortion:
        a = _undistorted_bounds(camera)
        scale = np.ones(4)
        shift = np.zeros(4)
    else:
        a = np.array([-0.5, camera.width - 0.5, -0.5, camera.height - 0.5])
        scale = np.repeat([camera.fx, camera.fy], 2)
        shift = np.repeat([camera.cx, camera.cy], 2)
    # the rotation may be off by 1e-3 (see check_pose): the factor of 0.99 keeps the test safe
    factors = 0.99 / np.hypot(scale, a - shift)
    lens = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
    return np.array([*a, 0.0, *factors, *lens, min(camera.max_radius**2, 1e30)], np.float32)


def _undistorted_bounds(camera: Camera) -> NDArray[np.float64]:
    """Bounds of the normalised coordinates that the lens maps into the photo: x, x, y, y."""
    right, bottom = camera.width - 0.5, camera.height - 0.5
    across, along = np.linspace(-0.5, right, 65), np.linspace(-0.5, bottom, 65)
    border = np.concatenate(
        [
            *(np.column_stack([across, np.full(65, y)]) for y in (-0.5, bottom)),
            *(np.column_stack([np.full(65, x), along]) for x in (-0.5, right)),
        ]
    )
    rays = camera.back_project(border)[:, :2]
    if not np.isfinite(rays).all():  # the lens ends within the photo
        radius = min(camera.max_radius, 1e3)
        return np.array([-radius, radius, -radius, radius])
    low, high = rays.min(axis=0), rays.max(axis=0)
    margin = 0.02 * (high - low)
    low, high = low - margin, high + margin
    return np.array([low[0], high[0], low[1], high[1]])
