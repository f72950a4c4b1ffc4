"""Views cut and turned into inputs of networks: our own, and those that were trained on photos."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import finite_number
from hsvaos.detect.fitting import Placement, as_bytes, fitted, padded
from hsvaos.detect.grey_input import GREY_CHANNELS, grey_input
from hsvaos.detect.layouts import Layout, input_size, own_channels
from hsvaos.detect.levels import level_planes
from hsvaos.detect.network import PERSON_SCORE, Network
from hsvaos.detect.network_input import (
    AIM_GSD_M,
    CHANNELS,
    TRAINED_GSD_M,
    network_input,
    photo_layers,
)
from hsvaos.detect.view_input import ViewInput, Window, trained_size, windows

Array = NDArray[Any]

_OWN_SIDE = 2048
"""Largest window of our own networks, which take any size: it bounds the memory."""

_OWN_OVERLAP = 256
"""Overlap of such windows [px]: half of it is three people long at 4.5 cm."""

_SMALLER = 0.7
"""Real thermal integral images are softer than their pixels: seen smaller, people look as they do
in what the network for grey images learned from (bench/THERMAL.md)."""

_OVERLAP = 0.2
"""Overlap of other windows, as a share of their side."""

_SLICE_FROM = 1.5
"""How many times larger than its input a view must be to be cut instead of shrunk."""


@dataclass(frozen=True, eq=False)
class Tile:
    """One input of a network, and where it lies.

    Args:
        view: Number of the view.
        planes: Shape (C, h, w), float32.
        placement: Of the window in the input.
        window: In the view as resampled.
        scale: Pixels of the view as resampled a pixel of the view as given, in x and y.
        levels: Shape (9, h, w), float32, what a second look sees beside the input, see
            `level_planes`; None where something is not known.
    """

    view: int
    planes: Array
    placement: Placement
    window: Window
    scale: tuple[float, float] = (1.0, 1.0)
    levels: Array | None = None

    def back(self, boxes: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return boxes of the input in pixels of the view as given, and which this tile may keep.

        Args:
            boxes: Shape (N, 4), corners with pixel k covering k to k + 1 [px].
        """
        window = self.window
        places = self.placement.back(boxes) + np.array([window.left, window.top] * 2, np.float32)
        x, y = (places[:, 0] + places[:, 2]) / 2.0, (places[:, 1] + places[:, 3]) / 2.0
        top, left, bottom, right = window.keep
        kept = (y >= top) & (y <= bottom) & (x >= left) & (x <= right)
        return places / np.array(self.scale * 2, np.float32), kept


class PhotoFeed:
    """Feeds networks that were trained on photos: 8-bit pictures, scaled to the input.

    Attributes:
        score: Score from which a box counts, by default.
        person_score: The same.
        photo_layers: None.
        scales: 1: a view is looked at once.

    Args:
        network: The network.
        layout: Its layout.
        size_px: Side of the input, where the network takes any.
        slice_px: Side of windows; 0: none; None: of the size of the input, for large views.

    Raises:
        ValueError: If the network takes one size only and another one is asked for.
    """

    def __init__(
        self, network: Network, layout: Layout, size_px: int | None, slice_px: int | None
    ) -> None:
        self.score = self.person_score = layout.score
        self.photo_layers: tuple[str, ...] = ()
        self.scales: tuple[float, ...] = (1.0,)
        self._layout = layout
        self._size = input_size(network, size_px)
        self._slice = slice_px

    def tiles(
        self, number: int, view: ViewInput, gsd_m: float | None, scale: float = 1.0
    ) -> Iterator[Tile]:
        """Yield the inputs of a view; its sampling distance does not matter.

        Args:
            number: Of the view.
            view: The view.
            gsd_m: Ground sampling distance [m/px].
            scale: 1.
        """
        for window in windows(view.size, *self._side(view.size)):
            part = view.cut(window)
            if part.any_seen:
                yield Tile(number, *fitted(as_bytes(part), self._layout, self._size), window)

    def _side(self, size: tuple[int, int]) -> tuple[tuple[int, int], int]:
        side = self._size if self._slice is None else (self._slice, self._slice)
        small = self._slice is None and max(size) <= _SLICE_FROM * max(self._size)
        if small or self._slice == 0:
            side = size
        return side, round(_OVERLAP * min(side))


class OwnFeed:
    """Feeds our own networks: the channels they name, scaled only to their sampling distance.

    Attributes:
        score: Score from which a box counts, by default.
        person_score: The same for a person over all views of a flight.
        photo_layers: What of single photos the network looks at: some of "fragments",
            "fragment_coherence" and "ground".
        scales: Sizes at which a view is looked at, as factors on its sides: two of grey ones.

    Args:
        network: The network.
        layout: Its layout.
        slice_px: Largest side of windows; by default 2048 or the size of the input; 0: no windows
            where the network takes any size.

    Raises:
        ValueError: If its metadata make no sense.
    """

    def __init__(self, network: Network, layout: Layout, slice_px: int | None) -> None:
        self._stride = _stride(network)
        names = own_channels(network)
        self._grey = names[0] in GREY_CHANNELS
        self.scales: tuple[float, ...] = (1.0, _SMALLER) if self._grey else (1.0,)
        known = GREY_CHANNELS if self._grey else CHANNELS
        self._channels = [known.index(name) for name in names]
        self.photo_layers = photo_layers(names)
        score, of_persons = map(network.threshold, ("score_threshold", PERSON_SCORE))
        self.score = layout.score if score is None else score
        self.person_score = self.score if of_persons is None else of_persons
        self._gsd_m, self._aim_m = _trained_gsd(network)
        self._fixed = network.picture.shape[2:]
        height, width = (
            size or (sys.maxsize if slice_px == 0 else _OWN_SIDE) for size in self._fixed
        )
        if slice_px:
            height, width = min(slice_px, height), min(slice_px, width)
        self._side = height, width
        whole = (height, width) == (_OWN_SIDE, _OWN_SIDE)
        self._overlap = _OWN_OVERLAP if whole else round(_OVERLAP * min(height, width))

    def tiles(
        self, number: int, view: ViewInput, gsd_m: float | None, scale: float = 1.0
    ) -> Iterator[Tile]:
        """Yield the inputs of a view.

        Args:
            number: Of the view.
            view: The view.
            gsd_m: Ground sampling distance [m/px]; None: it is taken as it is.
            scale: One of `scales`.

        Raises:
            ValueError: If the distance is not positive, or so coarse that resampling is senseless.
        """
        height, width = size = view.size
        if gsd_m is not None:
            if not (gsd := finite_number(gsd_m, "gsd_m")) > 0.0:
                raise ValueError(f"gsd_m must be a positive number of metres, got {gsd_m!r}")
            size = trained_size(size, gsd, self._gsd_m, self._aim_m)
        view = view.resized(*(max(1, round(scale * side)) for side in size))
        factors = view.size[1] / width, view.size[0] / height
        for window in windows(view.size, self._side, self._overlap):
            part = view.cut(window)
            if part.any_seen:
                planes, levels = self._planes(part)
                yield Tile(number, planes, Placement(), window, factors, levels)

    def _planes(self, view: ViewInput) -> tuple[Array, Array | None]:
        levels = None
        if self._grey:
            flat = view.as_grey()
            planes = grey_input(flat.image, flat.footprint)
        else:
            pieces = _pair(view.fragment_colour, view.fragment_coherence)
            ground = _pair(view.ground, view.ground_rays)
            planes = network_input(
                *(view.image, view.footprint, view.rarity, view.plain),
                *(_pair(view.coherent, view.coherence), view.fragments, pieces, ground),
            )
            if view.all_known and pieces is not None and ground is not None:
                levels = level_planes(view.image, view.footprint, pieces, ground)
        if self._channels != list(range(len(planes))):
            planes = planes[self._channels]
        height, width = (
            fixed or -(-side // self._stride) * self._stride
            for fixed, side in zip(self._fixed, view.size, strict=True)
        )
        return padded(planes, (height, width)), levels


def _pair(image: Array | None, coherence: Array | None) -> tuple[Array, Array] | None:
    return None if image is None or coherence is None else (image, coherence)


def _trained_gsd(network: Network) -> tuple[tuple[float, float], float]:
    """Ground sampling distances between which a network was trained, and the best one [m/px]."""
    texts = network.metadata.get("gsd_m"), network.metadata.get("aim_gsd_m")
    try:
        low, high = TRAINED_GSD_M if texts[0] is None else map(float, texts[0].split(","))
        aim = AIM_GSD_M if texts[1] is None else float(texts[1])
    except ValueError:
        low, high, aim = 0.0, 0.0, 0.0
    if not 0.0 < low <= aim <= high < np.inf:
        raise ValueError(
            f"{network.name}: expected gsd_m in the metadata as two distances in metres, and "
            f"aim_gsd_m between them (by default {AIM_GSD_M:g}), got {texts[0]!r} and {texts[1]!r}"
        )
    return (low, high), aim


def _stride(network: Network) -> int:
    text = network.metadata.get("stride", "16")
    if not text.isdigit() or int(text) < 1:
        raise ValueError(
            f"{network.name}: expected a stride in pixels in the metadata, got {text!r}"
        )
    return int(text)
