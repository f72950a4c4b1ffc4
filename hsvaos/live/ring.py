"""The photos of the window, in memory that is there from the start: one slot a photo.

On the CPU a photo is packed as it comes, into the form that is fast to gather; on CUDA it lies as
it is, beside its weights. Both give the picture that `Integrator` gives of the same photos.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.hue_statistics import HueStatistics
from hsvaos.kernels.arrays import Stack
from hsvaos.kernels.color import brighten
from hsvaos.kernels.gather import PlacedPhotos, gather
from hsvaos.kernels.hue_mask import cut_photo
from hsvaos.kernels.hue_pack import cut_and_pack_photo, cut_job
from hsvaos.kernels.lens import lens
from hsvaos.kernels.packing import empty_packed, new_packed, pack_over
from hsvaos.kernels.rays import plane_map
from hsvaos.kernels.stations import Stations
from hsvaos.kernels.tiles import TilePhotos, gather_planes, gather_tiles
from hsvaos.live.sight import Sight
from hsvaos.surface import FocalPlane

NO_LIMIT = 1e15
"""Radius of an aperture without limit [m]."""


@dataclass(frozen=True)
class Format:
    """What the photos of a window are.

    Args:
        camera: Their camera.
        channels: 3 for RGB, 1 for grey.
        dtype: "uint8", or "uint16" for grey.

    Raises:
        ValueError: If there are no such photos.
    """

    camera: Camera
    channels: int = 3
    dtype: str = "uint8"

    def __post_init__(self) -> None:
        if self.channels not in (1, 3):
            raise ValueError(f"channels must be 3 (RGB) or 1 (grey), got {self.channels!r}")
        if self.dtype not in (("uint8",) if self.channels == 3 else ("uint8", "uint16")):
            raise ValueError(
                f'dtype must be "uint8", or "uint16" for grey photos, got {self.dtype!r}'
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a photo: (H, W, 3) or (H, W)."""
        size = (self.camera.height, self.camera.width)
        return (*size, 3) if self.channels == 3 else size

    @property
    def white(self) -> float:
        """Value of full white."""
        return 255.0 if self.dtype == "uint8" else 65535.0

    def memory(self, device: Any) -> NDArray[Any]:
        """Return memory for a photo on the host, pinned where it will go to CUDA."""
        pinned = bool(device.is_cuda)
        array: Any = wp.zeros(self.shape, dtype=self.scalar, device="cpu", pinned=pinned)
        return np.asarray(array.numpy())

    @property
    def scalar(self) -> Any:
        """Warp type of a channel."""
        return wp.uint8 if self.dtype == "uint8" else wp.uint16


class Ring(Protocol):
    """Photos in slots."""

    nbytes: int
    """Memory of the photos [bytes]."""

    def put(self, slot: int, photo: Stack, weights: Any) -> None:
        """Put a photo into a slot.

        Args:
            slot: The slot; what was there is gone.
            photo: One photo.
            weights: Warp array (H * W), uint8, 255 = weight 1.
        """

    def put_cut(self, slot: int, photo: Stack, stats: HueStatistics, valid: Any, mask: Any) -> None:
        """Cut hues out of a photo, brighten the rest if the window does, and put it into a slot.

        Args:
            slot: The slot.
            photo: One RGB photo.
            stats: What to cut.
            valid: Warp array (H * W), uint8, user mask of 0 and 255.
            mask: Warp array (H * W), uint8, written: what the cut leaves.
        """

    def stand(self, slot: int, world_from_camera: NDArray[np.float64]) -> None:
        """Say from where the photo of a slot was taken.

        Args:
            slot: The slot.
            world_from_camera: Shape (4, 4), world NED [m].
        """

    def gather(self, slots: NDArray[np.int32], sight: Sight, out: Out) -> None:
        """Integrate the photos of some slots.

        Args:
            slots: The slots to use.
            sight: What is looked at.
            out: Where to write.
        """


@dataclass(frozen=True, eq=False)
class Out:
    """An integral image to be written.

    Args:
        image: Warp array (H, W, C), float32.
        footprint: Warp array (H, W), float32.
        on_host: The same in pinned memory, where the picture lies on CUDA.
    """

    image: Any
    footprint: Any
    on_host: tuple[Any, Any] | None = None

    @classmethod
    def empty(cls, size: tuple[int, int], channels: int, device: Any) -> Out:
        """Return memory for a picture of a size (width, height)."""
        width, height = size
        shapes = ((height, width, channels), (height, width))
        image, footprint = (wp.zeros(shape, dtype=float, device=device) for shape in shapes)
        if device.is_cpu:
            return cls(image, footprint)
        host = [wp.zeros(shape, dtype=float, device="cpu", pinned=True) for shape in shapes]
        return cls(image, footprint, (host[0], host[1]))

    def numpy(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Wait for the device and return image and footprint, in memory that stays the same."""
        if self.on_host is None:
            return self.image.numpy(), self.footprint.numpy()
        for source, target in zip((self.image, self.footprint), self.on_host, strict=True):
            wp.copy(target, source)
        wp.synchronize_device(self.image.device)
        return self.on_host[0].numpy(), self.on_host[1].numpy()


class PackedRing:
    """Photos packed for the CPU.

    Args:
        format: What the photos are.
        frames: Number of slots.
        soft: Whether weights lie between 0 and 255.
        brightening: target_value, gamma and max_gain of a hue cut; None for none.
    """

    def __init__(
        self, format: Format, frames: int, soft: bool, brightening: dict[str, float] | None
    ) -> None:
        camera = format.camera
        form = "grey16"
        if format.channels == 3:
            form = "rgb16" if soft else "rgb8"
        self._camera, self._brightening = camera, brightening
        self._photos = new_packed(frames, (camera.width, camera.height), format.scalar, form)
        words = self._photos.words
        self._slots = [replace(self._photos, words=words[i : i + 1]) for i in range(frames)]
        self._gains = np.ones((frames, 3))
        self._poses = np.tile(np.eye(4), (frames, 1, 1))
        self._relative = self._poses.copy()
        self.nbytes = self._photos.nbytes

    def put(self, slot: int, photo: Stack, weights: Any) -> None:
        """See `Ring`."""
        pack_over(photo, weights.reshape((1, -1)), self._slots[slot])

    def put_cut(self, slot: int, photo: Stack, stats: HueStatistics, valid: Any, mask: Any) -> None:
        """See `Ring`."""
        _, pack = empty_packed(photo, self._photos.form, self._slots[slot])
        job = cut_job(pack, photo.width, self._brightening)
        cut_and_pack_photo(job, 0, photo.pixels[0], valid, wp.vec3(1.0 / photo.white), stats, mask)

    def stand(self, slot: int, world_from_camera: NDArray[np.float64]) -> None:
        """See `Ring`."""
        self._poses[slot] = world_from_camera

    def gather(self, slots: NDArray[np.int32], sight: Sight, out: Out) -> None:
        """See `Ring`."""
        view, surface = sight.view, sight.surface
        np.copyto(self._relative, self._poses)
        self._relative[:, :3, 3] -= view.world_from_camera[:3, 3]  # float32 is exact there
        photos = TilePhotos(self._camera, self._photos, self._relative, self._gains, slots)
        straight = view.camera is None or not view.camera.has_distortion
        if straight and isinstance(surface, FocalPlane):
            maps = [plane_map(view, surface)]
            gather_planes(photos, maps, sight.size, out.image, out.footprint)
            return
        where = (NO_LIMIT, sight.points, sight.size)
        gather_tiles(photos, *where, out.image, out.footprint)


class PlainRing:
    """Photos as they are, with their weights: on any device.

    Args:
        format: What the photos are.
        frames: Number of slots.
        brightening: target_value, gamma and max_gain of a hue cut; None for none.
        device: Warp device.
    """

    def __init__(
        self, format: Format, frames: int, brightening: dict[str, float] | None, device: Any
    ) -> None:
        images = wp.zeros((frames, *format.shape), dtype=format.scalar, device=device)
        self._lens, self._brightening = lens(format.camera), brightening
        self._stack = Stack(images, device)
        self._weights = wp.zeros((frames, self._stack.size), dtype=wp.uint8, device=device)
        poses = np.tile(np.eye(4), (frames, 1, 1))
        self._stations = Stations(poses, np.ones((frames, 3)), device)
        self.nbytes = int(images.size * wp.types.type_size_in_bytes(images.dtype))
        self.nbytes += int(self._weights.size)

    def put(self, slot: int, photo: Stack, weights: Any) -> None:
        """See `Ring`."""
        wp.copy(self._stack.array[slot], photo.array[0])
        wp.copy(self._weights[slot], weights)

    def put_cut(self, slot: int, photo: Stack, stats: HueStatistics, valid: Any, mask: Any) -> None:
        """See `Ring`."""
        cut_photo(photo.pixels[0], valid, wp.vec3(1.0 / photo.white), stats, mask)
        self.put(slot, photo, mask)
        if self._brightening is not None:
            held = self._stack.array[slot : slot + 1]
            keep = mask.reshape((1, photo.height, photo.width))
            brighten(held, keep, **self._brightening, out=held)

    def stand(self, slot: int, world_from_camera: NDArray[np.float64]) -> None:
        """See `Ring`."""
        self._stations.move(slot, world_from_camera)

    def gather(self, slots: NDArray[np.int32], sight: Sight, out: Out) -> None:
        """See `Ring`."""
        poses = self._stations.seen_from(sight.view.world_from_camera[:3, 3])
        numbers = self._stations.numbers(np.sort(slots))
        weights = (self._weights, 1.0 / 255.0)
        photos = PlacedPhotos(self._stack, *weights, self._lens, poses, numbers)
        gather(photos, NO_LIMIT, sight.points, out.image, out.footprint)
