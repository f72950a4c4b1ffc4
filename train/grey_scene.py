"""Lone grey integral images, drawn: what averaged thermal photos of a forest show.

Crowns out of focus are a sharp canopy seen from all places of the path, so a canopy is convolved
with the points of a path. On it lie warm (or cold) people, blurred by wrong poses and patched by
leaves, and things that are none. Nobody tells the sampling of such an image: people are 12 to 48
pixels long.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from train.drawn import draw_leaves, draw_person

Plane = NDArray[np.float32]

SIDE_PX = 448
LENGTH_PX = (12.0, 48.0)
"""Lengths of people lying stretched out."""

PERSON_M = 1.75

_MOST_PEOPLE = 8
_LEAST_SHOWN = 0.25
_CONTRAST = (2.5, 40.0)
"""Of people and things, in deviations of what surrounds them, slopes and steps aside."""


@dataclass(frozen=True)
class GreyScene:
    """A drawn image.

    Args:
        image: Shape (H, W), float32; NaN where nothing is seen.
        boxes: Shape (K, 4), xyxy [px], the people.
    """

    image: Plane
    boxes: NDArray[np.float64]


def grey_scene(rng: np.random.Generator) -> GreyScene:
    """Draw an image.

    Args:
        rng: Draws everything.
    """
    image = _background(rng)
    sparse = np.zeros(image.shape, dtype=np.bool_)
    if rng.uniform() < 0.5:  # seen by a photo or two: crowns stand there sharp
        sparse = _half_plane(rng, 0.35) | (_half_plane(rng, 0.4) & (rng.uniform() < 0.5))
        image[sparse] = (_averaged(_canopy(rng), int(rng.integers(1, 4)), rng))[sparse]
    for _ in range(int(rng.integers(0, 4))):
        image[_half_plane(rng, 0.2)] += np.float32(rng.normal(0.0, 0.4) * image.std())
    hidden = np.zeros(image.shape, dtype=np.bool_)
    for _ in range(int(rng.choice([0, 0, 0, 1, 2]))):
        hidden |= _half_plane(rng, 0.3)
    boxes = _populate(image, sparse | hidden, rng)
    if rng.uniform() < 0.3:  # as 8-bit pictures keep it, bright things cut off
        low, high = np.percentile(image, [rng.uniform(0.0, 2.0), rng.uniform(99.0, 100.0)])
        image = np.clip(np.rint(255.0 * (image - low) / max(high - low, 1e-6)), 0.0, 255.0)
        image = image.astype(np.float32)
    if rng.uniform() < 0.15:
        image = -image
    image[hidden] = np.nan if rng.uniform() < 0.6 else 0.0
    return GreyScene(image, boxes)


def _populate(
    image: Plane, barred: NDArray[np.bool_], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw people and things into an image in place; returns the people's boxes."""
    length = float(np.exp(rng.uniform(*np.log(LENGTH_PX))))
    half = int(np.ceil(1.1 * length))
    count = 0 if rng.uniform() < 0.15 else int(rng.integers(1, _MOST_PEOPLE + 1))
    kinds = [True] * count + [False] * int(rng.integers(0, 9))
    warm = 1.0 if rng.uniform() < 0.85 else -1.0
    found: list[NDArray[np.float64]] = []
    taken: list[NDArray[np.int64]] = []
    for person in kinds:
        reach = half if person else 60
        middle = rng.integers(reach + 1, SIDE_PX - reach - 1, 2)
        if any(np.hypot(*(middle - other)) < 2.6 * half for other in taken):
            continue
        x, y = middle
        where = (slice(y - reach, y + reach), slice(x - reach, x + reach))
        part = image[where]
        if person and barred[y - half // 2 : y + half // 2, x - half // 2 : x + half // 2].any():
            continue
        shape = _person(half, length, rng) if person else _thing(2 * reach, rng)
        around = image[max(0, y - 64) : y + 65, max(0, x - 64) : x + 65]
        smooth = cv2.GaussianBlur(around, (0, 0), max(length, 8.0))
        deviation = float(np.std(around - smooth))
        if shape is None or not deviation > 0.0:
            continue
        taken.append(middle)
        sign = warm if person or rng.uniform() < 0.5 else -warm
        part += np.float32(sign * deviation * np.exp(rng.uniform(*np.log(_CONTRAST)))) * shape
        if person:
            rows, columns = np.nonzero(shape > 0.35 * shape.max())
            corners = [columns.min(), rows.min(), columns.max(), rows.max()]
            found.append(np.array(corners, dtype=np.float64) + [x - half, y - half] * 2)
    return np.array(found).reshape(-1, 4)


def _person(half: int, length: float, rng: np.random.Generator) -> Plane | None:
    """Draw a person as rays of wrong poses through leaves show them; None if hardly shown."""
    pixel_m = PERSON_M / length
    shape = draw_person(2 * half, pixel_m, rng)
    if rng.uniform() < 0.6:  # the photos do not agree where
        spread = rng.uniform(0.0, 0.3) / pixel_m
        moves = rng.normal(0.0, spread, (int(rng.integers(2, 7)), 2))
        moves *= rng.uniform(0.0, 1.0, 2)
        copies = [
            cv2.warpAffine(shape, np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]]), shape.shape)
            for dx, dy in moves
        ]
        shape = np.mean(copies, axis=0, dtype=np.float32)
    blur = rng.uniform(0.0, 0.2) / pixel_m
    if blur > 0.3:
        shape = cv2.GaussianBlur(shape, (0, 0), float(blur)).astype(np.float32)
    shown = shape * draw_leaves(2 * half, rng)
    if shown.sum() < _LEAST_SHOWN * shape.sum() or not shown.max() > 0.05:
        return None
    return np.asarray(shown / shown.max(), dtype=np.float32)


def _thing(side: int, rng: np.random.Generator) -> Plane | None:
    """Draw what is smaller or larger than any person: a dot, a wide patch, a long line."""
    canvas = np.zeros((side, side), dtype=np.float32)
    middle = np.array([0.5 * side, 0.5 * side])
    kind = int(rng.integers(3))
    if kind == 0:
        cv2.circle(canvas, (side // 2, side // 2), int(rng.integers(0, 2)), 1.0, -1)
        return cv2.GaussianBlur(canvas, (0, 0), float(rng.uniform(0.4, 0.9))).astype(np.float32)
    if kind == 1:
        axes = rng.uniform(38.0, 58.0, 2).astype(int).tolist()
        turn = float(rng.uniform(0.0, 180.0))
        cv2.ellipse(canvas, (side // 2, side // 2), axes, turn, 0.0, 360.0, 1.0, -1)
        return cv2.GaussianBlur(canvas, (0, 0), float(rng.uniform(1.0, 5.0))).astype(np.float32)
    angle = rng.uniform(0.0, np.pi)
    reach = side * np.array([np.cos(angle), np.sin(angle)])
    ends = [tuple(int(v) for v in middle + sign * reach) for sign in (-1.0, 1.0)]
    cv2.line(canvas, ends[0], ends[1], 1.0, int(rng.integers(1, 10)), cv2.LINE_AA)
    return cv2.GaussianBlur(canvas, (0, 0), float(rng.uniform(0.5, 2.5))).astype(np.float32)


def _background(rng: np.random.Generator) -> Plane:
    """Draw the forest as many photos average it, the ground between, and a camera's faults."""
    rays = int(np.exp(rng.uniform(np.log(4.0), np.log(300.0))))
    image = _averaged(_canopy(rng), rays, rng)
    ground = _octaves(rng, float(rng.uniform(-0.3, 0.8)))
    if rng.uniform() < 0.7:
        ground = cv2.GaussianBlur(ground, (0, 0), float(rng.uniform(0.5, 6.0))).astype(np.float32)
    image += np.float32(np.exp(rng.uniform(np.log(0.01), np.log(0.4)))) * ground
    image += np.float32(rng.uniform(0.0, 0.6)) * _octaves(rng, 1.5)  # warm slopes, vignettes
    level = max(float(image.std()), 1e-3)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    image += np.float32(level * rng.uniform(0.0, 0.15)) * noise
    if rng.uniform() < 0.3:
        stripes = cv2.GaussianBlur(rng.standard_normal((SIDE_PX, 1), dtype=np.float32), (1, 5), 1.0)
        stripes = np.float32(level * rng.uniform(0.0, 0.3)) * stripes
        image += stripes if rng.uniform() < 0.5 else stripes.T
    return image


def _canopy(rng: np.random.Generator) -> Plane:
    """Draw crowns from above, sharp: deviation 1."""
    image = _octaves(rng, float(rng.uniform(-0.2, 0.9)))
    for _ in range(int(rng.integers(0, 60))):
        place = tuple(int(v) for v in rng.integers(0, SIDE_PX, 2))
        axes = tuple(int(v) for v in np.exp(rng.uniform(np.log(3.0), np.log(40.0), 2)))
        bright = float(rng.normal(0.0, 1.5))
        cv2.ellipse(image, place, axes, float(rng.uniform(0, 180)), 0, 360, bright, -1)
    image += 0.5 * _octaves(rng, -0.3)
    image -= image.mean()
    return np.asarray(image / max(float(image.std()), 1e-6), dtype=np.float32)


def _averaged(canopy: Plane, rays: int, rng: np.random.Generator) -> Plane:
    """Average a canopy over a path: a line, or an area flown over in strips."""
    reach = float(np.exp(rng.uniform(np.log(8.0), np.log(160.0))))
    along, across = rng.uniform(-reach, reach, rays), rng.normal(0.0, 0.03 * reach, rays)
    if rng.uniform() < 0.5:
        across += rng.integers(-3, 4, rays) * reach / 3.0
    angle = rng.uniform(0.0, np.pi)
    x = along * np.cos(angle) - across * np.sin(angle)
    y = along * np.sin(angle) + across * np.cos(angle)
    kernel = np.zeros(canopy.shape, dtype=np.float32)
    np.add.at(kernel, (np.rint(y).astype(int) % SIDE_PX, np.rint(x).astype(int) % SIDE_PX), 1.0)
    spectrum = np.fft.rfft2(canopy) * np.fft.rfft2(kernel / rays)
    return np.fft.irfft2(spectrum, canopy.shape).astype(np.float32)


def _octaves(rng: np.random.Generator, steepness: float) -> Plane:
    """Draw noise of all sizes, deviation 1; the steeper the smoother."""
    total = np.zeros((SIDE_PX, SIDE_PX), dtype=np.float32)
    cell = SIDE_PX // 2
    while cell >= 1:
        count = -(-SIDE_PX // cell) + 1
        coarse = rng.standard_normal((count, count), dtype=np.float32)
        fine = cv2.resize(coarse, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_CUBIC)
        total += np.float32(cell**steepness) * fine
        cell //= 2
    return np.asarray(total / max(float(total.std()), 1e-6), dtype=np.float32)


def _half_plane(rng: np.random.Generator, most: float) -> NDArray[np.bool_]:
    """Draw what lies beyond a straight line: at most about a share of the picture."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    rows, columns = np.mgrid[0:SIDE_PX, 0:SIDE_PX].astype(np.float32)
    away = columns * np.float32(np.cos(angle)) + rows * np.float32(np.sin(angle))
    return np.asarray(away > np.quantile(away[::16, ::16], 1.0 - rng.uniform(0.02, most)))
