"""Slow, obvious NumPy twin of `kernels.coherence`; see `reference`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.reference import Array, focal_points, rgb_to_lab, unit
from hsvaos.surface import FocalSurface


def coherence(
    camera: Camera,
    images: ArrayLike,
    world_from_camera: ArrayLike,
    view: VirtualCamera,
    surface: FocalSurface,
    weights: ArrayLike | None = None,
    gains: ArrayLike | None = None,
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Twin of `Integrator.coherence`.

    Args:
        camera: Camera of the photos.
        images: Shape (N, H, W, 3) or (N, H, W).
        world_from_camera: Shape (N, 4, 4).
        view: The virtual camera.
        surface: The focal surface.
        weights: Shape (N, H, W); uint8 (255 = 1), uint16 (65535 = 1) or float.
        gains: Shape (N, 3), factors on the channels of each photo.

    Returns:
        image, shape (H, W, C), and coherence, shape (H, W), float64; and where both are certain:
        no photo is read within 0.01 px of the border of two pixels, no two rays are equally good.
    """
    photos = np.asarray(images)
    factors = np.ones((len(photos), 3)) if gains is None else np.asarray(gains, dtype=np.float64)
    share = np.ones(photos.shape[:3]) if weights is None else unit(weights)
    poses = np.asarray(world_from_camera, dtype=np.float64)
    points = focal_points(view, surface)
    channels = 1 if photos.ndim == 3 else 3
    image = np.zeros((view.height, view.width, channels))
    result = np.zeros((view.height, view.width))
    certain = np.ones((view.height, view.width), dtype=bool)
    for spot in np.ndindex(view.height, view.width):
        rays = []
        for n, pose in enumerate(poses):
            u, v = camera.project(((points[spot] - pose[:3, 3]) @ pose[:3, :3])[None])[0]
            if not np.isfinite([u, v]).all():
                continue
            x, y = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
            away = [abs(c + 0.5 - round(c + 0.5)) for c in (u, v)]
            certain[spot] &= min(away) > 0.01
            if 0 <= x < camera.width and 0 <= y < camera.height:
                rays.append((share[n, y, x], n, y, x))
        seen = sum(weight > 0.0 for weight, *_ in rays)
        heavy = sorted((r for r in rays if r[0] >= 0.02), key=lambda r: -r[0])[:16]
        if not heavy:
            continue
        weight = np.array([r[0] for r in heavy])
        colours = np.array([photos[n, y, x] * factors[n, :channels] for _, n, y, x in heavy])
        colours = colours.reshape(len(heavy), channels)
        white = {"uint8": 255.0, "uint16": 65535.0}.get(photos.dtype.name, 1.0)
        scaled = np.clip(np.repeat(colours, 3 // channels, axis=1) / white, 0.0, 1.0)
        lab = rgb_to_lab(scaled) * [0.5, 1.0, 1.0]
        apart = ((lab[:, None] - lab[None]) ** 2).sum(axis=-1) / 16.0**2
        alike = np.where(apart < 4.0, np.exp(-apart), 0.0)
        score = weight * (alike @ weight)
        ranked = np.sort(score)[::-1]
        certain[spot] &= len(ranked) < 2 or ranked[0] - ranked[1] > 1e-3 * ranked[0]
        certain[spot] &= not (np.abs(apart - 4.0) < 1e-3).any()
        best = int(np.argmax(score))
        own = weight * alike[best]
        image[spot] = (own @ colours) / own.sum()
        result[spot] = np.sqrt(score[best] / seen)
    return image, result, certain
