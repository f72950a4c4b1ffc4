"""Photos, masks and poses of the paper's size, made in memory from one seed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera, VirtualCamera

_ORIGINALS = 6
"""Photos that are really drawn; the others are these, shifted and turned over."""


def photos(count: int, side: int, seed: int = 0) -> NDArray[np.uint8]:
    """Return photos of a forest: shape (count, side, side, 3), uint8.

    Light and shade at all scales, greens with some brown, and the noise of a sensor, so that hues
    spread, and files grow, about as those of real photos do.

    Args:
        count: Number of photos.
        side: Side of each [px].
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    images = np.empty((count, side, side, 3), np.uint8)
    for i in range(count):
        if i < _ORIGINALS:
            images[i] = _forest(side, rng)
        else:
            shift = tuple(int(part) for part in rng.integers(0, side, 2))
            images[i] = np.roll(images[i % _ORIGINALS], shift, (0, 1))[:: 1 if i % 2 else -1]
    return images


def _forest(side: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    light = np.full((side, side), 0.9, np.float32)
    brown = np.zeros((side, side), np.float32)
    cell = max(2, side // 8)
    while cell >= 2:
        coarse = -(-side // cell) + 1
        for field, amount in ((light, 0.22), (brown, 0.12)):
            noise = rng.normal(0.0, amount, (coarse, coarse)).astype(np.float32)
            field += cv2.resize(noise, (side, side), interpolation=cv2.INTER_LINEAR)
        cell //= 2
    green, earth = np.array([[70.0, 110.0, 55.0], [105.0, 85.0, 60.0]], np.float32)
    colour = green + np.clip(brown, 0.0, 1.0)[..., None] * (earth - green)
    colour = colour * np.clip(light, 0.1, 2.0)[..., None]
    noise = rng.normal(0.0, 4.0, colour.shape).astype(np.float32)
    return np.asarray((colour + noise).clip(0.0, 255.0), np.uint8)


def masks(count: int, side: int, seed: int = 1) -> NDArray[np.uint8]:
    """Return masks that keep a tenth of the pixels: shape (count, side, side), uint8.

    Args:
        count: Number of masks.
        side: Side of each [px].
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    weights = np.empty((count, side, side), np.uint8)
    for weight in weights:
        weight[:] = (rng.random(weight.shape, np.float32) < 0.1) * 255
    return weights


def lawnmower(
    count: int, side: int, view_side: int | None = None
) -> tuple[Camera, NDArray[np.float64], VirtualCamera]:
    """Return a camera of 90 degrees, poses 20 m up on a grid, and the middle one's view.

    Args:
        count: Number of photos.
        side: Side of each [px].
        view_side: Side of the view [px]; that of the photos if None.
    """
    camera = Camera.from_fov(side, side, 90.0)
    columns = int(np.ceil(np.sqrt(count)))
    pitch = min(1.5, 15.0 / columns)  # so that most photos see most of the view
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for i in range(count):
        poses[i, :3, 3] = [pitch * (i // columns), pitch * (i % columns), -20.0]
    eye = Camera.from_fov(view_side or side, view_side or side, 90.0)
    return camera, poses, VirtualCamera(eye, poses[count // 2])
