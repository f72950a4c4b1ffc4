"""The photos of a flight on a device: decoded ahead of the kernels, each once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.flight import Flight, FlightError, Frame
from hsvaos.formats.images import photos_ahead
from hsvaos.kernels.arrays import scalar_type
from hsvaos.kernels.device import free_memory
from hsvaos.nav.photos import poses_at_photos

Progress = Callable[[str, int, int], None]
"""Called with a stage's name, steps done and steps in all."""

_BYTES_A_PIXEL = 29
"""Mask (1), rarity (4), evidence of fragments (2, and 2 as weights) and of the ground (1) of every
pixel, beside the photo; what integrals pack: the photo under the hue cut (4), and in turn at most
8, see `rendering.Renderer`; and 7 for all else (117 photos of 1024 x 1024 held 32 together)."""


@dataclass(frozen=True, eq=False)
class Photos:
    """Photos on a device, with what is known of them.

    Args:
        flight: The frames that could be decoded, with the camera of the photos as held.
        images: Warp array, shape (N, H, W, 3) or (N, H, W); uint8, uint16 or float32.
        valid: User masks: shape (H, W) for all or (N, H, W), uint8, 255 = use; None for all.
        notes: What was left out, one line each.
    """

    flight: Flight
    images: Any
    valid: NDArray[np.uint8] | None
    notes: tuple[str, ...]

    @property
    def is_colour(self) -> bool:
        """Whether the photos are RGB."""
        return len(self.images.shape) == 4

    def valid_of(self, index: int) -> NDArray[np.uint8]:
        """Return the user mask of one photo, shape (H, W), uint8."""
        if self.valid is None:
            return np.full(self.images.shape[1:3], 255, np.uint8)
        return self.valid if self.valid.ndim == 2 else np.asarray(self.valid[index])


def with_poses(flight: Flight, progress: Progress | None = None) -> Flight:
    """Return the flight with poses, estimated from its sensor log where it has none.

    Args:
        flight: The flight.
        progress: Told of the estimation.

    Raises:
        FlightError: If it has neither poses nor a usable sensor log.
    """
    if flight.has_poses:
        return flight

    def report(stage: str, share: float) -> None:
        if progress is not None:
            progress(f"estimating poses: {stage}", round(100.0 * share), 100)

    return poses_at_photos(flight, progress=report)


def load_photos(
    flight: Flight,
    scale: float = 1.0,
    device: Any = None,
    progress: Progress | None = None,
) -> Photos:
    """Decode all photos of a flight onto a device; those that cannot be are named and left out.

    Args:
        flight: The flight.
        scale: Factor on width and height, 0 < scale <= 1.
        device: Warp device.
        progress: Told of every photo.

    Raises:
        FlightError: If no photo is left, or they need more memory than there is.
    """
    camera = flight.camera
    width, height = (max(1, round(side * scale)) for side in (camera.width, camera.height))
    faults: list[tuple[Frame, FlightError]] = []
    good: list[int] = []
    masks: dict[int, NDArray[np.uint8]] = {}
    images: Any = None
    photos = photos_ahead(flight, on_error=lambda frame, error: faults.append((frame, error)))
    for index, photo in enumerate(photos):
        if photo is not None:
            image = resized(photo.image, width, height)
            if images is None:
                shape = (len(flight), *image.shape)
                _check_memory(shape, image.dtype.itemsize, flight)
                images = wp.empty(shape, dtype=scalar_type(image.dtype), device=device)
            if photo.alpha is not None:
                masks[len(good)] = resized(photo.alpha, width, height)
            images[len(good)].assign(np.ascontiguousarray(image))
            good.append(index)
        if progress is not None:
            progress("decoding photos", index + 1, len(flight))
    notes = []
    if faults:
        names = ", ".join(frame.name for frame, _ in faults[:3])
        notes.append(
            f"{len(faults)} of {len(flight)} photos left out ({names}"
            f"{', ...' if len(faults) > 3 else ''}): {faults[0][1]}"
        )
    if not good:
        raise FlightError(f"{flight.source}: no photo can be used: {faults[0][1]}")
    valid = _combined(masks, len(good))
    if valid is not None and not valid.any():
        raise FlightError(
            f"{flight.mask or flight.source}: the user masks ignore every pixel of every photo "
            f"(expected 0 = ignore, 255 = use)"
        )
    kept = replace(flight.subset(good), camera=camera.scaled(width, height))
    return Photos(kept, images[: len(good)], valid, tuple(notes))


def resized(image: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    """Return a photo or mask shrunk to a size [px]; itself where it has that size."""
    if image.shape[:2] == (height, width):
        return image
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def _combined(masks: dict[int, NDArray[np.uint8]], count: int) -> NDArray[np.uint8] | None:
    """One mask where all photos have the same, a stack where they differ, None where none has."""
    if not masks:
        return None
    first = next(iter(masks.values()))
    if len(masks) == count and all(np.array_equal(mask, first) for mask in masks.values()):
        return first
    stack = np.full((count, *first.shape), 255, np.uint8)
    for index, mask in masks.items():
        stack[index] = mask
    return stack


def _check_memory(shape: tuple[int, ...], itemsize: int, flight: Flight) -> None:
    pixels = shape[0] * shape[1] * shape[2]
    channels = shape[3] if len(shape) == 4 else 1
    needed = pixels * (channels * itemsize + _BYTES_A_PIXEL)
    free = free_memory()
    if free is not None and needed > free:
        raise FlightError(
            f"{flight.source}: {shape[0]} photos of {shape[2]} x {shape[1]} px need "
            f"{needed / 2**30:.1f} GiB of memory, {free / 2**30:.1f} GiB are free: use a smaller "
            f"scale (--scale 0.5 needs a quarter)"
        )
