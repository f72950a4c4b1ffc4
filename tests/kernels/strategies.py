"""Random images, poses and cameras for the kernel tests."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import strategies as st

from hsvaos import Camera, VirtualCamera

in_vectors_only = pytest.mark.skipif(
    os.environ.get("HSVAOS_PORTABLE") == "1",
    reason="HSVAOS_PORTABLE=1: this is of the CPU's own forms",
)

seeds = st.integers(0, 2**31 - 1)
dtypes = st.sampled_from(["uint8", "uint16", "float32"])


def random_images(seed: int, dtype: str, colour: bool = True, count: int = 2) -> np.ndarray:
    """Noise of random size with some flat, grey and saturated patches, full range of its type."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers(3, 40, 2)
    shape = (count, height, width, 3) if colour else (count, height, width)
    values = rng.random(shape)
    if colour:
        values[:, ::3] = values[:, ::3, :, :1]  # grey
        values[:, 1::5] = np.round(values[:, 1::5])  # corners of the RGB cube
    values[:, 0, 0] = 0.0
    if dtype == "float32":
        return values.astype(np.float32)
    return np.rint(values * np.iinfo(dtype).max).astype(dtype)


def rotation(rng: np.random.Generator, spread: float) -> np.ndarray:
    """Camera looking down, tilted by up to `spread` radians about a random axis, any heading."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = rng.uniform(-spread, spread)
    cross = np.array(
        [[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]], dtype=float
    )
    tilt = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    heading = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ tilt


def random_pose(rng: np.random.Generator, spread: float = 0.3, reach: float = 8.0) -> np.ndarray:
    """Pose about 20 m above down = 0, within `reach` metres of the origin."""
    pose = np.eye(4)
    pose[:3, :3] = rotation(rng, spread)
    pose[:3, 3] = [*rng.uniform(-reach, reach, 2), rng.uniform(-25, -15)]
    return pose


def random_camera(rng: np.random.Generator, width: int, height: int, distorted: bool) -> Camera:
    """Camera of 50 to 90 degrees, off-centre, with moderate distortion if asked for."""
    focal = width / 2 / np.tan(np.radians(rng.uniform(50, 90)) / 2)
    distortion = (0.0,) * 5
    if distorted:
        distortion = tuple(rng.uniform(-1, 1, 5) * (0.15, 0.05, 0.01, 0.01, 0.02))
    return Camera(
        width,
        height,
        focal,
        focal * rng.uniform(0.95, 1.05),
        (width - 1) / 2 + rng.uniform(-3, 3),
        (height - 1) / 2 + rng.uniform(-3, 3),
        distortion,
    )


def random_view(rng: np.random.Generator) -> VirtualCamera:
    """Pinhole view at a random pose, or a ground grid."""
    if rng.random() < 0.3:
        return VirtualCamera.ortho(*rng.uniform(0, 10, 2), rng.uniform(0.2, 1.0), 25, 31)
    return VirtualCamera(random_camera(rng, 31, 23, rng.random() < 0.3), random_pose(rng))
