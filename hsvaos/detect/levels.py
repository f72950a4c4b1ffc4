"""What the second look sees beside contrasts: the colours themselves.

A contrast against the surroundings says neither whether it is snow or litter that a spot lies on,
nor whether the spot is as brown as wood. So the second look is told lightness, as a ratio to that
of the ground in the whole view, and two ratios of colours, which shadows leave alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_PICTURES = ("rare", "fragment", "ground")
LEVEL_CHANNELS = tuple(
    f"{picture} {what} level"
    for picture in _PICTURES
    for what in ("light", "red-green", "blue-yellow")
)
"""Channels, in order: of the integral weighted by rarity, of the pieces of people that agree, and
of the rays that come from the ground."""

_DARK = 0.05
"""Of the typical lightness, added before the logarithm: what is black has no colour."""

_LIMIT = 3.0
_LIGHT_UNIT = 0.5


def level_planes(
    image: Any, rays: Any, fragments: tuple[Any, Any], ground: tuple[Any, Any]
) -> NDArray[np.float32]:
    """Return the colours of one view as the second look takes them.

    Args:
        image: Shape (H, W, 3) RGB or (H, W) grey, any unit: the integral image weighted by rarity.
        rays: Shape (H, W), how many each pixel has seen.
        fragments: Mean colour of the pieces of people that agree, in the same unit, shapes as
            `image`, and how much they do, shape (H, W).
        ground: Mean colour of the rays that come from the ground, and how many do.

    Returns:
        Shape (9, H, W), float32, see `LEVEL_CHANNELS`: natural logarithms, the first of each three
        halved; 0 where nothing is known.
    """
    pairs = [(image, rays), fragments, ground]
    pictures = [_channels(colour) for colour, _ in pairs]
    known = [
        np.isfinite(channels[0] + channels[1] + channels[2]) & (np.nan_to_num(much, nan=0.0) > 0.0)
        for channels, (_, much) in zip(pictures, pairs, strict=True)
    ]
    typical = _typical(pictures[2], known[2]) or _typical(pictures[0], known[0]) or 1.0
    out = np.zeros((len(LEVEL_CHANNELS), *known[0].shape), dtype=np.float32)
    unit = np.float32(1.0 / typical)
    for k, (channels, shown) in enumerate(zip(pictures, known, strict=True)):
        red, green, blue = (_logarithm(channel * unit, shown) for channel in channels)
        light = (red + green + blue) * np.float32(_LIGHT_UNIT / 3.0)
        opposed = light, red - green, blue - np.float32(0.5) * (red + green)
        for n, plane in enumerate(opposed, 3 * k):
            np.clip(plane, -_LIMIT, _LIMIT, out=out[n])
            out[n] *= shown
    return out


def _channels(picture: Any) -> list[NDArray[np.float32]]:
    """Return red, green and blue; grey is all three."""
    values = np.asarray(picture, dtype=np.float32)
    return [values] * 3 if values.ndim == 2 else [values[..., k] for k in range(3)]


def _logarithm(ratio: NDArray[np.float32], shown: NDArray[np.bool_]) -> NDArray[np.float32]:
    np.copyto(ratio, np.float32(0.0), where=~shown)
    np.maximum(ratio, np.float32(0.0), out=ratio)
    ratio += np.float32(_DARK)
    return np.log(ratio, out=ratio)


def _typical(channels: list[NDArray[np.float32]], known: NDArray[np.bool_]) -> float:
    """Return the median lightness of what is known, or 0."""
    values = (channels[0] + channels[1] + channels[2])[known]
    return float(np.median(values)) / 3.0 if len(values) else 0.0
