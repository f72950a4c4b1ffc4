"""Histograms over the window, updated as it flies: the newest photo is added, the oldest leaves.

Counts are whole numbers, so that nothing drifts: after any flight they are those of the photos in
the window.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.hue_statistics import HueStatistics, hue_statistics
from hsvaos.kernels.hue_mask import add_hues, histogram_of, sums_shape
from hsvaos.kernels.lab import lab_tables
from hsvaos.kernels.rarity import byte_table, weigh_photo
from hsvaos.kernels.rarity_bins import count_photo, counts_shape
from hsvaos.kernels.rarity_table import BinTable
from hsvaos.rarity_model import CHROMA_BINS, LIGHTNESS_BINS, RarityModel, model_from_counts
from hsvaos.settings import MaskSettings

Counts = NDArray[np.int64]


class RunningCounts:
    """Histograms of the photos in slots, and their sum.

    Args:
        slots: Number of slots.
        bins: Bins of a histogram.
    """

    def __init__(self, slots: int, bins: int) -> None:
        self.each: Counts = np.zeros((slots, bins), np.int64)
        self.total: Counts = np.zeros(bins, np.int64)

    def replace(self, slot: int, parts: Counts) -> None:
        """Put the histogram of a new photo in place of that of a slot.

        Args:
            slot: The slot.
            parts: Shape (P, bins), parts that sum up to the histogram.
        """
        self.total -= self.each[slot]
        parts.sum(axis=0, out=self.each[slot])
        self.total += self.each[slot]

    def clear(self) -> None:
        """Forget all photos."""
        self.each[:] = 0
        self.total[:] = 0


class RunningHue:
    """Hue statistics over the window.

    Args:
        slots: Photos of the window.
        size: Pixels of a photo.
        mask: How to cut.
        device: Warp device.
    """

    def __init__(self, slots: int, size: int, mask: MaskSettings, device: Any) -> None:
        self._mask = mask
        self._chroma, self._seen = np.zeros(slots), np.zeros(slots, bool)
        shape = sums_shape(size, device)
        self._sums: Any = wp.zeros(shape, dtype=wp.int64, device=device)
        self._counts = RunningCounts(slots, shape[1])

    def measure(self, slot: int, pixels: Any, valid: Any, scale: Any) -> HueStatistics:
        """Count a new photo's hues in place of a slot's, and return what to cut from it.

        Args:
            slot: The slot.
            pixels: Warp array (H * W) of RGB pixels.
            valid: Warp array (H * W), uint8.
            scale: Vector that brings pixels to 0..1.

        Returns:
            Statistics of the photo (scope "image"), or of the window with it (scope "flight").
        """
        how = self._mask.statistics
        self._sums.zero_()
        add_hues(pixels, valid, scale, how, self._sums)
        self._counts.replace(slot, self._sums.numpy())
        self._seen[slot] = True
        row, chroma = histogram_of(self._counts.each[slot], how)
        self._chroma[slot] = chroma
        if self._mask.scope == "flight":
            row, chroma = self.histogram, self._chroma[self._seen].mean()
        return hue_statistics(row, float(chroma), statistics=how, sigmas=self._mask.sigmas)

    def clear(self) -> None:
        """Forget all photos."""
        self._counts.clear()
        self._seen[:] = False

    @property
    def histogram(self) -> NDArray[np.float64]:
        """Shape (1440,): hue histogram of the photos in the window."""
        return histogram_of(self._counts.total, self._mask.statistics)[0]


class RunningRarity:
    """Colour histogram over the window.

    Args:
        slots: Photos of the window.
        size: Pixels of a photo.
        channels: 3 or 1.
        mask: How to weigh.
        device: Warp device.
    """

    def __init__(
        self, slots: int, size: int, channels: int, mask: MaskSettings, device: Any
    ) -> None:
        self._mask, self._colour = mask, channels == 3
        shape = counts_shape(size, channels, device)
        self._bands: Any = wp.zeros(shape, dtype=wp.int64, device=device)
        self._counts = RunningCounts(slots, shape[1])
        self._tables = lab_tables(device)
        self._fast = BinTable(size, device) if channels == 3 else None
        self._table: Any = wp.zeros(shape[1], dtype=wp.uint8, device=device)

    def weigh(self, slot: int, pixels: Any, valid: Any, scale: Any, weights: Any) -> RarityModel:
        """Count a new photo's colours in place of a slot's, and weigh its pixels by the window.

        Args:
            slot: The slot.
            pixels: Warp array (H * W) of pixels, 8 bit where they are RGB.
            valid: Warp array (H * W), uint8, 0 or 255.
            scale: Vector that brings pixels to 0..1.
            weights: Warp array (H * W), uint8, written.
        """
        self._bands.zero_()
        if self._fast is not None:
            self._fast.count(pixels, valid, self._bands)
        else:
            count_photo(pixels, valid, scale, self._tables, self._bands)
        self._counts.replace(slot, self._bands.numpy())
        model = self.model()
        self._table.assign(byte_table(model))
        if self._fast is not None:
            self._fast.weigh(valid, self._table, weights)
        else:
            weigh_photo(pixels, valid, scale, self._tables, self._table, weights)
        return model

    def clear(self) -> None:
        """Forget all photos."""
        self._counts.clear()

    def model(self) -> RarityModel:
        """Return the model of the photos in the window."""
        mask, counts = self._mask, self._counts.total
        if self._colour:
            counts = counts.reshape(LIGHTNESS_BINS, CHROMA_BINS, CHROMA_BINS)
        threshold = mask.rarity_threshold if self._colour else mask.grey_rarity_threshold
        return model_from_counts(
            counts.copy(), threshold, mask.rarity_exponent, mask.rarity_smoothing_bins
        )
