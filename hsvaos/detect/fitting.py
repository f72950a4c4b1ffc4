"""Pictures brought to the size, colours and numbers that a network takes, and boxes back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.layouts import Layout
from hsvaos.detect.view_input import ViewInput

Array = NDArray[Any]

_GREY = 114
"""Shade around pictures in most YOLO families, also given to what was not seen."""

_STRETCH_PERCENT = (2.0, 99.9)
"""Shades that become black and white; the person may be the brightest thing there is."""

_SAMPLES = 1_000_000


@dataclass(frozen=True)
class Placement:
    """Where a picture lies in the input of a network.

    Args:
        scale: Pixels of the input a pixel of the picture, in x and y.
        left: Columns before it [px].
        top: Rows above it [px].
    """

    scale: tuple[float, float] = (1.0, 1.0)
    left: int = 0
    top: int = 0

    def back(self, boxes: Array) -> Array:
        """Return boxes of the input, shape (..., 4), in pixels of the picture."""
        moved = boxes - np.array([self.left, self.top] * 2, np.float32)
        return np.asarray(moved / np.array(self.scale * 2, np.float32))


def as_bytes(view: ViewInput) -> NDArray[np.uint8]:
    """Return a view as an 8-bit RGB picture for networks trained on photos.

    Colour of 8 bits is left as it is. Grey, 16 bits and floats are stretched: the 2nd percentile
    of what is seen becomes black, the 99.9th white, alike for all channels.

    Args:
        view: The view.

    Returns:
        Shape (H, W, 3), uint8; 114 where nothing is seen.
    """
    image, seen = view.image, view.seen
    if image.dtype != np.uint8 or image.ndim == 2:
        known = image if seen is None else image[seen]
        if image.ndim == 3:
            known = known.reshape(-1, 3)
        known = known[:: max(1, len(known) // _SAMPLES)] if len(known) else np.zeros(1)
        low, high = np.percentile(known, _STRETCH_PERCENT).astype(float).tolist()
        span = high - low if high > low else max(abs(high), 1.0)
        image = np.clip((np.nan_to_num(image, nan=low) - low) * (255.0 / span), 0.0, 255.0)
        image = np.rint(image).astype(np.uint8)
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    if seen is not None and not seen.all():
        image = np.where(seen[..., None], image, np.uint8(_GREY))
    return image


def fitted(picture: Array, layout: Layout, size: tuple[int, int]) -> tuple[Array, Placement]:
    """Scale a picture into the input of a network and turn it into the numbers that it takes.

    Args:
        picture: Shape (H, W, 3), uint8 RGB.
        layout: The layout.
        size: Height and width of the input [px].

    Returns:
        Shape (3, height, width), float32; and where the picture lies in it.
    """
    height, width = picture.shape[:2]
    wide, high = size[1], size[0]
    left = top = 0
    if layout.fit != "stretch":
        scale = min(size[1] / width, size[0] / height)
        wide, high = max(1, round(width * scale)), max(1, round(height * scale))
    if layout.fit == "centre":
        left, top = (size[1] - wide) // 2, (size[0] - high) // 2
    how = cv2.INTER_AREA if wide < width and high < height else cv2.INTER_LINEAR
    canvas = np.full((*size, 3), _GREY, np.uint8)
    canvas[top : top + high, left : left + wide] = cv2.resize(
        picture, (wide, high), interpolation=how
    )
    numbers: Array = canvas.astype(np.float32) * np.float32(layout.peak / 255.0)
    if layout.std != (1.0, 1.0, 1.0):
        numbers = (numbers - np.array(layout.mean, np.float32)) / np.array(layout.std, np.float32)
    if layout.bgr:
        numbers = numbers[..., ::-1]
    planes = np.ascontiguousarray(numbers.transpose(2, 0, 1))
    return planes, Placement((wide / width, high / height), left, top)


def padded(planes: Array, size: tuple[int, int]) -> Array:
    """Add zeros to the right and below.

    Args:
        planes: Shape (C, H, W).
        size: Height and width to reach [px].

    Returns:
        Shape (C, height, width).
    """
    below, right = size[0] - planes.shape[1], size[1] - planes.shape[2]
    return np.pad(planes, ((0, 0), (0, below), (0, right))) if below or right else planes
