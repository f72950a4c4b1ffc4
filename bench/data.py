"""Pictures and poses for the benchmarks, from one seed."""

from __future__ import annotations

import numpy as np

from hsvaos import Camera, VirtualCamera


def photos(count: int, side: int, seed: int = 0) -> np.ndarray:
    """Shape (count, side, side, 3), uint8: green with noise, as a forest is."""
    rng = np.random.default_rng(seed)
    images = np.empty((count, side, side, 3), np.uint8)
    for image in images:
        image[:] = rng.normal((70, 110, 55), 25, image.shape).clip(0, 255)
    return images


def masks(count: int, side: int, seed: int = 1) -> np.ndarray:
    """Shape (count, side, side), uint8: a tenth of the pixels kept."""
    rng = np.random.default_rng(seed)
    weights = np.empty((count, side, side), np.uint8)
    for weight in weights:
        weight[:] = (rng.random(weight.shape) < 0.1) * 255
    return weights


def lawnmower(
    count: int, side: int, view_side: int | None = None
) -> tuple[Camera, np.ndarray, VirtualCamera]:
    """Camera of 90 degrees, poses 20 m up on a grid, and the middle one's view of any size."""
    camera = Camera.from_fov(side, side, 90.0)
    columns = int(np.ceil(np.sqrt(count)))
    pitch = min(1.5, 15.0 / columns)  # so that most photos see most of the view
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for i in range(count):
        poses[i, :3, 3] = [pitch * (i // columns), pitch * (i % columns), -20.0]
    eye = Camera.from_fov(view_side or side, view_side or side, 90.0)
    return camera, poses, VirtualCamera(eye, poses[count // 2])
