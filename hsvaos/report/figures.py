"""Display pictures (8 bit RGBA) from the arrays of a run. Pure functions, no files.

Everywhere, alpha is 0 where nothing was sampled: "no sample" must never look like a dark place.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Rgba = NDArray[np.uint8]
Float = NDArray[np.float32]

STRETCH_PERCENT = (2.0, 99.9)
"""Percentiles that become black and white. The upper one is close to 100 because a person may be
the brightest thing in the picture and must not be clipped away."""

SHINING_PERCENT = 99.8
"""Percentile of a map of rarity or evidence that gets the last colour: the rest must shine."""

_MIDTONE = 0.3
"""Shade that the median pixel is lifted to where a few bright things leave the rest in the dark."""

_STRONGEST_GAMMA = 0.45
"""Beyond this the lift would show noise instead of shadows."""

_SAMPLE_LIMIT = 2_000_000
"""Percentiles of more pixels than about this are taken from a regular subset."""

_LEAST_GROUND_RAYS = 0.25

COLOUR_MAPS = {
    "inferno": cv2.COLORMAP_INFERNO,
    "viridis": cv2.COLORMAP_VIRIDIS,
    "turbo": cv2.COLORMAP_TURBO,
}


def covered(footprint: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where at least one photo contributed.

    Args:
        footprint: Shape (H, W), sum of weights.
    """
    return np.asarray(np.isfinite(footprint) & (footprint > 0))


def of_ground(rays: Float) -> Float:
    """Return how many rays show the ground, 0 where there are too few for a picture of it.

    What a quarter of a ray shows is a crown that could be ground.

    Args:
        rays: Shape (H, W), sum of the weights of `EvidenceIntegrators.ground`.
    """
    return np.where(rays >= _LEAST_GROUND_RAYS, rays, np.float32(0.0))


def as_rgb(image: NDArray[Any]) -> Float:
    """Return an image of one or three channels as RGB.

    Args:
        image: Shape (H, W), (H, W, 1) or (H, W, 3).

    Returns:
        Shape (H, W, 3), float32.

    Raises:
        ValueError: If it has another shape.
    """
    pixels = np.asarray(image)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3):
        raise ValueError(f"image must be (H, W), (H, W, 1) or (H, W, 3), got {pixels.shape}")
    return np.array(np.broadcast_to(pixels, (*pixels.shape[:2], 3)), dtype=np.float32)


def percentiles(values: NDArray[Any], percents: tuple[float, float]) -> tuple[float, float]:
    """Return two percentiles of the finite values, of a regular subset where there are very many.

    Args:
        values: Any shape.
        percents: Two percentages, 0..100.

    Returns:
        The percentiles; (0, 0) of nothing.
    """
    flat = np.asarray(values, dtype=np.float32).ravel()
    flat = flat[:: max(1, flat.size // _SAMPLE_LIMIT)]
    flat = flat[np.isfinite(flat)]
    if flat.size == 0:
        return 0.0, 0.0
    low, high = np.percentile(flat, percents)
    return float(low), float(high)


def stretch_limits(image: NDArray[Any], valid: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the values that `stretch` shows as black and as white.

    Black is the low percentile of the darkest channel, white the high percentile of the brightest,
    both over the covered pixels, so that few channels of few pixels are clipped.

    Args:
        image: Shape (H, W), (H, W, 1) or (H, W, 3).
        valid: Shape (H, W), pixels that count.
    """
    every = max(1, int(np.sqrt(valid.size / _SAMPLE_LIMIT)))
    pixels = as_rgb(image[::every, ::every])[valid[::every, ::every]]
    low, _ = percentiles(pixels.min(axis=-1), STRETCH_PERCENT)
    _, high = percentiles(pixels.max(axis=-1), STRETCH_PERCENT)
    return low, high


def stretch(
    image: NDArray[Any],
    footprint: NDArray[Any] | None = None,
    limits: tuple[float, float] | None = None,
) -> Rgba:
    """Stretch the contrast of an image robustly for the eye.

    One offset and one gain for all channels leave the hue of every pixel as it is. Then dark
    pictures are lifted by v^(gamma), v the brightest channel, 0.45 <= gamma <= 1 so chosen that the
    median becomes 0.3; a pixel that is too bright is scaled down. Both change all channels of a
    pixel by one factor, which keeps hue and saturation.

    Args:
        image: Shape (H, W), (H, W, 1) or (H, W, 3), any real dtype.
        footprint: Shape (H, W); pixels where it is 0 become transparent. All count if None.
        limits: Values to show as black and white; by default `stretch_limits`.

    Returns:
        Shape (H, W, 4), uint8 RGBA.
    """
    pixels = as_rgb(image)
    valid = np.ones(pixels.shape[:2], bool) if footprint is None else covered(footprint)
    low, high = stretch_limits(pixels, valid) if limits is None else limits
    if high > low:
        pixels -= np.float32(low)
        pixels *= np.float32(1.0 / (high - low))
    else:  # one single value everywhere: a calm grey says so better than black or noise
        pixels[:] = 0.5
    np.nan_to_num(pixels, copy=False, nan=0.0, posinf=1.0, neginf=0.0)
    np.maximum(pixels, 0.0, out=pixels)
    # Pairwise: a reduction over an axis of three is many times slower.
    value = np.maximum(np.maximum(pixels[..., 0], pixels[..., 1]), pixels[..., 2])
    middle, _ = percentiles(value[valid], (50.0, 50.0))
    gamma = np.log(_MIDTONE) / np.log(middle) if 0.0 < middle < 1.0 else 1.0
    lifted = np.minimum(value, 1.0) ** np.float32(np.clip(gamma, _STRONGEST_GAMMA, 1.0))
    pixels *= (np.float32(255.0) * lifted / np.maximum(value, 1e-6))[..., None]
    return _rgba(pixels, valid)


def photo_picture(photo: NDArray[Any]) -> Rgba:
    """Return a photo for display: an 8 bit colour photo as it is, any other (thermal) stretched.

    Args:
        photo: Shape (H, W), (H, W, 1) or (H, W, 3), uint8, uint16 or float.
    """
    if photo.dtype == np.uint8 and photo.ndim == 3 and photo.shape[2] == 3:
        return _rgba(photo, np.ones(photo.shape[:2], bool))
    return stretch(photo)


def masked_photo(photo: Rgba, weights: NDArray[np.uint8]) -> Rgba:
    """Show what a mask leaves of a photo: kept pixels in colour, the rest faded to plain dark blue.

    Args:
        photo: Shape (H, W, 4), display picture.
        weights: Shape (H, W), 255 = kept in full.
    """
    # The root makes small weights visible; a mask of 0 and 255 stays as it is.
    share = np.sqrt(weights[..., None].astype(np.float32) / 255.0)
    faded = np.array([22.0, 28.0, 44.0], np.float32)
    return _rgba(photo[..., :3] * share + faded * (1.0 - share), photo[..., 3] > 0)


def colour_map(
    values: NDArray[Any],
    valid: NDArray[np.bool_],
    low: float,
    high: float,
    name: str = "inferno",
) -> Rgba:
    """Paint a scalar field with a perceptually even colour map.

    Args:
        values: Shape (H, W).
        valid: Shape (H, W); the rest becomes transparent.
        low: Value of the first colour.
        high: Value of the last colour.
        name: "inferno", "viridis" or "turbo".

    Raises:
        ValueError: If the colour map is not known.
    """
    if name not in COLOUR_MAPS:
        raise ValueError(f"name must be one of {', '.join(COLOUR_MAPS)}, got {name!r}")
    span = high - low if high > low else 1.0
    level = np.nan_to_num((np.asarray(values, np.float32) - low) / span, nan=0.0)
    bgr = cv2.applyColorMap((np.clip(level, 0, 1) * 255).astype(np.uint8), COLOUR_MAPS[name])
    return _rgba(bgr[..., ::-1], valid)


def shining_limits(values: NDArray[Any], valid: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the range of a map of rarity or evidence to show: all but its highest pixels."""
    return 0.0, percentiles(values[valid], (0.0, SHINING_PERCENT))[1]


def footprint_limits(footprint: NDArray[Any]) -> tuple[float, float]:
    """Return the range of a footprint to show: from zero to its largest value."""
    return 0.0, float(np.max(footprint, initial=0.0))


def shrink(
    values: NDArray[Any], valid: NDArray[np.bool_], longest: int
) -> tuple[Float, NDArray[Any]]:
    """Average values over blocks, if needed, until the longer side is at most `longest` [px].

    Only covered pixels enter the mean. Shrinking before painting is faster than after it.

    Args:
        values: Shape (H, W) or (H, W, C).
        valid: Shape (H, W), pixels that count.
        longest: Longest side allowed [px].

    Returns:
        values, shape (h, w, C), float32, and coverage, shape (h, w), float32: the share of each
        block that counts, 0..1.
    """
    height, width = valid.shape
    weights = valid.astype(np.float32)
    values = np.asarray(values, np.float32).reshape(height, width, -1)
    scale = longest / max(height, width)
    if scale >= 1.0:
        return values, weights
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    channels = [
        cv2.resize(np.where(valid, channel, 0.0), size, interpolation=cv2.INTER_AREA)
        for channel in np.moveaxis(values, -1, 0)
    ]
    coverage = cv2.resize(weights, size, interpolation=cv2.INTER_AREA)
    mean = np.stack(channels, axis=-1) / np.maximum(coverage, 1e-6)[..., None]
    return mean.astype(np.float32), coverage


def faded(picture: Rgba, coverage: NDArray[Any]) -> Rgba:
    """Return a picture with alpha by the share of each pixel that was seen, 0..1."""
    out = picture.copy()
    out[..., 3] = np.rint(np.asarray(coverage) * 255.0)
    return out


def fit(picture: Rgba, longest: int) -> Rgba:
    """Return a picture shrunk, if needed, until its longer side is at most `longest` [px].

    Colour is weighted by alpha while averaging, so that no dark rim grows around holes.

    Args:
        picture: Shape (H, W, 4), uint8 RGBA.
        longest: Longest side allowed [px].
    """
    height, width = picture.shape[:2]
    scale = longest / max(height, width)
    if scale >= 1.0:
        return picture
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    alpha = picture[..., 3:].astype(np.float32) / 255.0
    packed = np.concatenate([picture[..., :3] * alpha, alpha], axis=-1)
    small = cv2.resize(packed, size, interpolation=cv2.INTER_AREA)
    rgb = small[..., :3] / np.maximum(small[..., 3:], 1e-6)
    return np.concatenate([rgb, small[..., 3:] * 255.0], axis=-1).round().astype(np.uint8)


def encode(picture: Rgba, suffix: str = ".png", quality: int = 88) -> bytes:
    """Return a picture as the content of an image file.

    Args:
        picture: Shape (H, W, 4), uint8 RGBA.
        suffix: ".png" (exact) or ".webp" (small).
        quality: Of WebP, 1..100.

    Raises:
        ValueError: If the picture cannot be encoded, such as WebP beyond 16383 pixels.
    """
    options = [cv2.IMWRITE_WEBP_QUALITY, quality] if suffix == ".webp" else []
    bgra = cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA)
    good, content = cv2.imencode(suffix, bgra, options)
    if not good:
        raise ValueError(f"a picture of shape {picture.shape} cannot be encoded as {suffix}")
    return bytes(content)


def _rgba(rgb: NDArray[Any], valid: NDArray[np.bool_]) -> Rgba:
    picture = np.empty((*rgb.shape[:2], 4), np.uint8)
    picture[..., :3] = rgb if rgb.dtype == np.uint8 else np.rint(rgb)
    picture[..., 3] = 255
    picture[~valid] = 0
    return picture
