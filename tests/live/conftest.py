from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from hsvaos import Camera, FocalPlane, VirtualCamera
from tests.kernels.test_integrate import looking_down


@dataclass(frozen=True, eq=False)
class Strip:
    """Photos along a strip, and what looks at them."""

    camera: Camera
    images: np.ndarray
    poses: np.ndarray
    view: VirtualCamera
    surface: FocalPlane


@pytest.fixture(scope="session")
def strip() -> Strip:
    rng = np.random.default_rng(3)
    camera = Camera.from_fov(96, 72, 70.0)
    images = rng.integers(0, 256, (12, 72, 96, 3), dtype=np.uint8)
    poses = np.stack([looking_down(0.4 * i, 0.2 * i, 20.0) for i in range(12)])
    eye = Camera.from_fov(64, 48, 60.0)
    return Strip(camera, images, poses, VirtualCamera(eye, poses[5]), FocalPlane(0.0))
