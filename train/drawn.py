"""People drawn into integral images: shapes and contrasts that the simulator does not know.

A network that is shown a lone image, thermal above all, must not count on the simulator's forests
and clothes. So figures of capsules are drawn into such crops, half hidden as leaves hide people,
and with them things that are none: trunks, stones, warm patches.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]

_MARGIN_M = 1.6
"""Half the side of the square in which a figure is drawn."""

_FINER = 4
"""Figures are drawn so much finer and then shrunk."""

_LEAST_SHOWN = 0.25
"""Share of a figure that has to be left for it to count as one."""


def draw_figures(
    image: Plane, boxes: NDArray[np.float64], pixel_m: float, count: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw people, and as many things that are none, into an image in place.

    Args:
        image: Shape (H, W, C), float32; NaN stays.
        boxes: Shape (K, 4), xyxy [px], who is there already and stays clear.
        pixel_m: Ground sampling distance [m/px].
        count: How many of each at most.
        rng: Draws everything.

    Returns:
        Boxes of the people drawn, shape (M, 4), xyxy [px].
    """
    half = int(np.ceil(_MARGIN_M / pixel_m))
    height, width = image.shape[:2]
    taken = [0.5 * (box[:2] + box[2:]) for box in boxes]
    found: list[NDArray[np.float64]] = []
    for number in range(2 * count):
        middle = rng.uniform(half + 1, np.array([width, height]) - half - 1, 2).astype(int)
        if (middle <= half).any() or any(np.hypot(*(middle - t)) < 1.5 * half for t in taken):
            continue
        x, y = middle
        part = image[y - half : y + half, x - half : x + half]
        person = number % 2 == 0
        shape = draw_person(2 * half, pixel_m, rng) if person else _thing(2 * half, pixel_m, rng)
        hidden = shape * draw_leaves(2 * half, rng)
        if shape.max() <= 0.5 or hidden.sum() < _LEAST_SHOWN * shape.sum():
            continue
        taken.append(middle)
        deviation = float(np.nanmean(np.nanstd(part, axis=(0, 1))))
        if not deviation > 0.0:
            continue
        strength = deviation * np.exp(rng.uniform(np.log(3.0), np.log(14.0)))
        part += strength * hidden[..., None] * _direction(image.shape[2], rng)
        if person:
            rows, columns = np.nonzero(shape > 0.4)
            corners = [columns.min(), rows.min(), columns.max(), rows.max()]
            found.append(np.array(corners, dtype=np.float64) + [x - half, y - half] * 2)
    return np.array(found).reshape(-1, 4)


def smooth_ground(image: Plane, rng: np.random.Generator) -> Plane:
    """Return an image as many leaves out of focus leave it: blurred, and streaked by the flight.

    Args:
        image: Shape (H, W, C), float32; NaN counts as the mean.
        rng: Draws how much.
    """
    flat = np.where(np.isfinite(image), image, np.float32(np.nanmean(image)))
    sigma = float(rng.uniform(1.5, 6.0))
    streak = sigma * float(rng.uniform(1.0, 3.0))
    way = (sigma, streak) if rng.uniform() < 0.5 else (streak, sigma)
    smooth = cv2.GaussianBlur(flat, (0, 0), way[0], sigmaY=way[1]).reshape(image.shape)
    kept = np.float32(rng.uniform(0.0, 0.15))
    return np.asarray(smooth + kept * (flat - smooth), dtype=np.float32)


def _direction(channels: int, rng: np.random.Generator) -> Plane:
    """Return a colour difference of length 1 a channel; warmer than the ground in most."""
    if channels == 1 or rng.uniform() < 0.3:
        return np.full(channels, 1.0 if rng.uniform() < 0.75 else -1.0, dtype=np.float32)
    way = rng.standard_normal(channels)
    return (way * np.sqrt(channels) / np.linalg.norm(way)).astype(np.float32)


def _shrunk(canvas: NDArray[np.uint8], side: int, rng: np.random.Generator) -> Plane:
    small = cv2.resize(canvas, (side, side), interpolation=cv2.INTER_AREA).astype(np.float32)
    sigma = float(np.exp(rng.uniform(np.log(0.4), np.log(2.2))))
    return cv2.GaussianBlur(small / 255.0, (0, 0), sigma).astype(np.float32)


def draw_person(side: int, pixel_m: float, rng: np.random.Generator) -> Plane:
    """Draw a person from above: lying, curled up, or sitting, which is hardly more than a disc."""
    canvas = np.zeros((side * _FINER, side * _FINER), dtype=np.uint8)
    unit = _FINER / pixel_m * float(rng.uniform(0.85, 1.12))
    middle = np.array([0.5 * side * _FINER] * 2)
    heading = rng.uniform(0.0, 2.0 * np.pi)

    def at(angle: float, length: float) -> NDArray[np.float64]:
        return length * np.array([np.cos(heading + angle), np.sin(heading + angle)])

    def limb(start: NDArray[np.float64], end: NDArray[np.float64], thick: float) -> None:
        ends = [tuple(int(v) for v in np.rint(middle + unit * p)) for p in (start, end)]
        cv2.line(canvas, ends[0], ends[1], 255, max(1, round(unit * thick)), cv2.LINE_AA)

    upright = rng.uniform() < 0.2  # trunk and limbs foreshortened
    trunk = float(rng.uniform(0.08, 0.25)) if upright else float(rng.uniform(0.42, 0.55))
    neck, hip = at(0.0, 0.5 * trunk), at(np.pi, 0.5 * trunk)
    limb(neck, hip, float(rng.uniform(0.28, 0.42)))
    limb(neck + at(0.0, 0.12), neck + at(0.0, 0.2), 0.2)
    short = 0.4 if upright else 1.0
    for way in (-1.0, 1.0):
        spread, bend = rng.uniform(0.0, 0.7), rng.uniform(-0.3, 1.4)
        start = hip + at(way * 0.5 * np.pi, 0.1)
        knee = start + at(np.pi - way * spread, 0.42 * short)
        limb(start, knee, 0.17)
        limb(knee, knee + at(np.pi - way * spread + way * bend, 0.42 * short), 0.12)
        lift, fold = rng.uniform(0.2, 2.4), rng.uniform(-1.2, 1.2)
        start = neck + at(way * 0.5 * np.pi, 0.18)
        elbow = start + at(np.pi - way * lift, 0.29 * short)
        limb(start, elbow, 0.11)
        limb(elbow, elbow + at(np.pi - way * (lift + fold), 0.27 * short), 0.09)
    return _shrunk(canvas, side, rng)


def _thing(side: int, pixel_m: float, rng: np.random.Generator) -> Plane:
    """Draw what is no person: a trunk, a small stone, a wide patch."""
    canvas = np.zeros((side * _FINER, side * _FINER), dtype=np.uint8)
    unit = _FINER / pixel_m
    middle = np.array([0.5 * side * _FINER] * 2)
    kind = int(rng.integers(3))
    if kind == 0:
        way = rng.uniform(0.0, np.pi)
        reach = 1.5 * side * _FINER * np.array([np.cos(way), np.sin(way)])
        ends = [tuple(int(v) for v in middle + s * reach) for s in (-1.0, 1.0)]
        thick = max(1, round(unit * float(rng.uniform(0.12, 0.45))))
        cv2.line(canvas, ends[0], ends[1], 255, thick, cv2.LINE_AA)
    else:
        size = rng.uniform(0.06, 0.13) if kind == 1 else rng.uniform(1.0, 1.5)
        axes = tuple(max(1, round(unit * size * float(f))) for f in rng.uniform(0.7, 1.2, 2))
        place = tuple(int(v) for v in middle)
        cv2.ellipse(canvas, place, axes, float(rng.uniform(0, 180)), 0, 360, 255, -1, cv2.LINE_AA)
    return _shrunk(canvas, side, rng)


def draw_leaves(side: int, rng: np.random.Generator) -> Plane:
    """Return how much leaves let through, 0..1, in soft patches."""
    noise = rng.standard_normal((side, side), dtype=np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), float(rng.uniform(1.0, 7.0)))
    noise /= max(float(noise.std()), 1e-6)
    through = 0.5 + 0.5 * noise + np.float32(rng.uniform(-0.3, 1.6))
    return np.clip(through, 0.0, 1.0).astype(np.float32)
