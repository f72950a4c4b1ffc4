"""Where a view meets the ground, for maps and for laying a photo over a view."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Matrix, VirtualCamera
from hsvaos.report.figures import Float, Rgba, covered
from hsvaos.result import Result
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain

_TERRAIN_STEPS = 30
"""Steps of the fixed-point search on a terrain; slopes below 45 degrees seen from above converge
to centimetres, which is all a picture needs."""

_CHUNK_ROWS = 256
"""Rows laid over at once, so that double precision rays of large views do not fill the memory."""


def surface_down(surface: FocalSurface) -> float:
    """Return a typical down of a focal surface, world NED [m]."""
    if isinstance(surface, FocalPlane):
        return float(surface.point[2])
    return float(np.nanmedian(surface.down_m))


def ground_points(view: VirtualCamera, pixels: NDArray[Any], surface: FocalSurface) -> Matrix:
    """Return where the rays of pixels meet the focal surface, for drawing.

    Args:
        view: The virtual camera.
        pixels: Shape (..., 2) [px].
        surface: The focal surface.

    Returns:
        Shape (..., 3), world NED [m]; NaN where a ray does not meet it.
    """
    origins, directions = view.rays(pixels)
    if isinstance(surface, FocalPlane):
        return _meet_plane(origins, directions, surface.point, surface.normal)
    up = np.array([0.0, 0.0, 1.0])
    points = _meet_plane(origins, directions, np.array([0.0, 0.0, surface_down(surface)]), up)
    for _ in range(_TERRAIN_STEPS):
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (_terrain_down(surface, points) - origins[..., 2]) / directions[..., 2]
        points = origins + reach[..., None] * directions
    return points


def _meet_plane(origins: Matrix, directions: Matrix, point: Matrix, normal: Matrix) -> Matrix:
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = ((point - origins) @ normal) / (directions @ normal)
        # Parallel rays of a ground grid start anywhere; only those of a camera have a behind.
        reach = np.where(np.isfinite(reach), reach, np.nan)
    return np.asarray(origins + reach[..., None] * directions)


def _terrain_down(terrain: FocalTerrain, points: Matrix) -> Matrix:
    """Look up a terrain at points; outside it the nearest edge counts."""
    rows, columns = terrain.down_m.shape
    at = np.nan_to_num(
        (points[..., :2] - (terrain.north0_m, terrain.east0_m)) / terrain.spacing_m, nan=0.0
    )
    at = np.clip(at, 0.0, (rows - 1.0, columns - 1.0))
    low = np.minimum(at.astype(np.int64), (rows - 2, columns - 2))
    (r, c), (fr, fc) = np.moveaxis(low, -1, 0), np.moveaxis(at - low, -1, 0)
    down = terrain.down_m
    south = down[r, c] * (1 - fc) + down[r, c + 1] * fc
    north = down[r + 1, c] * (1 - fc) + down[r + 1, c + 1] * fc
    return np.asarray(south * (1 - fr) + north * fr, dtype=np.float64)


def covered_outline(view: VirtualCamera, footprint: Float, surface: FocalSurface) -> list[Matrix]:
    """Return the outlines of the covered part of a view on the ground.

    Args:
        view: The virtual camera.
        footprint: Shape (H, W), sum of weights.
        surface: The focal surface.

    Returns:
        Polygons, each shape (K, 2), north and east [m]; the largest few.
    """
    inside = covered(footprint).astype(np.uint8)
    # A mask leaves pinholes by the thousand; the outline is that of the area, not of the holes.
    side = max(3, max(inside.shape) // 100) | 1
    closed = cv2.morphologyEx(inside, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    outlines = []
    for contour in sorted(contours, key=cv2.contourArea, reverse=True)[:5]:
        corners = cv2.approxPolyDP(contour, side / 2, True)[:, 0].astype(np.float64)
        ground = ground_points(view, corners, surface)[:, :2]
        ground = ground[np.isfinite(ground).all(axis=1)]
        if len(ground) >= 3:
            outlines.append(ground)
    return outlines


def photo_in_view(result: Result, picture: Rgba, longest: int) -> Rgba | None:
    """Lay the single photo over the main view, so that the two can be compared pixel by pixel.

    Args:
        result: The run.
        picture: Shape (H, W, 4), the photo for display, of the camera's size.
        longest: Longest side of the outcome [px].

    Returns:
        Shape (h, w, 4) with the proportions of the main view, transparent where the photo does not
        reach; None if the photo's pose is not known.
    """
    frames = [f for f in result.flight.frames if f.name == result.photo_frame]
    if not frames or frames[0].world_from_camera is None:
        return None
    pose, camera, view = frames[0].world_from_camera, result.flight.camera, result.main.view
    scale = min(1.0, longest / max(view.size))
    width, height = (max(1, round(side * scale)) for side in view.size)
    maps = np.full((height, width, 2), -1e6, np.float32)
    columns = (np.arange(width) + 0.5) * view.width / width - 0.5
    for top in range(0, height, _CHUNK_ROWS):
        rows = (np.arange(top, min(height, top + _CHUNK_ROWS)) + 0.5) * view.height / height - 0.5
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
        if not view.is_ortho and np.allclose(view.world_from_camera, pose, atol=1e-9):
            points = np.add(*view.rays(pixels))  # same place: any depth gives the same pixel
        else:
            points = ground_points(view, pixels, result.surface)
        there = camera.project((points - pose[:3, 3]) @ pose[:3, :3])
        maps[top : top + len(rows)] = np.nan_to_num(there, nan=-1e6)
    step = 1.0 / scale
    source: Any = picture
    if step > 1.5:  # shrink first: sampling every n-th pixel would sparkle
        side = round(step) | 1  # an even box would shift the photo by half a pixel
        source = cv2.blur(picture, (side, side))
    laid = cv2.remap(
        source, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderValue=(0.0, 0.0, 0.0, 0.0)
    )
    return np.asarray(laid, dtype=np.uint8)
