"""One integral image against the NumPy twin and OpenCV's warpPerspective."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from bench.data import lawnmower, masks, photos
from bench.harness import Contenders, size
from hsvaos import FocalPlane, Integrator, reference

FRAMES = 12


def integral() -> Contenders:
    side = size(1024)
    camera, poses, view = lawnmower(FRAMES, side)
    images, weights = photos(FRAMES, side), masks(FRAMES, side)
    integrator = Integrator(camera, images, poses, weights)
    out = (np.empty((side, side, 3), np.float32), np.empty((side, side), np.float32))
    surface = FocalPlane(0.0)
    homographies = [plane_homography(camera.matrix(), view, pose) for pose in poses]
    premultiplied = [
        np.dstack([image * (weight[..., None] > 0), weight])
        for image, weight in zip(images, weights, strict=True)
    ]

    def opencv() -> None:
        total = np.zeros((side, side, 4), np.float32)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        for picture, homography in zip(premultiplied, homographies, strict=True):
            warped = cv2.warpPerspective(picture, homography, (side, side), flags=flags)
            cv2.accumulate(warped, total)
        total[..., :3] /= np.maximum(total[..., 3:] / 255.0, 1e-6)

    return {
        "hsvaos kernel": lambda: integrator.integrate(view, surface, out=out),
        "NumPy twin": lambda: reference.integrate(camera, images, poses, view, surface, weights),
        "OpenCV warpPerspective + accumulate": opencv,
    }


def plane_homography(matrix: np.ndarray, view: Any, pose: np.ndarray) -> np.ndarray:
    """Pixels of a photo for pixels of the view, over the plane down = 0."""

    def image_from_plane(world_from_camera: np.ndarray) -> np.ndarray:
        rotation = world_from_camera[:3, :3].T
        shift = rotation @ -world_from_camera[:3, 3]
        return matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], shift])

    return image_from_plane(pose) @ np.linalg.inv(image_from_plane(view.world_from_camera))


RACES = {f"integral image, {FRAMES} RGB photos with masks": integral}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic(RACES[contender[0]]()[contender[1]], rounds=3, warmup_rounds=1)
