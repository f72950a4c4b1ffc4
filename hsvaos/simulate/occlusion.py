"""How much of the ground, and of people, the photos see."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.kernels.device import threads
from hsvaos.simulate.buffers import depths, instance_numbers, ray_table
from hsvaos.simulate.instances import Kind
from hsvaos.simulate.scene import Scene

Array = NDArray[np.float64]

CLASSES: dict[str, tuple[float, float]] = {
    "full": (0.0, 0.10),
    "half": (0.25, 0.75),
    "bush": (0.0, 0.60),
    "open": (0.85, 1.0),
}
"""Occlusion classes: range of the mean visible fraction of the person's pixels."""

LEAST_PIXELS = 12
"""Photos in which a person would have fewer pixels do not count."""
_ABOVE_GROUND_M = 0.45


def label(visible: float, under_bush: bool) -> str:
    """Return the occlusion class of a measured mean visible fraction.

    Between the ranges of "full" and "open", everything counts as "half".
    """
    if under_bush and visible <= CLASSES["bush"][1]:
        return "bush"
    if visible <= CLASSES["full"][1]:
        return "full"
    return "open" if visible >= CLASSES["open"][0] else "half"


@dataclass(frozen=True, eq=False)
class VisibilityMap:
    """Share of the photos' pixels on each piece of ground that really show it.

    Args:
        half_m: The map covers [-half_m, half_m] both ways [m].
        cell_m: Side of a cell [m].
        visible: Shape (n, n), share seen, rows to the north; NaN where no photo looks.
    """

    half_m: float
    cell_m: float
    visible: Array

    @property
    def mean(self) -> float:
        """Mean over the map."""
        return float(np.nanmean(self.visible))


def _workers(device: str) -> int:
    return min(threads(), 4) if str(device) == "cpu" else 1


def visibility_map(
    scene: Scene, camera: Camera, poses: Array, half_m: float, cell_m: float = 0.25
) -> VisibilityMap:
    """Measure which ground the photos see, from their key buffers at low resolution.

    Args:
        scene: The forest.
        camera: Of the photos; it is scaled to 256 pixels.
        poses: Shape (N, 4, 4), world_from_camera.
        half_m: Half the side of the square to map [m].
        cell_m: Side of a cell [m].
    """
    small = camera.scaled(256, max(round(256 * camera.height / camera.width), 1))
    rays = ray_table(small, scene.device)
    lines = np.concatenate([rays.numpy(), np.ones((rays.shape[0], 1))], axis=1)
    side = int(np.ceil(2.0 * half_m / cell_m))

    def one(pose: Array) -> tuple[Array, Array]:
        depth = depths(scene.keys(small, pose, rays), small).reshape(-1)
        way = lines @ pose[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            to_ground = -pose[2, 3] / way[:, 2]
        place = pose[:2, 3] + way[:, :2] * to_ground[:, None]
        cell = np.floor((place + half_m) / cell_m).astype(np.int64)
        inside = (to_ground > 0.0) & (cell >= 0).all(axis=1) & (cell < side).all(axis=1)
        # What is hit more than knee-high above the ground hides it.
        hit = pose[:3, 3] + way * np.nan_to_num(depth, nan=1e3)[:, None]
        above = scene.ground.down_at(hit[:, 0], hit[:, 1]) - hit[:, 2]
        seen = above < _ABOVE_GROUND_M
        index = cell[:, 0] * side + cell[:, 1]
        return (
            np.bincount(index[inside], minlength=side * side).astype(np.float64),
            np.bincount(index[inside & seen], minlength=side * side).astype(np.float64),
        )

    total, visible = np.zeros(side * side), np.zeros(side * side)
    with ThreadPoolExecutor(_workers(scene.device)) as pool:
        for all_pixels, seen_pixels in pool.map(one, poses):
            total += all_pixels
            visible += seen_pixels
    with np.errstate(divide="ignore", invalid="ignore"):
        share = visible / total
    return VisibilityMap(half_m, cell_m, share.reshape(side, side))


def closure(scene: Scene, half_m: float, cell_m: float = 0.2) -> float:
    """Return the canopy closure: share of the plan view covered by trees above 2 m.

    Args:
        scene: The forest.
        half_m: Half the side of the square to look at [m].
        cell_m: Side of a cell [m].
    """
    side = int(np.ceil(2.0 * half_m / cell_m))
    frame = np.array(
        [
            [0.0, 1.0 / cell_m, 0.0, side / 2],
            [1.0 / cell_m, 0.0, 0.0, side / 2],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    depth = scene.depth_map(frame, side, side, kinds=[int(Kind.TREE)]).numpy()
    return float(np.mean(depth < -2.0))


def person_pixels(
    scene: Scene, camera: Camera, pose: Array, rays: object, keys: object, people: Sequence[int]
) -> list[tuple[int, int]]:
    """Count the pixels of people in one photo.

    Args:
        scene: With the people in it.
        camera: Of the photo.
        pose: Shape (4, 4), world_from_camera.
        rays: From `ray_table`.
        keys: Key buffer of the photo.
        people: Instance number of each person.

    Returns:
        For each person (pixels that show it, pixels that would without anything else).
    """
    shown = np.bincount(
        instance_numbers(keys, camera).reshape(-1) + 1, minlength=len(scene.kind) + 1
    )
    alone_keys = scene.keys(camera, pose, rays, only=list(people))
    alone = np.bincount(
        instance_numbers(alone_keys, camera).reshape(-1) + 1, minlength=len(scene.kind) + 1
    )
    return [(int(shown[k + 1]), int(alone[k + 1])) for k in people]


def mean_fraction(counts: Sequence[tuple[int, int]], least: int = LEAST_PIXELS) -> float | None:
    """Return the mean over photos of shown / alone, for photos with at least `least` pixels."""
    shares = [shown / alone for shown, alone in counts if alone >= least]
    return float(np.mean(shares)) if shares else None


def measure_people(
    scene: Scene,
    camera: Camera,
    poses: Array,
    people: Sequence[int],
    points: Sequence[Array],
) -> list[float | None]:
    """Return the mean visible fraction of each person over the photos, exactly as they will show.

    Only the part of each photo around the person is drawn, with the photo's own pixels, so the
    result is that of the whole photos at a fraction of their cost.

    Args:
        scene: With the people in it.
        camera: Of the photos.
        poses: Shape (N, 4, 4), world_from_camera.
        people: Instance number of each person.
        points: Points of each body, shape (K, 3), world NED [m].
    """

    def one(k: int) -> float | None:
        counts = []
        for pose in poses:
            pixels = camera.project((points[k] - pose[:3, 3]) @ pose[:3, :3])
            part = _part_around(camera, pixels)
            if part is not None:
                rays = ray_table(part, scene.device)
                keys = scene.keys(part, pose, rays)
                counts += person_pixels(scene, part, pose, rays, keys, [people[k]])
        return mean_fraction(counts)

    with ThreadPoolExecutor(_workers(scene.device)) as pool:
        return list(pool.map(one, range(len(people))))


def _part_around(camera: Camera, pixels: Array, margin: int = 3) -> Camera | None:
    """Return the camera of the part of a photo around some pixels; None if it shows none."""
    if not np.isfinite(pixels).any():
        return None
    size = np.array([camera.width, camera.height])
    low = np.maximum(np.floor(np.nanmin(pixels, axis=0)).astype(int) - margin, 0)
    high = np.minimum(np.ceil(np.nanmax(pixels, axis=0)).astype(int) + margin + 1, size)
    if (high <= low).any():
        return None
    width, height = (high - low).tolist()
    x, y = low.tolist()
    return replace(camera, width=width, height=height, cx=camera.cx - x, cy=camera.cy - y)


def smooth(chart: VisibilityMap, sigma_m: float) -> Array:
    """Return the map averaged over about the size of a person; NaN cells count as seen."""
    filled = np.where(np.isnan(chart.visible), 1.0, chart.visible)
    return np.asarray(
        cv2.GaussianBlur(filled, (0, 0), sigma_m / chart.cell_m, borderType=cv2.BORDER_REFLECT)
    )
