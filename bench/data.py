"""Pictures and poses for the benchmarks, from one seed."""

from __future__ import annotations

import numpy as np

from hsvaos import Camera, VirtualCamera


def photos(count: int, side: int, seed: int = 0) -> np.ndarray:
    """Shape (count, side, side, 3), uint8: green with noise, as a forest is."""
    rng = np.random.default_rng(seed)
    base = rng.normal((70, 110, 55), 25, (count, side, side, 3))
    return base.clip(0, 255).astype(np.uint8)


def masks(count: int, side: int, seed: int = 1) -> np.ndarray:
    """Shape (count, side, side), uint8: a tenth of the pixels kept."""
    rng = np.random.default_rng(seed)
    return ((rng.random((count, side, side)) < 0.1) * 255).astype(np.uint8)


def lawnmower(count: int, side: int) -> tuple[Camera, np.ndarray, VirtualCamera]:
    """Camera of 90 degrees, poses 20 m up on a grid, and the middle one's view."""
    camera = Camera.from_fov(side, side, 90.0)
    columns = int(np.ceil(np.sqrt(count)))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for i in range(count):
        poses[i, :3, 3] = [1.5 * (i // columns), 1.5 * (i % columns), -20.0]
    return camera, poses, VirtualCamera(camera, poses[count // 2])
