"""What goes into and comes out of a key buffer: rays, instance numbers, depths."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.kernels import raster


def instance_numbers(keys: Any, camera: Camera) -> NDArray[np.int32]:
    """Return the instance each pixel shows, shape (H, W), int32; -1 for none."""
    key = keys.numpy().reshape(camera.height, camera.width)
    number = (key & np.uint64(0xFFFFFFFF)) >> np.uint64(raster.PATCH_BITS)
    return np.asarray(np.where(key == raster.EMPTY, -1, number.astype(np.int64)), dtype=np.int32)


def depths(keys: Any, camera: Camera) -> NDArray[np.float32]:
    """Return the depth of each pixel along the optical axis, shape (H, W) [m]; NaN for none."""
    key = keys.numpy().reshape(camera.height, camera.width)
    depth = (key >> np.uint64(32)).astype(np.uint32).view(np.float32)
    return np.asarray(np.where(key == raster.EMPTY, np.nan, depth), dtype=np.float32)


def ray_table(camera: Camera, device: str = "cpu") -> Any:
    """Return the rays through all pixels for `Scene.keys`: wp.array of vec2, shape (H W,).

    Raises:
        ValueError: If the lens model gives some pixel no ray.
    """
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.back_project(np.stack([columns, rows], axis=-1))[..., :2]
    if not np.isfinite(rays).all():
        raise ValueError("the distortion of the camera leaves pixels without a ray")
    return wp.array(rays.reshape(-1, 2).astype(np.float32), dtype=wp.vec2, device=device)
