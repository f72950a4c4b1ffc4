"""What the person network sees: contrast against the surroundings, colour by colour.

The same lines prepare integral images for training and for finding people.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.detect.contrast import SURROUND_PX, local_contrast
from hsvaos.detect.surprise import surprise_of_colours, surprise_of_contrasts

CHANNELS = (
    *("red", "green", "blue", "plain red", "plain green", "plain blue", "rarity", "rays"),
    *("coherence", "plain surprise", "rare colour", "rare contrast"),
    *("coherent colour", "coherent contrast", "fragments"),
    *("fragment red", "fragment green", "fragment blue", "fragment coherence"),
    *("ground light", "ground red-green", "ground blue-yellow", "ground rays"),
    *("ground surprise", "ground fragments"),
)
"""Channels of the network's input, in order."""

PHOTO_LAYERS = {
    "fragments": ("fragments", "ground fragments"),
    "fragment_coherence": CHANNELS[15:19],
    "ground": CHANNELS[19:25],
}
"""What of single photos makes which channels."""

TRAINED_GSD_M = (0.045, 0.09)
"""Ground sampling distances [m/px] between which the network was trained."""

AIM_GSD_M = 0.05
"""Ground sampling distance [m/px] to which finer and coarser images are brought."""

_LIMIT = 8.0
"""Contrast is cut off there: a lamp must not drown a person beside it."""

_UNIT = 0.25
"""Brings contrast to about the range -1..1 that networks like."""

_LIGHT_SHARE = np.float32(0.1)
"""Of the light around, added before the logarithm: what is black has no colour."""

_COMPRESSED_UNIT = 0.5
_GROUND_UNIT = 0.5
_SURPRISE_UNIT = 0.5


def photo_layers(channels: Sequence[str]) -> tuple[str, ...]:
    """Return what of single photos is needed for channels, names in `PHOTO_LAYERS`.

    Args:
        channels: Their names.
    """
    return tuple(name for name, own in PHOTO_LAYERS.items() if not set(own).isdisjoint(channels))


def network_input(
    image: ArrayLike,
    footprint: ArrayLike | None = None,
    rarity: ArrayLike | None = None,
    plain: ArrayLike | None = None,
    coherence: tuple[ArrayLike, ArrayLike] | None = None,
    fragments: ArrayLike | None = None,
    fragment_coherence: tuple[ArrayLike, ArrayLike] | None = None,
    ground: tuple[ArrayLike, ArrayLike] | None = None,
) -> NDArray[np.float32]:
    """Return the input of the person network for one integral image.

    Every pixel becomes its distance from the mean of its surround, a square of 129 pixels, in
    deviations of that surround, one deviation for the three colours together so that hue stays.
    Mean and deviation are those of the values clipped at 3 deviations. No value depends on the
    exposure of the whole image. To this comes the surprise of colours and contrasts within the
    whole image (see `surprise`), weighed by rarity map and coherence. What is not known is 0.

    Args:
        image: Shape (H, W, 3) RGB or (H, W) grey, any number type; NaN where nothing was seen. The
            integral image, weighted by rarity, hue or not at all.
        footprint: Shape (H, W), how many rays each pixel has seen; 0 where none. None if unknown.
        rarity: Shape (H, W), the rarity map. None if unknown.
        plain: Shape (H, W, 3) or (H, W), the plain mean of all rays. By default the image.
        coherence: Mean colour of the rays that agree, shape (H, W, 3) or (H, W), and how much they
            do, shape (H, W), see `Integrator.coherence`. None if unknown.
        fragments: Shape (H, W), any unit, the evidence of pieces of people in single photos, see
            `FragmentNet`, averaged over the rays. None if unknown.
        fragment_coherence: As `coherence`, of photos weighed by that evidence. None if unknown.
        ground: Mean colour of the rays that come from the ground and not from crowns, as
            `FragmentNet` tells, shape (H, W, 3) or (H, W), and how many, shape (H, W). None if
            unknown.

    Returns:
        Shape (25, H, W), float32, see `CHANNELS`.

    Raises:
        ValueError: If a shape does not fit.
    """
    picture, seen = _picture(image, "image")
    size = picture.shape[:2]
    rays = _fitting(footprint, size, "footprint")
    if rays is not None:
        seen &= rays > 0.0
    whole = np.zeros((len(CHANNELS), *size), dtype=np.float32)
    whole[0:3] = _clipped(local_contrast(picture, seen))
    contrasts = surprise_of_contrasts(_deviations(whole[0 : picture.shape[2]]), seen)
    colours = contrasts  # grey has none, and its levels follow the exposure
    if picture.shape[2] == 3:
        colours = surprise_of_colours(picture, seen)
    whole[3:6], whole[9] = whole[0:3], contrasts
    if plain is not None:
        second, known = _sized(plain, size, "plain")
        known = known if rays is None else known & (rays > 0.0)
        whole[3:6] = _clipped(local_contrast(second, known))
        whole[9] = surprise_of_contrasts(_deviations(whole[3 : 3 + second.shape[2]]), known)
    whole[9] *= np.float32(_SURPRISE_UNIT)
    rare = _fitting(rarity, size, "rarity")
    known, weight = seen, np.ones(size, dtype=np.float32)
    if rare is not None:
        known = np.isfinite(rare) & (seen if rays is None else rays > 0.0)
        weight = np.where(known, rare, np.float32(0.0))
        whole[6] = _clipped(local_contrast(weight[..., None], known))[0]
    whole[10] = _weighed(weight, colours, known)
    whole[11] = _weighed(weight, contrasts, known)
    if rays is not None:
        whole[7] = np.log1p(np.maximum(np.nan_to_num(rays, nan=0.0), 0.0)) / 4.0
    everywhere = np.ones(size, dtype=np.bool_) if rays is None else rays > 0.0
    if coherence is not None:
        whole[8], whole[12], whole[13] = _coherence(coherence, everywhere)
    pieces = _fitting(fragments, size, "fragments")
    if pieces is not None:
        known = np.isfinite(pieces) & (seen if rays is None else rays > 0.0)
        pieces = np.where(known, pieces, np.float32(0.0))
        whole[14] = _compressed(local_contrast(pieces[..., None], known))[0]
    if fragment_coherence is not None:
        agreed = _agreed(fragment_coherence, everywhere, "fragment_coherence")
        whole[15:18], whole[18] = agreed.contrast, agreed.coherence
    if ground is not None:
        count = _ground_into(whole[19:24], ground)
        if pieces is not None:  # of all rays, brought to those that can show anybody
            total = pieces if rays is None else pieces * np.where(seen, rays, np.float32(0.0))
            by_ray = total / (count + np.float32(1.0))
            whole[24] = _compressed(local_contrast(by_ray[..., None], everywhere))[0]
    return whole


def _ground_into(out: NDArray[np.float32], ground: tuple[Any, Any]) -> NDArray[np.float32]:
    """Fill the five channels of the ground's colours and rays, and return the rays, without NaN."""
    colour, known = _sized(ground[0], out.shape[1:], "ground[0]")
    rays = _fitting(ground[1], out.shape[1:], "ground[1]")
    count = np.zeros(out.shape[1:], np.float32) if rays is None else np.nan_to_num(rays, nan=0.0)
    count = np.maximum(count, np.float32(0.0))
    known = known & (count > 0.0)
    for k, opponent in enumerate(_opponents(colour, known)):
        out[k] = _clipped(local_contrast(opponent[..., None], known))[0]
    out[3] = np.float32(_GROUND_UNIT) * np.log1p(count)
    if colour.shape[2] == 3:
        out[4] = surprise_of_colours(colour, known) * np.float32(_SURPRISE_UNIT)
    return count


@dataclass(frozen=True, eq=False)
class _Agreed:
    """What rays show that agree: colours where any do, and how much they agree.

    Args:
        picture: Shape (H, W, C), their mean colour.
        known: Shape (H, W), where any agree.
        weight: Shape (H, W), squared coherence.
        contrast: Shape (3, H, W) or (1, H, W), contrast of the colours.
        coherence: Shape (H, W), contrast of the weight.
    """

    picture: NDArray[np.float32]
    known: NDArray[np.bool_]
    weight: NDArray[np.float32]
    contrast: NDArray[np.float32]
    coherence: NDArray[np.float32]


def _agreed(pair: tuple[Any, Any], seen: NDArray[np.bool_], name: str) -> _Agreed:
    picture, known = _sized(pair[0], seen.shape, f"{name}[0]")
    much = _fitting(pair[1], seen.shape, f"{name}[1]")
    agreement = np.nan_to_num(np.zeros(seen.shape, np.float32) if much is None else much, nan=0.0)
    known = known & (agreement > 0.0)
    weight = agreement * agreement
    contrast = _clipped(local_contrast(picture, known))
    itself: NDArray[np.float32] = _compressed(local_contrast(weight[..., None], seen))[0]
    return _Agreed(picture, known, weight, contrast, itself)


def _opponents(colour: NDArray[np.float32], known: NDArray[np.bool_]) -> list[NDArray[np.float32]]:
    """Return logarithms of lightness, of red to green and of blue to yellow; of grey the first.

    Sun flecks and shadows are far apart in colours, and near each other in their ratios: there
    clothes in a shadow stand out, as they would in the sun.
    """
    weight = known.astype(np.float32)
    side = (SURROUND_PX, SURROUND_PX)
    around = cv2.blur(colour.mean(axis=2) * weight, side) / np.maximum(cv2.blur(weight, side), 1e-3)
    around = np.maximum(_LIGHT_SHARE * around, np.float32(1e-6))
    logs = np.log(np.maximum(colour, np.float32(0.0)) + around[..., None])
    light = logs.mean(axis=2)
    if colour.shape[2] == 1:
        return [light]
    red, green, blue = np.moveaxis(logs, 2, 0)
    return [light, red - green, blue - np.float32(0.5) * (red + green)]


def _coherence(
    pair: tuple[Any, Any], seen: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the channels of coherence, itself and weighed by its colours' surprise."""
    agreed = _agreed(pair, seen, "coherence")
    contrasts = surprise_of_contrasts(_deviations(agreed.contrast), agreed.known)
    colours = contrasts
    if agreed.picture.shape[2] == 3:
        colours = surprise_of_colours(agreed.picture, agreed.known, among_alike=True)
    rare_colour = _weighed(agreed.weight, colours, seen)
    return agreed.coherence, rare_colour, _weighed(agreed.weight, contrasts, seen)


def _weighed(
    values: NDArray[np.float32], surprises: NDArray[np.float32], seen: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Contrast of values times how rare their colours are, 1e-3 to 1."""
    rare = np.exp(np.float32(np.log(10.0)) * (np.minimum(surprises, np.float32(3.0)) - 3.0))
    weighed = np.asarray(values * rare, dtype=np.float32)
    channel: NDArray[np.float32] = _compressed(local_contrast(weighed[..., None], seen))[0]
    return channel


def _clipped(z: NDArray[np.float32]) -> NDArray[np.float32]:
    np.clip(z, -_LIMIT, _LIMIT, out=z)
    z *= np.float32(_UNIT)
    return z


def _deviations(channels: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.multiply(channels, np.float32(1.0 / _UNIT), dtype=np.float32)


def _compressed(z: NDArray[np.float32]) -> NDArray[np.float32]:
    """For what is next to nothing almost everywhere: many deviations still tell."""
    np.maximum(z, np.float32(-_LIMIT), out=z)
    size = np.log1p(np.abs(z))
    size *= np.float32(_COMPRESSED_UNIT)
    return np.copysign(size, z, out=size)


def _sized(
    values: Any, size: tuple[int, ...], name: str
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    picture, known = _picture(values, name)
    if picture.shape[:2] != size:
        raise ValueError(f"{name} must have the image's size {size}, got {picture.shape[:2]}")
    return picture, known


def _picture(values: Any, name: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return (H, W, 3), or (H, W, 1) of grey, without NaN, and where it was seen."""
    picture = np.asarray(values, dtype=np.float32)
    if picture.ndim == 2:
        picture = picture[..., None]
    if picture.ndim != 3 or picture.shape[2] not in (1, 3) or 0 in picture.shape:
        raise ValueError(
            f"{name} must have shape (H, W, 3) or (H, W), got {np.asarray(values).shape}"
        )
    finite = np.isfinite(picture)
    if finite.all():
        return picture, np.ones(picture.shape[:2], dtype=np.bool_)
    seen = np.asarray(finite.all(axis=2))
    kept = np.where(seen[..., None], picture, np.float32(0.0))
    return np.asarray(kept, dtype=np.float32), seen


def _fitting(values: Any, size: tuple[int, ...], name: str) -> NDArray[np.float32] | None:
    if values is None:
        return None
    plane = np.asarray(values, dtype=np.float32)
    if plane.shape != size:
        raise ValueError(f"{name} must have the image's size {size}, got {plane.shape}")
    return plane
