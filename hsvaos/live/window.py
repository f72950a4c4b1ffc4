"""The window of the newest photos, and its integral image after every one of them.

Where the view rests the newest photo is added to running sums and the oldest taken out again: two
photos are gathered instead of all. Where it moves all photos are gathered anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import VirtualCamera, check_pose
from hsvaos.hue_statistics import HueStatistics
from hsvaos.kernels.arrays import Stack
from hsvaos.kernels.device import in_vectors, resolve_device
from hsvaos.kernels.running import MOST_PHOTOS, RunningSums
from hsvaos.live.ring import Format, Out, PackedRing, PlainRing, Ring
from hsvaos.live.sight import Sight
from hsvaos.live.statistics import RunningHue, RunningRarity
from hsvaos.settings import MaskSettings
from hsvaos.surface import FocalSurface

METHODS = ("hue", "rarity", "none")
"""Masks that can be made as photos come in."""


class Window:
    """The newest photos of a flight and their integral image, in fixed memory.

    Args:
        format: What the photos are.
        frames: Photos of the window.
        size: (width, height) of the integral images [px].
        mask: How pixels are weighed: method "hue", "rarity" or "none".
        valid: Shape (H, W), uint8 or bool, pixels of every photo to use; None for all.
        device: "cpu", "cuda:0", ...
        packed: Whether photos are packed; by default on the CPU.

    Raises:
        ValueError: If a parameter makes no sense.
    """

    def __init__(
        self,
        format: Format,
        frames: int,
        size: tuple[int, int],
        mask: MaskSettings,
        valid: ArrayLike | None = None,
        device: Any = "cpu",
        packed: bool | None = None,
    ) -> None:
        if not 1 <= frames <= MOST_PHOTOS:
            raise ValueError(f"frames must lie in 1..{MOST_PHOTOS}, got {frames!r}")
        _check_mask(mask, format)
        self.format, self.frames, self.size, self.mask = format, frames, size, mask
        self.device = resolve_device(device)
        pixels = format.camera.width * format.camera.height
        self._hue = self._rarity = None
        if mask.method == "hue":
            self._hue = RunningHue(frames, pixels, mask, self.device)
        elif mask.method == "rarity":
            self._rarity = RunningRarity(frames, pixels, format.channels, mask, self.device)
        bright = None
        if mask.method == "hue" and mask.brighten:
            bright = {
                "target_value": mask.target_value,
                "gamma": mask.gamma,
                "max_gain": mask.max_gain,
            }
        on_cpu = in_vectors(self.device) if packed is None else packed
        self._incoming: Stack | None = None
        if not on_cpu:
            staging = wp.zeros((1, *format.shape), dtype=format.scalar, device=self.device)
            self._incoming = Stack(staging, self.device)
        self._ring: Ring = (
            PackedRing(format, frames, mask.method == "rarity", bright)
            if on_cpu
            else PlainRing(format, frames, bright, self.device)
        )
        self._valid: Any = wp.array(
            checked_valid(valid, format).ravel(), dtype=wp.uint8, device=self.device
        )
        self._weights = wp.zeros(pixels, dtype=wp.uint8, device=self.device)
        self._poses = np.tile(np.eye(4), (frames, 1, 1))
        self._scale = wp.vec3(1.0 / format.white)
        self._count, self._next = 0, 0
        self._one = Out.empty(size, format.channels, self.device)
        self._sight = Sight(size, self.device)
        self._sums = RunningSums(size[0] * size[1], format.channels, format.white, self.device)
        self._summed = False  # whether the sums hold the window as seen from what was shown
        self.statistics: HueStatistics | None = None
        self.regathers = 0

    def __len__(self) -> int:
        return self._count

    @property
    def nbytes(self) -> int:
        """Memory of the photos in the window [bytes]."""
        return self._ring.nbytes

    @property
    def slots(self) -> NDArray[np.int32]:
        """The slots in use, oldest photo first."""
        first = self._next - self._count
        return (np.arange(first, self._next) % self.frames).astype(np.int32)

    @property
    def poses(self) -> NDArray[np.float64]:
        """Shape (n, 4, 4), of the photos in the window, oldest first."""
        return self._poses[self.slots]

    def step(
        self,
        image: Any,
        world_from_camera: ArrayLike,
        view: VirtualCamera,
        surface: FocalSurface,
        out: Out,
    ) -> None:
        """Take in a photo, let the oldest go where the window is full, and integrate.

        Args:
            image: One photo as the format says, on the host.
            world_from_camera: Shape (4, 4), its pose.
            view: What to render. The same object as in the step before means that it rests.
            surface: Focal plane or terrain; likewise.
            out: Where to write.

        Raises:
            ValueError: If photo, pose or view do not fit.
            TypeError: If the photo is of another type.
        """
        pose = check_pose(world_from_camera, "world_from_camera")
        photo = self._photo(image)
        rests = self._sight.turn(view, surface)
        self._summed = self._summed and rests
        slot = self._next % self.frames
        if self._summed and self._count == self.frames:
            self._sum(slot, -1)
        self._take_in(slot, photo, pose)
        if self._summed:
            self._sum(slot, 1)
        elif rests:  # for the second time: worth summing up from here on
            self._sums.clear()
            for each in self.slots:
                self._sum(int(each), 1)
            self._summed = True
            self.regathers += 1
        if self._summed:
            self._sums.mean(out.image, out.footprint)
        else:
            self._ring.gather(self.slots, self._sight, out)
            self.regathers += 1

    def warm_up(self, view: VirtualCamera, surface: FocalSurface, out: Out) -> None:
        """Compile and load all kernels now, with black photos, and forget those.

        Args:
            view: A view of the window's size.
            surface: Focal plane or terrain of the kind that will be used.
            out: Where to write.
        """
        black = self.format.memory(self.device)
        for _ in range(3):  # gathers, sums up, and adds to the sums
            self.step(black, view.world_from_camera, view, surface, out)
        self.forget()

    def forget(self) -> None:
        """Let all photos go."""
        for statistics in (self._hue, self._rarity):
            if statistics is not None:
                statistics.clear()
        self._count = self._next = self.regathers = 0
        self._sight.forget()
        self._summed, self.statistics = False, None

    def _take_in(self, slot: int, photo: Stack, pose: NDArray[np.float64]) -> None:
        pixels = photo.pixels[0]
        if self._hue is not None:
            self.statistics = self._hue.measure(slot, pixels, self._valid, self._scale)
            self._ring.put_cut(slot, photo, self.statistics, self._valid, self._weights)
        elif self._rarity is not None:
            self._rarity.weigh(slot, pixels, self._valid, self._scale, self._weights)
            self._ring.put(slot, photo, self._weights)
        else:
            self._ring.put(slot, photo, self._valid)
        self._ring.stand(slot, pose)
        self._poses[slot] = pose
        self._next += 1
        self._count = min(self._count + 1, self.frames)

    def _sum(self, slot: int, sign: int) -> None:
        only = np.array([slot], np.int32)
        self._ring.gather(only, self._sight, self._one)
        self._sums.add(self._one.image, self._one.footprint, sign)

    def _photo(self, image: Any) -> Stack:
        photo = Stack(image[None], wp.get_device("cpu"), "image")
        if (photo.scalar, *photo.array.shape[1:]) != (self.format.scalar, *self.format.shape):
            raise ValueError(
                f"image must have shape {self.format.shape} and type {self.format.dtype}, got "
                f"{tuple(photo.array.shape[1:])} and {photo.scalar.__name__}"
            )
        if self._incoming is None:
            return photo
        wp.copy(self._incoming.array, photo.array)
        return self._incoming

    def sampling_distance(self) -> float:
        """Return the ground sampling distance of the picture made last [m/px]."""
        return self._sight.sampling_distance()


def _check_mask(mask: MaskSettings, format: Format) -> None:
    if mask.method not in METHODS:
        raise ValueError(f"mask.method must be one of {', '.join(METHODS)}, got {mask.method!r}")
    if mask.method == "hue" and format.channels != 3:
        raise ValueError('mask.method "hue" needs RGB photos: grey has no hue; use "none"')
    for name, plain in (("keep_colours", ()), ("hue_from_deg", None)):
        if getattr(mask, name) != plain:
            raise ValueError(f"mask.{name} is not for live flights, got {getattr(mask, name)!r}")


def checked_valid(valid: ArrayLike | None, format: Format) -> NDArray[np.uint8]:
    """Return the user mask of every photo, shape (H, W), uint8, 255 = use.

    Args:
        valid: Shape (H, W), uint8 or bool; None for all pixels.
        format: What the photos are.

    Raises:
        ValueError: If it does not fit.
    """
    shape = format.shape[:2]
    if valid is None:
        return np.full(shape, 255, np.uint8)
    array = np.asarray(valid)
    if array.shape != shape or array.dtype not in (np.uint8, np.bool_):
        raise ValueError(
            f"valid must be bool or uint8 of shape {shape}, got {array.dtype} of {array.shape}"
        )
    return np.where(array != 0, 255, 0).astype(np.uint8)
