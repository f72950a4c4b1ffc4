"""What a detector is shown of one view: checked arrays, cut into windows and resampled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]

_SEAM_PX = 4.0
"""How far a box's centre may lie beyond the middle of an overlap and still count: of two windows
that place an object a little differently at least one keeps it."""

_MOST_PIXELS = 2**28
"""Largest view after resampling: more is a wrong sampling distance."""


@dataclass(frozen=True, eq=False)
class ViewInput:
    """An integral image with what goes with it; NaN where something is not known.

    Args:
        image: Shape (H, W, 3) RGB or (H, W) grey, uint8, uint16 or float32.
        footprint: Shape (H, W), float32, rays of each pixel, 0 where there are none; or None.
        rarity: Shape (H, W), float32, the rarity map; or None.
        plain: Like the image, the integral image without a mask; or None.
        coherent: Like the image, the mean colour of the rays that agree; or None.
        coherence: Shape (H, W), float32, how much they do; None with `coherent`.
        fragments: Shape (H, W), float32, mean evidence of pieces of people; or None.
        fragment_colour: Like the image, the mean colour of pieces of people that agree; or None.
        fragment_coherence: Shape (H, W), float32, how much they do; None with `fragment_colour`.
        ground: Like the image, the mean colour of the rays that come from the ground; or None.
        ground_rays: Shape (H, W), float32, how many do; None with `ground`.
    """

    image: Array
    footprint: Array | None = None
    rarity: Array | None = None
    plain: Array | None = None
    coherent: Array | None = None
    coherence: Array | None = None
    fragments: Array | None = None
    fragment_colour: Array | None = None
    fragment_coherence: Array | None = None
    ground: Array | None = None
    ground_rays: Array | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [px]."""
        return self.image.shape[0], self.image.shape[1]

    @cached_property
    def is_grey(self) -> bool:
        """Whether the image has no colour: one channel, or three that are the same."""
        if self.image.ndim == 2:
            return True
        red, green, blue = np.moveaxis(self.image, 2, 0)
        nan = self.image.dtype.kind == "f"
        return np.array_equal(red, green, equal_nan=nan) and np.array_equal(
            red, blue, equal_nan=nan
        )

    def as_grey(self) -> ViewInput:
        """Return the plain image in one channel, and where it was seen; colours are averaged."""
        picture = self.image if self.plain is None else self.plain
        if picture.ndim == 3:
            alike = self.is_grey
            picture = picture[..., 0] if alike else picture.mean(axis=2, dtype=np.float32)
        return ViewInput(picture, self.footprint)

    @cached_property
    def seen(self) -> NDArray[np.bool_] | None:
        """Shape (H, W), where something is seen; None: everywhere."""
        known = _known(self.image)
        if self.footprint is not None:
            known = known & (self.footprint > 0.0)
        return None if known.all() else known

    @property
    def all_known(self) -> bool:
        """Whether nothing is missing that may go with an image."""
        return all(part is not None for part in self._others)

    @property
    def any_seen(self) -> bool:
        """Whether a pixel is seen at all."""
        return self.seen is None or bool(self.seen.any())

    def cut(self, window: Window) -> ViewInput:
        """Return the part in a window."""
        part = (slice(window.top, window.bottom), slice(window.left, window.right))
        return self._each(lambda array: array[part])

    def resized(self, height: int, width: int) -> ViewInput:
        """Return the view at another size; what is not seen does not bleed into what is."""
        if (height, width) == self.size:
            return self
        finer = height > self.size[0]
        how = cv2.INTER_LINEAR if finer else cv2.INTER_AREA

        def scaled(array: Array) -> Array:
            return np.asarray(cv2.resize(array, (width, height), interpolation=how))

        hidden = self.footprint is not None and self.seen is not None
        rays = None if self.footprint is None else scaled(self.footprint)

        def of_known(array: Array) -> Array:
            known = _known(array)
            if hidden and self.footprint is not None:
                known = known & (self.footprint > 0.0)
            if known.all():
                return scaled(array)
            values = array.astype(np.float32)
            values[~known] = 0.0
            share = scaled(known.astype(np.float32))
            share[share <= 0.0] = np.nan
            total = scaled(values)
            return np.asarray(total / (share[..., None] if total.ndim == 3 else share))

        others = [None if part is None else of_known(part) for part in self._others[1:]]
        return ViewInput(of_known(self.image), rays, *others)

    @property
    def _others(self) -> tuple[Array | None, ...]:
        return (
            *(self.footprint, self.rarity, self.plain, self.coherent, self.coherence),
            *(self.fragments, self.fragment_colour, self.fragment_coherence),
            *(self.ground, self.ground_rays),
        )

    def _each(self, change: Callable[[Array], Array]) -> ViewInput:
        changed = [None if part is None else change(part) for part in self._others]
        return ViewInput(change(self.image), *changed)


@dataclass(frozen=True)
class Window:
    """A part of a view, and which boxes' centres it may keep.

    Args:
        top: First row.
        left: First column.
        bottom: Row after the last.
        right: Column after the last.
        keep: Top, left, bottom, right [px]; boxes of neighbours beyond are cut off or doubled.
    """

    top: int
    left: int
    bottom: int
    right: int
    keep: tuple[float, float, float, float]


def checked_view(
    image: ArrayLike,
    footprint: ArrayLike | None = None,
    rarity: ArrayLike | None = None,
    plain: ArrayLike | None = None,
    coherence: tuple[ArrayLike, ArrayLike] | None = None,
    fragments: ArrayLike | None = None,
    fragment_coherence: tuple[ArrayLike, ArrayLike] | None = None,
    ground: tuple[ArrayLike, ArrayLike] | None = None,
) -> ViewInput:
    """Check the arrays of a view; NaN and infinity count as not known.

    Args:
        image: Shape (H, W, 3) RGB, (H, W) or (H, W, 1) grey; uint8, uint16 or floats.
        footprint: Shape (H, W), rays of each pixel; 0 where nothing is seen.
        rarity: Shape (H, W), mean rarity weight over the rays.
        plain: The integral image without a mask, shapes as `image`.
        coherence: Mean colour of the rays that agree, shapes as `image`, and how much they do,
            shape (H, W); see `Integrator.coherence`.
        fragments: Shape (H, W), mean evidence of pieces of people over the rays.
        fragment_coherence: As `coherence`, of photos weighed by that evidence.
        ground: Mean colour of the rays that come from the ground, shapes as `image`, and how many
            do, shape (H, W).

    Raises:
        ValueError: If a shape is wrong; the message names the argument.
        TypeError: If an array does not hold such numbers.
    """
    picture = _picture(image, "image")
    size = picture.shape[:2]
    rays = _map(footprint, "footprint", size)
    if rays is not None:
        rays = np.nan_to_num(rays, nan=0.0)
    rare = _map(rarity, "rarity", size)
    other, agreed = _other(plain, "plain", size), _agreed(coherence, "coherence", size)
    pieces = _map(fragments, "fragments", size)
    agreed_pieces = _agreed(fragment_coherence, "fragment_coherence", size)
    soil, reach = _agreed(ground, "ground", size, "rays")
    if soil is not None and reach is not None and not (reach > 0.0).all():  # no ray is not black
        shown = reach > 0.0 if soil.ndim == 2 else reach[..., None] > 0.0
        soil = np.where(shown, soil, np.float32(np.nan))
    return ViewInput(picture, rays, rare, other, *agreed, pieces, *agreed_pieces, soil, reach)


def windows(size: tuple[int, int], side: tuple[int, int], overlap: int) -> list[Window]:
    """Return windows of one size that cover a view; only one where it is no larger.

    Args:
        size: Height and width of the view [px].
        side: Height and width of a window [px].
        overlap: Least overlap of neighbours [px].
    """
    rows, columns = (list(_spans(size[i], side[i], overlap)) for i in (0, 1))
    return [
        Window(top, left, bottom, right, (high, near, low, far))
        for top, bottom, high, low in rows
        for left, right, near, far in columns
    ]


def trained_size(
    size: tuple[int, int], gsd_m: float, limits: tuple[float, float], aim_m: float
) -> tuple[int, int]:
    """Return the size at which a view has a sampling distance that a network was trained for.

    Args:
        size: Height and width [px].
        gsd_m: Ground sampling distance [m/px].
        limits: Smallest and largest distance that need no resampling [m/px].
        aim_m: The distance to resample to [m/px].

    Raises:
        ValueError: If that would be more than 268 million pixels.
    """
    if limits[0] <= gsd_m <= limits[1]:
        return size
    factor = gsd_m / aim_m
    height, width = (max(1, round(length * factor)) for length in size)
    if height * width > _MOST_PIXELS:
        raise ValueError(
            f"gsd_m {gsd_m:g} makes {size[1]} x {size[0]} px a view of {size[1] * gsd_m:.0f} m x "
            f"{size[0] * gsd_m:.0f} m, more than {_MOST_PIXELS} px of {aim_m:g} m; is it in metres?"
        )
    return height, width


def _spans(length: int, side: int, overlap: int) -> Iterator[tuple[int, int, float, float]]:
    """First, end, and range of centres to keep, of windows along one axis."""
    if length <= side:
        yield 0, length, -np.inf, np.inf
        return
    step = max(1, side - overlap)
    count = -(-(length - side) // step) + 1
    starts = np.linspace(0, length - side, count).round().astype(int).tolist()
    for i, start in enumerate(starts):
        low = -np.inf if i == 0 else (start + starts[i - 1] + side) / 2.0 - _SEAM_PX
        last = i == count - 1
        high = np.inf if last else (starts[i + 1] + start + side) / 2.0 + _SEAM_PX
        yield start, start + side, low, high


def _known(array: Array) -> NDArray[np.bool_]:
    """Shape (H, W), where all channels hold a number."""
    if not np.issubdtype(array.dtype, np.floating):
        return np.ones(array.shape[:2], bool)
    finite = np.isfinite(array)
    if array.ndim == 2 or finite.all():  # over the last axis alone it would take ten times as long
        return finite if array.ndim == 2 else np.ones(array.shape[:2], bool)
    return np.asarray(finite.all(axis=2))


def _picture(image: ArrayLike, name: str) -> Array:
    """The image as uint8, uint16 or float32, with NaN for what is not finite."""
    pixels = np.asarray(image)
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    if not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] == 3)) or pixels.size == 0:
        raise ValueError(
            f"{name} must be (H, W, 3) RGB or (H, W) grey with at least a pixel, got {pixels.shape}"
        )
    if np.issubdtype(pixels.dtype, np.floating):
        return _with_nan(pixels)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise TypeError(f"{name} must hold uint8, uint16 or floats, got {pixels.dtype}")
    return pixels


def _other(image: ArrayLike | None, name: str, size: tuple[int, int]) -> Array | None:
    if image is None:
        return None
    other = _picture(image, name)
    if other.shape[:2] != size:
        raise ValueError(f"{name} must have the image's size {size}, got {other.shape[:2]}")
    return other


def _agreed(
    pair: tuple[ArrayLike, ArrayLike] | None,
    name: str,
    size: tuple[int, int],
    second: str = "coherence",
) -> tuple[Array | None, Array | None]:
    """A pair of a mean colour and how much of it there is, checked."""
    if pair is None:
        return None, None
    if len(pair) != 2:
        raise ValueError(f"{name} must be a pair (image, {second}), got {len(pair)} parts")
    return _other(pair[0], f"{name}[0]", size), _map(pair[1], f"{name}[1]", size)


def _map(values: ArrayLike | None, name: str, size: tuple[int, int]) -> Array | None:
    if values is None:
        return None
    found = np.asarray(values)
    if not (np.issubdtype(found.dtype, np.floating) or np.issubdtype(found.dtype, np.integer)):
        raise TypeError(f"{name} must hold numbers, got {found.dtype}")
    if found.shape != size:
        raise ValueError(f"{name} must have the image's shape {size}, got {found.shape}")
    return _with_nan(found)


def _with_nan(values: Array) -> Array:
    with np.errstate(over="ignore"):
        numbers = values.astype(np.float32, copy=False)
    known = np.isfinite(numbers)
    return numbers if known.all() else np.where(known, numbers, np.float32(np.nan))
