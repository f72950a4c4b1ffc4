"""Numbers as colours, fast enough for every movement of a slider."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.report.figures import (
    COLOUR_MAPS,
    as_rgb,
    covered,
    footprint_limits,
    percentiles,
    shining_limits,
    stretch_limits,
)
from hsvaos.viewer.request import Look

Rgb = NDArray[np.uint8]

_SAMPLES = 20_000
"""Pixels that the automatic stretch looks at."""

_MIDTONE = 0.3
_STRONGEST_GAMMA = 0.45
"""As in `hsvaos.report.figures.stretch`: the median is lifted to a midtone, but not more."""

_TILE = 12
"""Side of a tile of the pattern that says "no photo saw this" [px]."""

_LIGHT, _DARK = 88, 74


def integral_picture(image: NDArray[np.float32], footprint: NDArray[np.float32], look: Look) -> Rgb:
    """Stretch an integral image for the eye; what no photo saw gets a pattern, never black.

    One offset and gain for all channels, then one curve that lifts the median to a midtone, both
    measured on a sample of the pixels.

    Args:
        image: Shape (H, W, C), C = 1 or 3.
        footprint: Shape (H, W).
        look: Contrast and brightness that the user set.

    Returns:
        Shape (H, W, 3), uint8.
    """
    valid = covered(footprint)
    low, high = limits(image, valid)
    middle = 0.5 * (low + high)
    half = max(0.5 * (high - low) / look.contrast, 1e-6)
    low, high = middle - half, middle + half
    gain = 255.0 / (high - low)
    shown = cv2.addWeighted(image, gain, image, 0.0, -low * gain, dtype=cv2.CV_8U)
    if shown.ndim == 2:
        shown = shown[..., None]
    every = _stride(valid)
    sample = shown[::every, ::every][valid[::every, ::every]]
    median, _ = percentiles(sample.max(axis=-1), (50.0, 50.0)) if sample.size else (0.0, 0.0)
    gamma = np.log(_MIDTONE) / np.log(median / 255.0) if 0.0 < median < 255.0 else 1.0
    gamma = float(np.clip(gamma, _STRONGEST_GAMMA, 1.0)) / look.brightness
    curve = np.rint(255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.uint8)
    return with_pattern(_three(cv2.LUT(shown, curve)), valid)


def limits(image: NDArray[np.float32], valid: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the values to show as black and white, from a sample of the covered pixels."""
    every = _stride(valid)
    sample = valid[::every, ::every]
    if not sample.any():
        return 0.0, 1.0
    return stretch_limits(image[::every, ::every], sample)


def footprint_picture(footprint: NDArray[np.float32]) -> Rgb:
    """Paint the sum of weights, dark to bright from zero to its largest value."""
    return _mapped(footprint, covered(footprint), footprint_limits(footprint), "viridis")


def rarity_picture(rarity: NDArray[np.float32], footprint: NDArray[np.float32]) -> Rgb:
    """Paint a map of rarity, shape (H, W)."""
    valid = covered(footprint)
    every = _stride(valid)
    part = shining_limits(rarity[::every, ::every], valid[::every, ::every])
    return _mapped(rarity, valid, part, "inferno")


def photo_picture(photo: NDArray[Any]) -> Rgb:
    """Return a photo for display: 8 bit colour as it is, any other (thermal) stretched."""
    if photo.dtype == np.uint8 and photo.ndim == 3:
        return np.ascontiguousarray(photo)
    image = as_rgb(photo)
    return integral_picture(image, np.ones(photo.shape[:2], np.float32), Look())


def side_by_side(pictures: list[Rgb]) -> Rgb:
    """Put pictures of one height beside each other, with a thin white line between them."""
    joined = []
    for i, picture in enumerate(pictures):
        part = picture.copy()
        if i:
            part[:, :2] = 255
        joined.append(part)
    return np.concatenate(joined, axis=1)


def with_pattern(picture: Rgb, valid: NDArray[np.bool_]) -> Rgb:
    """Return a picture with a grey chequer where nothing was sampled.

    Args:
        picture: Shape (H, W, 3); changed in place.
        valid: Shape (H, W).
    """
    if valid.all():
        return picture
    rows, columns = np.ogrid[: valid.shape[0], : valid.shape[1]]
    chequer = np.where((rows // _TILE + columns // _TILE) % 2 == 0, _LIGHT, _DARK).astype(np.uint8)
    holes = ~valid
    picture[holes] = chequer[holes][:, None]
    return picture


def jpeg(picture: Rgb, quality: int = 85) -> bytes:
    """Return a picture as the content of a JPEG file."""
    return _encoded(picture, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])


def png(picture: Rgb) -> bytes:
    """Return a picture as the content of a PNG file."""
    return _encoded(picture, ".png", [])


def _encoded(picture: Rgb, suffix: str, options: list[int]) -> bytes:
    good, content = cv2.imencode(suffix, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), options)
    if not good:
        raise ValueError(f"a picture of shape {picture.shape} cannot be encoded as {suffix}")
    return content.tobytes()


def _mapped(
    values: NDArray[np.float32], valid: NDArray[np.bool_], span: tuple[float, float], name: str
) -> Rgb:
    low, high = span
    gain = 255.0 / (high - low) if high > low else 0.0
    level = cv2.addWeighted(values, gain, values, 0.0, -low * gain, dtype=cv2.CV_8U)
    bgr = cv2.applyColorMap(level, COLOUR_MAPS[name])
    return with_pattern(np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)), valid)


def _three(picture: NDArray[Any]) -> Rgb:
    if picture.ndim == 3 and picture.shape[2] == 3:
        return picture
    return np.asarray(cv2.cvtColor(picture.reshape(picture.shape[:2]), cv2.COLOR_GRAY2RGB))


def _stride(valid: NDArray[np.bool_]) -> int:
    return max(1, int((valid.size / _SAMPLES) ** 0.5))
