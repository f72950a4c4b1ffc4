"""What the fragment network sees of a photo: its colours, and how rare they are over the flight."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.fragments import FRAGMENT_CHANNELS
from hsvaos.kernels.rarity import apply_rarity
from hsvaos.rarity_model import RarityModel

MEDIAN = 0.25
"""Brightness that the median pixel of the flight is brought to: no exposure is better."""

_COMMON = 2.0
"""Powers of ten of one colour among hundreds: nothing surprising."""

_MOST = 5.0
"""Powers of ten beyond which a colour is just very rare."""

_MIDDLE = 1.5
_COLOUR_SPAN = 4.0
_FEWEST = 1e-9
_SPARSE = 8
"""Every so many rows and columns count for the median."""


class FragmentInput:
    """Makes the inputs of a flight's colour photos.

    Colours are the square roots of levelled brightness, -2 to 2, the median of the flight being 0.
    Surprise is -log10 p of the colour's bin in the flight's histogram (`rarity_model`): of chroma
    given lightness, and of both together; 100 times rarer than certain is -1.5.

    Args:
        images: Warp array, shape (N, H, W, 3), RGB; uint8, uint16 or float32 (0..1).
        model: Colour histogram of these images.
        gains: Shape (N, 3), factors that level the images, as when the histogram was made.

    Raises:
        ValueError: If the images are grey: they have no chroma.
    """

    def __init__(
        self, images: Any, model: RarityModel, gains: NDArray[np.float64] | None = None
    ) -> None:
        if model.is_grey:
            raise ValueError("fragments are sought in colour photos, got grey ones")
        self._images = images
        self._gains = gains
        self._tables = [np.append(np.float32(0.0), part.reshape(-1)) for part in surprises(model)]
        numbers = np.arange(1, model.counts.size + 1, dtype=np.float32)
        self._numbered = replace(model, weights=numbers.reshape(model.counts.shape))
        middles = [self._middle(i) for i in range(len(self))]
        self._scale = MEDIAN / max(float(np.median(middles)), 1e-6)

    def __len__(self) -> int:
        return int(self._images.shape[0])

    def __call__(self, index: int) -> NDArray[np.float32]:
        """Return the input of a photo, shape (5, H, W), float32.

        Args:
            index: Of the photo.
        """
        photo = self._images[index : index + 1]
        own = None if self._gains is None else self._gains[index : index + 1]
        pixels = photo.numpy()[0]
        planes = np.empty((len(FRAGMENT_CHANNELS), *pixels.shape[:2]), dtype=np.float32)
        for k, factor in enumerate(self._factors(index) * self._scale):
            planes[k] = _rooted(cv2.extractChannel(pixels, k), float(factor))
        # bins by number, from 1 on; 0 where there is no colour
        bins = apply_rarity(photo, self._numbered, dtype="float32", gains=own).numpy()[0]
        number = bins.astype(np.int32)
        for k, table in enumerate(self._tables, 3):
            np.take(table, number, out=planes[k], mode="clip")
        planes[3:] -= np.float32(_MIDDLE)
        return planes

    def _factors(self, index: int) -> NDArray[np.float64]:
        return np.ones(3) if self._gains is None else np.asarray(self._gains[index])

    def _middle(self, index: int) -> float:
        """Median brightness of a levelled photo."""
        pixels = self._images[index].numpy()[::_SPARSE, ::_SPARSE]
        levelled = pixels.astype(np.float64) / _unit(pixels.dtype) * self._factors(index)
        return float(np.nanmedian(levelled.max(axis=-1)))


def surprises(model: RarityModel) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the surprise of every bin, 0 to 5: of chroma given lightness, and of both.

    Args:
        model: Of colours.

    Returns:
        Two arrays of the shape of the histogram, float32.
    """
    lightness = model.counts.sum(axis=(1, 2), keepdims=True) / max(model.counts.sum(), 1)
    given = model.probability
    return _surprise(given), _surprise(given * lightness)


def _surprise(share: NDArray[np.float64]) -> NDArray[np.float32]:
    powers = -np.log10(np.maximum(share, _FEWEST)) - _COMMON
    return np.clip(powers, 0.0, _MOST).astype(np.float32)


def _unit(dtype: Any) -> float:
    return float(np.iinfo(dtype).max) if np.issubdtype(dtype, np.integer) else 1.0


def _rooted(channel: NDArray[Any], factor: float) -> NDArray[np.float32]:
    """Square root of brightness times a factor, 0..1, spread to -2..2."""
    if channel.dtype == np.uint8:
        table = _curve(np.arange(256) / 255.0, factor)
        return np.asarray(cv2.LUT(channel, table), dtype=np.float32)
    return _curve(np.nan_to_num(channel) / _unit(channel.dtype), factor)


def _curve(brightness: NDArray[Any], factor: float) -> NDArray[np.float32]:
    root = np.sqrt(np.clip(brightness * factor, 0.0, 1.0))
    return np.asarray(_COLOUR_SPAN * root - 0.5 * _COLOUR_SPAN, dtype=np.float32)
