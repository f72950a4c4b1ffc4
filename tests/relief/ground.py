"""Photos of a textured ground of known heights, some of them hidden by noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import warp as wp

from hsvaos import Camera, FocalTerrain, Frame, VirtualCamera
from hsvaos.flight import Flight
from hsvaos.kernels.rays import focal_points
from hsvaos.photos import Photos

SIDE = 192
HEIGHT_M = 20.0


def waves(slope: float = 0.0) -> FocalTerrain:
    """Ground that undulates by .3 m, and falls towards the north by a slope."""
    axis = np.arange(-45.0, 45.1, 0.5)
    down = 0.3 * np.sin(axis / 4.0)[:, None] * np.cos(axis / 5.0) + slope * axis[:, None]
    return FocalTerrain.from_arrays(axis, axis, down)


def down_at(terrain: FocalTerrain, north: np.ndarray, east: np.ndarray) -> np.ndarray:
    """Down of the nearest nodes."""
    rows = np.rint((north - terrain.north0_m) / terrain.spacing_m).astype(int)
    columns = np.rint((east - terrain.east0_m) / terrain.spacing_m).astype(int)
    return terrain.down_m[rows, columns]


def flown(
    terrain: FocalTerrain, *, hidden: float = 0.0, texture: bool = True, pitch_deg: float = 0.0
) -> tuple[Photos, np.ndarray]:
    """Photos from a lawnmower pattern, and what of them is ground, 255 or 0.

    Args:
        terrain: The ground.
        hidden: Share of every photo that blocks of noise hide.
        texture: Whether the ground has one; else every photo is noise of its own.
        pitch_deg: Tilt of all photos towards the north.
    """
    rng = np.random.default_rng(8)
    paint = rng.integers(40, 210, (900, 900, 3)).astype(np.uint8)
    camera = Camera.from_fov(SIDE, SIDE, 80.0)
    turn = np.radians(pitch_deg)
    looks = np.array(  # camera axes in NED: right = east, down the picture = south
        [[0.0, -np.cos(turn), np.sin(turn)], [1.0, 0.0, 0.0], [0.0, np.sin(turn), np.cos(turn)]]
    )
    images, grounds, poses = [], [], []
    for north in (-7.0, 0.0, 7.0):
        for east in np.linspace(-9.0, 9.0, 7):
            pose = np.eye(4)
            pose[:3, :3] = looks
            pose[:3, 3] = north, east, -HEIGHT_M
            hits = focal_points(VirtualCamera(camera, pose), terrain).numpy()
            places = hits[:, :3] + pose[:3, 3]
            at = np.clip(np.rint((places[:, :2] + 45.0) / 0.1), 0, 899).astype(int)
            image = paint[at[:, 0], at[:, 1]].reshape(SIDE, SIDE, 3)
            noise = rng.integers(0, 255, image.shape).astype(np.uint8)
            blocks = np.kron(rng.uniform(size=(12, 12)) < hidden, np.ones((16, 16), bool))
            images.append(np.where(blocks[..., None] | (not texture), noise, image))
            grounds.append(np.where(blocks, 0, 255).astype(np.uint8))
            poses.append(pose)
    frames = tuple(Frame(f"{k}", Path(), pose) for k, pose in enumerate(poses))
    flight = Flight("drawn", camera, frames)
    held = wp.array(np.stack(images), dtype=wp.uint8, device="cpu")
    return Photos(flight, held, None, ()), np.stack(grounds)
