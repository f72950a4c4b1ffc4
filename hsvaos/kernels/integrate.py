"""Integral images: every output pixel gathers every photo at its focal point."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera, VirtualCamera, check_pose
from hsvaos.kernels.arrays import (
    Stack,
    check_gains,
    device_of,
    is_binary,
    like_input,
    output_array,
    pixel_view,
    require_unit_range,
    to_array,
)
from hsvaos.kernels.coherence import gather_coherence
from hsvaos.kernels.device import free_memory, in_vectors
from hsvaos.kernels.gather import PlacedPhotos, gather
from hsvaos.kernels.lens import lens
from hsvaos.kernels.packing import Packed, pack, pair_rows
from hsvaos.kernels.rays import held_points, plane_map
from hsvaos.kernels.stations import Stations
from hsvaos.kernels.tiles import TilePhotos, gather_planes, gather_tiles
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain

wp.set_module_options({"enable_backward": False})

_NO_LIMIT = 1e15
"""Radius of an aperture without limit [m]; float32 holds its square."""

_NOT_YET = object()

_WEIGHTS = "bool, uint8, uint16 or float32"

_MANY_PLANES = 8
"""Planes as large as the photos from which on these are worth another copy in a faster form."""


class Integrator:
    """Photos held on a device, ready to be integrated from any virtual camera.

    On the CPU the first integral packs photos and weights into a form that is fast to gather,
    which takes 4 bytes a pixel more (8 for RGB that is not uint8 or has float weights), and the
    first focal stack of 8 planes or more takes another 8 for uint8 RGB under a mask, where they are
    free; what is written into the photos' memory after that is not seen. See `kernels.packing` for
    what is rounded, and `kernels.gather` for the plain kernel, which runs where rounding would cost
    accuracy, and on CUDA. There photos and poses are brought over once; an integral into `out` of
    the device allocates nothing after the first one of its size and waits for nothing, so that a
    CUDA graph (`warp.ScopedCapture`) can hold it. Only lists of `frames` with gaps, and those that
    an aperture leaves, are brought over anew.

    Args:
        camera: The camera of all photos.
        images: Shape (N, H, W, 3) RGB or (N, H, W) grey; uint8, uint16 or float32; NumPy, DLPack
            or `__cuda_array_interface__`. Nothing is copied that already lies on the device.
        world_from_camera: Shape (N, 4, 4), pose of each photo, world NED [m].
        weights: Shape (N, H, W), or (H, W) for all photos, how much each pixel counts: uint8 (255 =
            weight 1; or a mask of only 0 and 1), uint16 (65535 = weight 1), bool or float32 (not
            negative); None for 1 everywhere.
        device: "cpu", "cuda:0", ...; by default where the images lie.
        gains: Shape (N, 3), factors on R, G and B of each photo (the first one on grey); see
            `kernels.levels`; None for the photos as they are.
        packed: These photos with these weights, packed before, by `kernels.hue_pack`.

    Raises:
        ValueError: If shapes do not fit the camera or each other, a pose holds no rotation, or the
            device is not on this machine.
        TypeError: If a type is not supported.
    """

    def __init__(
        self,
        camera: Camera,
        images: Any,
        world_from_camera: ArrayLike,
        weights: Any = None,
        device: Any = None,
        *,
        gains: Any = None,
        packed: Packed | None = None,
    ) -> None:
        self.device = device_of(images, device)
        self.camera = camera
        self._stack = Stack(images, self.device)
        self._like = None if isinstance(images, (list, tuple)) else images
        stack = self._stack
        if (stack.width, stack.height) != (camera.width, camera.height):
            raise ValueError(
                f"images must have the camera's size {camera.width} x {camera.height}, "
                f"got {stack.width} x {stack.height}"
            )
        self.world_from_camera = _checked_poses(world_from_camera, stack.count)
        weights = self._without_gaps(weights)
        self._gains = check_gains(gains, stack)
        self._weights, self._weight_unit = self._check_weights(weights)
        self._given = packed
        self._packed: Any = _NOT_YET if packed is None else packed
        self._pairs: Packed | None = None
        self._packing = Lock()
        self._stations: Stations | None = None

    def _without_gaps(self, weights: Any) -> Any:
        """Give pixels of float photos that are not finite the value and the weight 0."""
        if self._stack.scalar is not wp.float32:
            return weights
        values = self._stack.array.numpy()
        finite = np.isfinite(values).reshape(*values.shape[:3], -1).all(axis=-1)
        if finite.all():
            return weights
        where = finite if self._stack.channels == 1 else finite[..., None]
        self._stack = Stack(np.where(where, values, np.float32(0.0)), self.device)
        if weights is None:
            return finite
        given, unit = self._check_weights(weights)
        size = (self._stack.height, self._stack.width)
        share = given.numpy().reshape(-1, *size).astype(np.float32) * np.float32(unit)
        return np.where(finite, share, np.float32(0.0))

    def _check_weights(self, weights: Any) -> tuple[Any, float]:
        stack = self._stack
        if weights is None:
            return wp.empty((1, 1), dtype=wp.uint8, device=self.device), 0.0
        host = isinstance(weights, np.ndarray)
        if host and weights.dtype.name not in ("bool", "uint8", "uint16", "float32"):
            raise TypeError(f"weights must be {_WEIGHTS}, got {weights.dtype.name}")
        if host and weights.dtype.kind == "f" and not (weights >= 0.0).all():
            raise ValueError("weights must not be negative or NaN")
        array = to_array(weights, self.device, "weights")
        shape = tuple(array.shape)
        size = (stack.height, stack.width)
        if shape not in (size, (stack.count, *size)):
            raise ValueError(f"weights must have shape {(stack.count, *size)}, got {shape}")
        if array.dtype not in (wp.uint8, wp.uint16, wp.float32):
            raise TypeError(f"weights must be {_WEIGHTS}, got {array.dtype.__name__}")
        rows = pixel_view(array, array.dtype, (array.size // stack.size, stack.size))
        if array.dtype is wp.uint16:
            return rows, 1.0 / 65535.0
        bytes_of_weight = array.dtype is wp.uint8 and not is_binary(rows)
        return rows, 1.0 / 255.0 if bytes_of_weight else 1.0

    def at_poses(self, world_from_camera: ArrayLike) -> Integrator:
        """Return an integrator of the same photos, as they are held, taken from other poses.

        Args:
            world_from_camera: Shape (N, 4, 4), pose of each photo, world NED [m].

        Raises:
            ValueError: If the shape is not (N, 4, 4) or a pose holds no rotation.
        """
        self._photos()
        other = copy(self)
        other.world_from_camera = _checked_poses(world_from_camera, len(self))
        other._stations = None
        return other

    def release(self) -> None:
        """Let the packed photos go, where memory is short: the next integral packs them anew."""
        with self._packing:
            self._packed = _NOT_YET if self._given is None else self._given
            self._pairs = None

    def __len__(self) -> int:
        return self._stack.count

    @property
    def channels(self) -> int:
        """Channels of the integral image: 3 or 1."""
        return self._stack.channels

    def integrate(
        self,
        view: VirtualCamera,
        surface: FocalSurface,
        aperture_m: float | None = None,
        frames: Sequence[int] | None = None,
        out: tuple[Any, Any] | None = None,
    ) -> tuple[Any, Any]:
        """Render the integral image of a virtual camera.

        Every pixel casts a ray to the focal surface; there it gathers the photos that see the
        point, bilinearly, and takes the mean weighted by `weights`. A photo sees a point that lies
        in front of its camera and within the area of its pixels.

        Args:
            view: Virtual camera at any pose, or orthographic ground grid.
            surface: Focal plane or terrain.
            aperture_m: Radius of the synthetic aperture [m]: only photos taken within this
                horizontal distance of the virtual camera count (for a ground grid: of the point
                itself); None for all.
            frames: Numbers of the photos to use; None for all.
            out: (image, footprint) arrays, written in place; new if None.

        Returns:
            image, shape (H, W, C) float32 in units of the photos, and footprint, shape (H, W)
            float32, the sum of weights. Where the footprint is 0 the image is 0; no NaN.

        Raises:
            ValueError: If the aperture or a frame number makes no sense, or out does not fit.
            TypeError: If surface is no focal surface.
        """
        order, reach, image, footprint = self._target(view, surface, aperture_m, frames, out)
        self._gather(view, [surface], order, reach, image, footprint)
        if out is not None:
            return out
        return like_input(image, self._like), like_input(footprint, self._like)

    def sweep(
        self,
        view: VirtualCamera,
        downs_m: ArrayLike,
        aperture_m: float | None = None,
        frames: Sequence[int] | None = None,
        out: tuple[Any, Any] | None = None,
    ) -> tuple[Any, Any]:
        """Render the focal stack of a virtual camera: one integral image a horizontal plane.

        Args:
            view: Virtual camera at any pose, or orthographic ground grid.
            downs_m: Shape (D,), down of each focal plane [m].
            aperture_m: See `integrate`.
            frames: See `integrate`.
            out: (stack, footprint) arrays, written in place; new if None.

        Returns:
            stack, shape (D, H, W, C) float32, and footprint, shape (D, H, W) float32.

        Raises:
            ValueError: If there is no plane, or a parameter makes no sense.
        """
        downs = np.asarray(downs_m, dtype=np.float64)
        if downs.ndim != 1 or downs.size == 0 or not np.isfinite(downs).all():
            raise ValueError(f"downs_m must be a list of finite depths, got {downs_m!r}")
        check_view(view)
        order, reach = self._select(view, aperture_m, frames)
        shape = (downs.size, view.height, view.width)
        given = check_pair(out)
        channels = self._stack.channels
        stack = output_array(given[0], (*shape, channels), wp.float32, self.device, "out[0]")
        footprint = output_array(given[1], shape, wp.float32, self.device, "out[1]")
        surfaces = [FocalPlane(float(down)) for down in downs]
        self._gather(view, surfaces, order, reach, stack, footprint)
        if out is not None:
            return out
        return like_input(stack, self._like), like_input(footprint, self._like)

    def coherence(
        self,
        view: VirtualCamera,
        surface: FocalSurface,
        aperture_m: float | None = None,
        frames: Sequence[int] | None = None,
        out: tuple[Any, Any] | None = None,
    ) -> tuple[Any, Any]:
        """Measure whether the rays that count at a point agree on a colour.

        With weights w (rarity), colours c (CIE Lab, lightness halved) and the n rays of a point
        whose weight is not 0: coherence = sqrt(max_i w_i sum_j w_j exp(-|c_i - c_j|^2 / 16^2) / n),
        over the 16 heaviest rays of weight .02 and more. Photos are read at the nearest pixel.

        Args:
            view: Virtual camera at any pose, or orthographic ground grid.
            surface: Focal plane or terrain.
            aperture_m: See `integrate`.
            frames: See `integrate`.
            out: (image, coherence) arrays, written in place; new if None.

        Returns:
            image, shape (H, W, C) float32 in units of the photos, the mean colour of the rays that
            agree with the greatest, and coherence, shape (H, W) float32, 0..1. Both are 0 where no
            ray has a weight of .02.

        Raises:
            ValueError: If the aperture or a frame number makes no sense, or out does not fit; if
                photos are float32 beyond 0..1.
            TypeError: If surface is no focal surface.
        """
        order, reach, image, coherence = self._target(view, surface, aperture_m, frames, out)
        require_unit_range(self._stack)
        points = held_points(view, surface, self.device)
        gather_coherence(self._placed(view, order), reach, points, image, coherence)
        if out is not None:
            return out
        return like_input(image, self._like), like_input(coherence, self._like)

    def _target(
        self,
        view: VirtualCamera,
        surface: FocalSurface,
        aperture_m: float | None,
        frames: Sequence[int] | None,
        out: tuple[Any, Any] | None,
    ) -> tuple[NDArray[np.int32], float, Any, Any]:
        """Return which photos count within which radius, and the two arrays to write."""
        if not isinstance(surface, (FocalPlane, FocalTerrain)):
            raise TypeError(
                f"surface must be a FocalPlane or FocalTerrain, got {type(surface).__name__}"
            )
        check_view(view)
        order, reach = self._select(view, aperture_m, frames)
        shape = (view.height, view.width)
        given = check_pair(out)
        channels = self._stack.channels
        image = output_array(given[0], (*shape, channels), wp.float32, self.device, "out[0]")
        second = output_array(given[1], shape, wp.float32, self.device, "out[1]")
        return order, reach, image, second

    def _poses_from(self, view: VirtualCamera) -> NDArray[np.float64]:
        poses = self.world_from_camera.copy()
        poses[:, :3, 3] -= view.world_from_camera[:3, 3]
        return poses

    def _placed(self, view: VirtualCamera, order: NDArray[np.int32]) -> PlacedPhotos:
        if self._stations is None:
            self._stations = Stations(self.world_from_camera, self._gains, self.device)
        poses = self._stations.seen_from(view.world_from_camera[:3, 3])
        numbers = self._stations.numbers(order)
        weights = (self._weights, self._weight_unit)
        return PlacedPhotos(self._stack, *weights, lens(self.camera), poses, numbers)

    def _gather(
        self,
        view: VirtualCamera,
        surfaces: Sequence[FocalSurface],
        order: NDArray[np.int32],
        reach: float,
        stack: Any,
        footprint: Any,
    ) -> None:
        """Integrate over surfaces, one a picture of the stack; launches only, nothing waits."""
        packed = self._photos()
        pictures = stack.reshape((len(surfaces), view.height, view.width, self.channels))
        covers = footprint.reshape((len(surfaces), view.height, view.width))
        if packed is not None:
            tiled = TilePhotos(self.camera, packed, self._poses_from(view), self._gains, order)
            planes = [surface for surface in surfaces if isinstance(surface, FocalPlane)]
            straight = view.camera is None or not view.camera.has_distortion
            if straight and reach == _NO_LIMIT and len(planes) == len(surfaces):
                samples = len(planes) * view.width * view.height
                tiled = replace(tiled, packed=self._paired(packed, samples))
                maps = [plane_map(view, plane) for plane in planes]
                gather_planes(tiled, maps, view.size, pictures, covers)
                return
        else:
            placed = self._placed(view, order)
        for i, surface in enumerate(surfaces):
            points = held_points(view, surface, self.device)
            if packed is not None:
                gather_tiles(tiled, reach, points, view.size, pictures[i], covers[i])
            else:
                gather(placed, reach, points, pictures[i], covers[i])

    def _photos(self) -> Packed | None:
        """The photos packed for the CPU, once; None where the plain gather has to do."""
        with self._packing:
            if self._packed is _NOT_YET:
                photos = (self._stack, self._weights, self._weight_unit)
                self._packed = pack(*photos) if in_vectors(self.device) else None
            return self._packed

    def _paired(self, packed: Packed, samples: int) -> Packed:
        """The photos in the form that is fastest to gather, once that pays and memory allows."""
        with self._packing:
            if self._pairs is None and samples >= _MANY_PLANES * self._stack.size:
                free = free_memory()
                if free is None or 2 * packed.nbytes < free // 2:
                    self._pairs = pair_rows(self._stack, packed)
            return self._pairs or packed

    def _select(
        self, view: VirtualCamera, aperture_m: float | None, frames: Sequence[int] | None
    ) -> tuple[NDArray[np.int32], float]:
        order = np.arange(len(self)) if frames is None else np.asarray(frames)
        if order.ndim != 1 or (order.size and order.dtype.kind not in "iu"):
            raise ValueError(f"frames must be a list of frame numbers, got {frames!r}")
        if order.size and (order.min() < 0 or order.max() >= len(self)):
            raise ValueError(f"frames must lie in 0..{len(self) - 1}, got {order.tolist()}")
        order = order.astype(np.int32)
        if aperture_m is None:
            return order, _NO_LIMIT
        if not aperture_m > 0.0:
            raise ValueError(f"aperture_m must be a positive radius, got {aperture_m!r}")
        if view.is_ortho:  # each point has an aperture of its own: the kernel measures
            return order, float(aperture_m)
        away = self.world_from_camera[:, :2, 3] - view.world_from_camera[:2, 3]
        near = np.hypot(away[:, 0], away[:, 1]) <= aperture_m
        return order[near[order]], _NO_LIMIT


def _checked_poses(world_from_camera: ArrayLike, count: int) -> NDArray[np.float64]:
    poses = np.asarray(world_from_camera, dtype=np.float64)
    if poses.ndim != 3 or len(poses) != count:
        raise ValueError(f"world_from_camera must have shape ({count}, 4, 4), got {poses.shape}")
    return np.stack([check_pose(pose, f"world_from_camera[{i}]") for i, pose in enumerate(poses)])


def check_view(view: Any) -> None:
    """Raise TypeError where a view is none."""
    if not isinstance(view, VirtualCamera):
        raise TypeError(f"view must be a VirtualCamera, got {type(view).__name__}")


def check_pair(out: Any) -> tuple[Any, Any]:
    """Return the two arrays of `out`, or None twice.

    Raises:
        ValueError: If `out` is not a pair of arrays.
    """
    if out is None:
        return None, None
    if not isinstance(out, (tuple, list)) or len(out) != 2 or out[0] is None or out[1] is None:
        raise ValueError("out must be a pair of arrays (image, footprint)")
    return out[0], out[1]
