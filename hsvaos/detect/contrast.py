"""Contrast against the surroundings, which no exposure changes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]

SURROUND_PX = 129
"""Side of the surround: some three times a lying person at the finest sampling trained for."""

_COARSER = 4
"""Means over surrounds are taken of an image so much smaller: they hardly differ, and take less."""

_CLIP = 3.0
"""Deviations beyond which a value counts no more in its own surround."""

_CLIPPINGS = 2

_LEAST_DEVIATION = 0.1
"""In medians of the deviation over the image: flat surroundings must not show noise as contrast."""


def local_contrast(
    picture: Plane, seen: NDArray[np.bool_], surround_px: int = SURROUND_PX
) -> Plane:
    """Return how far each pixel is from the mean of its surround, in deviations of that surround.

    The surround is a square, of 129 pixels by default. Its mean and deviation are those of the
    values clipped at 3 deviations; one deviation for all channels together, so that hue stays.

    Args:
        picture: Shape (H, W, C), any unit, finite.
        seen: Shape (H, W), the pixels that count; others get 0.
        surround_px: Side of the surround [px].

    Returns:
        Shape (C, H, W).
    """
    channels = picture.shape[2]
    out = np.zeros((channels, *picture.shape[:2]), dtype=np.float32)
    if not seen.any():
        return out
    surround = _Surround(seen, surround_px)
    # a shift of the origin keeps the sums of squares exact
    offset = np.array(cv2.mean(picture, seen.view(np.uint8))[:channels], dtype=np.float32)
    # channel by channel and in place: sums over the last axis would cost most of the time
    values = [surround.of_seen(picture[..., k] - offset[k]) for k in range(channels)]
    centres, deviation = surround.moments(values)
    for _ in range(_CLIPPINGS):
        reach = np.float32(_CLIP) * surround.everywhere(deviation)
        clipped = []
        for value, centre in zip(values, centres, strict=True):
            middle = surround.everywhere(centre)
            part = cv2.max(cv2.min(value, middle + reach), middle - reach)
            clipped.append(surround.of_seen(np.asarray(part, dtype=np.float32)))
        centres, deviation = surround.moments(clipped)
    typical = float(np.median(deviation[surround.share > 0.5])) if surround.any_full else 0.0
    least = max(_LEAST_DEVIATION * typical, 1e-6 * float(np.abs(offset).max()), 1e-12)
    scale = np.float32(1.0) / surround.everywhere(np.maximum(deviation, np.float32(least)))
    for k, (value, centre) in enumerate(zip(values, centres, strict=True)):
        z = np.subtract(value, surround.everywhere(centre), out=out[k])
        z *= scale
        surround.of_seen(z)
    return out


class _Surround:
    """Means over the surround of every pixel, of the pixels that are seen."""

    def __init__(self, seen: NDArray[np.bool_], side_px: int) -> None:
        self._known = None if seen.all() else seen.astype(np.float32)
        height, width = seen.shape
        self._size = width, height
        coarser = _COARSER if min(seen.shape) >= 4 * _COARSER else 1
        self._small = -(-width // coarser), -(-height // coarser)
        side = (side_px // coarser) | 1
        self._box = side, side
        known = np.ones(seen.shape, np.float32) if self._known is None else self._known
        self.share = self._reduced(known)
        self.any_full = bool((self.share > 0.5).any())
        mean = np.maximum(self._blurred(self.share), np.float32(1e-6))
        self._weight: Plane = np.reciprocal(mean, out=mean)

    def of_seen(self, plane: Plane) -> Plane:
        """Return the plane, set to 0 in place where nothing is seen."""
        if self._known is not None:
            plane *= self._known
        return plane

    def everywhere(self, small: Plane) -> Plane:
        """Return a plane of means at full size."""
        if self._small == self._size:
            return small
        return np.asarray(cv2.resize(small, self._size, interpolation=cv2.INTER_LINEAR)).reshape(
            self._size[::-1]
        )

    def moments(self, parts: list[Plane]) -> tuple[list[Plane], Plane]:
        """Return the means of planes of seen values, and their deviation together."""
        centres: list[Plane] = [self._blurred(self._reduced(part)) for part in parts]
        for centre in centres:
            centre *= self._weight
        total = np.zeros(self._size[::-1], dtype=np.float32)
        for part in parts:
            cv2.accumulateSquare(part, total)
        variance = self._blurred(self._reduced(total))
        variance *= self._weight
        for centre in centres:
            variance -= centre * centre
        variance /= np.float32(len(parts))
        np.maximum(variance, np.float32(0.0), out=variance)
        return centres, np.sqrt(variance, out=variance)

    def _reduced(self, plane: Plane) -> Plane:
        if self._small == self._size:
            return plane
        return np.asarray(cv2.resize(plane, self._small, interpolation=cv2.INTER_AREA))

    def _blurred(self, small: Plane) -> Plane:
        # what lies outside the picture counts as 0
        mean = cv2.boxFilter(small, cv2.CV_32F, self._box, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(mean, dtype=np.float32).reshape(small.shape)
