"""Training crops: a map, an image kind, what is known of it, a scale, a turn."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.network_input import AIM_GSD_M, CHANNELS, TRAINED_GSD_M, network_input
from train.drawn import draw_figures, smooth_ground
from train.maps import (
    COHERENCE,
    COHERENT,
    FRAGMENT_COHERENCE,
    FRAGMENT_COLOUR,
    FRAGMENTS,
    GROUND,
    GROUND_RAYS,
    HUE_FOOTPRINT,
    PLANES,
    RARITY_MAP,
    RAYS,
    agreed_in,
)

CROP_PX = 256
LEAST_RAYS = 1.5
"""People with fewer unoccluded rays a point are neither wanted nor forbidden."""

LEAST_RAYS_SEEN = 3.0
"""Ground seen by fewer photos is not taught."""

_DRAWN = 16
"""People drawn into a map, where any are."""

_WEIGHED = ((FRAGMENT_COLOUR, FRAGMENT_COHERENCE), (GROUND, GROUND_RAYS))
_KINDS = ("rarity", "hue", "plain")


@dataclass(frozen=True)
class Sample:
    """One crop.

    Args:
        whole: Shape (25, 256, 256), float32, the network's input.
        boxes: Shape (K, 4), xyxy [px], people to find.
        ignored: Shape (M, 4), people who cannot be seen.
    """

    whole: NDArray[np.float32]
    boxes: NDArray[np.float64]
    ignored: NDArray[np.float64]


def visit(path: Path, rng: np.random.Generator, crops: int) -> list[Sample]:
    """Draw one look of a map, and crops from it.

    Args:
        path: Of a map, see `train.maps`.
        rng: Draws everything.
        crops: How many.
    """
    with np.load(path) as data:
        layers = data["layers"].astype(np.float32)
        boxes, rays, gsd = data["boxes"], data["rays"], float(data["gsd"])
        colour, pieces = bool(data["colour"]), bool(data["fragments"])
    layers, boxes, gsd = _scaled(layers, boxes, gsd, rng)
    layers, boxes = turned(layers, boxes, rng)
    whole, drawn, blurred = _look(layers, boxes, gsd, colour, pieces, rng)
    boxes = np.concatenate([boxes, drawn])
    rays = np.concatenate([np.zeros_like(rays) if blurred else rays, np.full(len(drawn), np.inf)])
    height, width = whole.shape[1:]
    middle = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    seen = seen_at(layers[RAYS], middle)
    wanted = (rays >= LEAST_RAYS) & seen
    samples = []
    for _ in range(crops):
        if wanted.any() and rng.uniform() < 0.75:
            at = middle[rng.choice(np.flatnonzero(wanted))]
            corner = at - rng.uniform(0.1, 0.9, 2) * CROP_PX
        else:
            corner = rng.uniform(0.0, 1.0, 2) * (np.array([width, height]) - CROP_PX)
        x, y = np.clip(corner, 0, np.maximum([width - CROP_PX, height - CROP_PX], 0)).astype(int)
        part = np.zeros((len(whole), CROP_PX, CROP_PX), dtype=np.float32)
        cut = whole[:, y : y + CROP_PX, x : x + CROP_PX]
        part[:, : cut.shape[1], : cut.shape[2]] = cut
        samples.append(Sample(part, *people_in(boxes - [x, y, x, y], wanted, CROP_PX)))
    return samples


def people_in(
    boxes: NDArray[np.float64], wanted: NDArray[np.bool_], side: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return whom a crop shall find, and whom it shows beside them.

    Args:
        boxes: Shape (K, 4), of everybody, from the corner of the crop [px].
        wanted: Shape (K,), who is to be found, if in the crop.
        side: Of the crop [px].

    Returns:
        Boxes (N, 4) and (M, 4).
    """
    middle = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    own = wanted & (middle > 0.0).all(axis=1) & (middle < side).all(axis=1)
    near = (boxes[:, 2:] > 0.0).all(axis=1) & (boxes[:, :2] < side).all(axis=1)
    return boxes[own], boxes[near & ~own]


def _scaled(
    layers: NDArray[np.float32], boxes: NDArray[np.float64], gsd: float, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float64], float]:
    low, high = TRAINED_GSD_M
    wanted = float(np.exp(rng.uniform(np.log(max(low, 0.9 * gsd)), np.log(high))))
    if rng.uniform() < 0.65:  # what users mostly look at: finer photos are brought to 5 cm
        wanted = float(np.clip(max(gsd, AIM_GSD_M) * rng.uniform(0.93, 1.1), low, high))
    return *at_sampling(layers, boxes, gsd, wanted), wanted


def at_sampling(
    layers: NDArray[np.float32], boxes: NDArray[np.float64], gsd: float, wanted: float
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return a map and its boxes resampled.

    Args:
        layers: Shape (L, H, W).
        boxes: Shape (K, 4), xyxy [px].
        gsd: Ground sampling distance of the map [m/px].
        wanted: The one to return.
    """
    factor = gsd / wanted
    height, width = (max(CROP_PX // 2, round(side * factor)) for side in layers.shape[1:])
    way = cv2.INTER_AREA if factor < 0.95 else cv2.INTER_LINEAR
    layers = layers.copy()
    for colours, weight in _WEIGHED:  # no colour is not black
        layers[colours] *= layers[weight]
    small = np.stack([cv2.resize(layer, (width, height), interpolation=way) for layer in layers])
    for colours, weight in _WEIGHED:
        small[colours] /= np.maximum(small[weight], np.float32(1e-6))
    scale = np.array([width / layers.shape[2], height / layers.shape[1]] * 2)
    return small, (boxes + 0.5) * scale - 0.5


def turned(
    layers: NDArray[np.float32], boxes: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return layers (L, H, W) and boxes (K, 4) in one of eight turns."""
    if rng.uniform() < 0.5:
        layers, boxes = layers.transpose(0, 2, 1), boxes[:, [1, 0, 3, 2]]
    height, width = layers.shape[1:]
    if rng.uniform() < 0.5:
        layers = layers[:, :, ::-1]
        boxes = np.stack(
            [width - 1 - boxes[:, 2], boxes[:, 1], width - 1 - boxes[:, 0], boxes[:, 3]], axis=1
        )
    if rng.uniform() < 0.5:
        layers = layers[:, ::-1]
        boxes = np.stack(
            [boxes[:, 0], height - 1 - boxes[:, 3], boxes[:, 2], height - 1 - boxes[:, 1]], axis=1
        )
    return np.ascontiguousarray(layers), boxes


def _look(
    layers: NDArray[np.float32],
    boxes: NDArray[np.float64],
    gsd: float,
    colour: bool,
    pieces: bool,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.float64], bool]:
    """Return the input for what a user may have, people drawn in, and whether others blurred.

    Others are those who lie in the map: blurred away they are not taught.
    """
    if rng.uniform() < (0.2 if colour else 0.65):
        return _alone(layers, boxes, gsd, colour, rng)
    kind = str(rng.choice(_KINDS, p=[0.7, 0.15, 0.15]))
    image = _image(layers, kind)
    rays = layers[RAYS]
    if kind == "hue" and rng.uniform() < 0.3:
        rays = layers[HUE_FOOTPRINT]
    known = rng.uniform(size=5) < [0.9, 0.9, 0.85, 0.6, 0.5]
    if kind == "rarity" and rng.uniform() < 0.85:
        known[:] = True  # as `hsvaos run` gives it
        known[4] = rng.uniform() < 0.85  # unless it is told to hurry
    looked = pieces and known[4]
    whole = network_input(
        image,
        rays if known[0] else None,
        layers[RARITY_MAP] if known[1] else None,
        _image(layers, "plain") if known[2] else None,
        agreed_in(layers, COHERENT, COHERENCE) if known[3] else None,
        layers[FRAGMENTS] if looked else None,
        agreed_in(layers, FRAGMENT_COLOUR, FRAGMENT_COHERENCE) if looked else None,
        agreed_in(layers, GROUND, GROUND_RAYS) if looked else None,
    )
    return jittered(whole, rng), np.zeros((0, 4)), False


def _image(layers: NDArray[np.float32], kind: str) -> NDArray[np.float32]:
    image = np.moveaxis(layers[PLANES[kind]], 0, 2)
    if kind == "hue":  # no sample is not black
        return np.where(layers[HUE_FOOTPRINT, ..., None] > 0.0, image, np.float32(np.nan))
    return image


def _alone(
    layers: NDArray[np.float32],
    boxes: NDArray[np.float64],
    gsd: float,
    colour: bool,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.float64], bool]:
    """Return the same for an image of which nothing else is known."""
    image = _image(layers, str(rng.choice(_KINDS, p=[0.4, 0.3, 0.3]))).copy()
    if not colour or rng.uniform() < 0.4:
        grey = image @ rng.dirichlet(np.ones(3)).astype(np.float32)
        if rng.uniform() < 0.4:  # white hot and black hot
            grey = np.nanmax(grey, initial=0.0) - grey
        image = np.repeat(grey[..., None], 3, axis=2)
    elif rng.uniform() < 0.5:
        image = image[..., rng.permutation(3)]
    drawn, smooth = np.zeros((0, 4)), False
    if rng.uniform() < 0.6:
        smooth = rng.uniform() < 0.4
        if smooth:
            image = smooth_ground(image, rng)
        if not colour or rng.uniform() < 0.4:
            grey = np.ascontiguousarray(image[..., :1])
            drawn = draw_figures(grey, boxes, gsd, _DRAWN, rng)
            image = np.repeat(grey, 3, axis=2)
        else:
            image = np.ascontiguousarray(image)
            drawn = draw_figures(image, boxes, gsd, _DRAWN, rng)
    if rng.uniform() < 0.3:
        blurred = cv2.GaussianBlur(np.nan_to_num(image), (0, 0), float(rng.uniform(0.4, 1.4)))
        image = np.where(np.isnan(image), image, blurred)
    if rng.uniform() < 0.3:
        image = 255.0 * np.power(np.clip(image / 255.0, 0.0, 1.0), rng.uniform(0.6, 1.6))
    image[layers[RAYS] <= 0.0] = np.nan if rng.uniform() < 0.5 else 0.0
    return jittered(network_input(image), rng), drawn, smooth


def jittered(whole: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Vary contrast and noise a little."""
    if rng.uniform() < 0.5:
        factors = np.exp(rng.normal(0.0, 0.15, (len(whole), 1, 1))).astype(np.float32)
        for name in ("rays", "ground rays"):
            factors[CHANNELS.index(name)] = 1.0
        whole *= factors
    if rng.uniform() < 0.3:
        noise = rng.standard_normal(whole[:6].shape, dtype=np.float32)
        whole[:6] += np.float32(rng.uniform(0.0, 0.06)) * noise * (whole[:6] != 0.0)
    return whole


def seen_at(rays: NDArray[np.floating], places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which places (K, 2), x and y [px], lie where enough photos see the ground."""
    height, width = rays.shape
    inside = (places > 2).all(axis=1) & (places < [width - 3, height - 3]).all(axis=1)
    at = np.clip(np.rint(places).astype(int), 0, [width - 1, height - 1])
    return np.asarray(inside & (rays[at[:, 1], at[:, 0]] >= LEAST_RAYS_SEEN))
