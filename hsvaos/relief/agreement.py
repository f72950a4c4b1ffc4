"""How well the rays of the ground agree at places and depths: the semblance of a plane sweep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.kernels.integrate import Integrator
from hsvaos.photos import Photos, Progress, resized
from hsvaos.relief.contrast import MOST, ground_contrast
from hsvaos.surface import FocalPlane

CELL = 4
"""Points of the grid along the side of a cell."""

_LONGEST_PX = 512
"""Photos are shrunk to this side: finer ones only cost time."""

_MOST_PX = 100_000_000
"""Pixels of all photos together, to which they are shrunk further."""

_AT_ONCE = 9
"""Planes of a sweep: more would only take memory."""

_WORDS = 65535.0


@dataclass(frozen=True, eq=False)
class Agreement:
    """Agreement of ground rays in cells of a ground grid, over offsets from a focal plane.

    With rays i of weights w and contrasts c, W = sum w, m = sum w c / W, q = sum w c^2 / W and
    s = 1 - 1 / W at a point: `agreed` is the mean over a cell's points of s (W m^2 - q), which for
    n alike rays is s / n sum_i sum_(j != i) c_i c_j, what pairs of rays have in common; `power`
    that of s (W - 1) q, what they could have in common (agreed / power is the semblance without
    each ray's own share, after Neidell and Taner 1971); and `chance` that of 2 s (s q)^2, the
    variance of `agreed` at one point where nothing agrees.

    Args:
        offsets_m: Shape (D,), evenly spaced, downwards from the plane [m].
        agreed: Shape (D, H, W).
        power: Shape (D, H, W).
        chance: Shape (H, W).
        cell_m: Side of a cell [m].
    """

    offsets_m: NDArray[np.float64]
    agreed: NDArray[np.float32]
    power: NDArray[np.float32]
    chance: NDArray[np.float32]
    cell_m: float


def measure_agreement(
    photos: Photos,
    ground: NDArray[np.uint8],
    gains: NDArray[np.float64] | None,
    grid: VirtualCamera,
    planes: list[FocalPlane],
    offsets_m: NDArray[np.float64],
    progress: Progress | None = None,
) -> Agreement:
    """Measure agreement on parallel planes.

    Args:
        photos: RGB photos.
        ground: Shape (N, h, w), how likely pixels show the ground, 255 = surely.
        gains: Shape (N, 3), factors that level the photos; None for none.
        grid: Ground grid, whose sides are whole numbers of cells.
        planes: The planes.
        offsets_m: Shape (D,), how much lower than the focal plane each is [m].
        progress: Told of photos and planes.
    """
    sums = _moments(photos, ground, gains, progress)
    size = grid.width // CELL, grid.height // CELL
    shape = (len(planes), size[1], size[0])
    agreed, power = np.empty(shape, np.float32), np.empty(shape, np.float32)
    chance = np.empty(shape[1:], np.float32)
    for k, (image, weight) in enumerate(_integrals(sums, grid, planes)):
        mean = image[..., 0] * np.float32(1.0 / _WORDS) - np.float32(MOST)
        square = image[..., 1] * np.float32(MOST**2 / _WORDS)
        above = np.maximum(weight - 1.0, 0.0)
        share = above / np.maximum(weight, np.float32(1e-6))
        agreed[k] = resized(share * (weight * mean * mean - square), *size)
        power[k] = resized(share * above * square, *size)
        if k == len(planes) // 2:
            chance = resized(2.0 * share * (share * square) ** 2, *size)
        if progress is not None:
            progress("finding the relief of the ground", k + 1, len(planes))
    return Agreement(offsets_m, agreed, power, chance, CELL * grid.gsd_m)


def _integrals(
    integrator: Integrator, grid: VirtualCamera, planes: list[FocalPlane]
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield image and footprint of every plane."""
    if any(plane.normal[0] or plane.normal[1] for plane in planes):
        for plane in planes:
            yield integrator.integrate(grid, plane)
        return
    downs = np.array([plane.point[2] for plane in planes])
    for start in range(0, len(downs), _AT_ONCE):  # level ones share what they read
        yield from zip(*integrator.sweep(grid, downs[start : start + _AT_ONCE]), strict=True)


def _moments(
    photos: Photos,
    ground: NDArray[np.uint8],
    gains: NDArray[np.float64] | None,
    progress: Progress | None,
) -> Integrator:
    """Contrasts and their squares, weighed by what is ground, ready to be integrated."""
    camera, count = photos.flight.camera, len(photos.flight)
    factor = min(
        1.0,
        _LONGEST_PX / max(camera.width, camera.height),
        float(np.sqrt(_MOST_PX / (count * camera.width * camera.height))),
    )
    width, height = (max(1, round(side * factor)) for side in (camera.width, camera.height))
    factors = np.ones((count, 3)) if gains is None else gains
    white = {"uint8": 255.0, "uint16": 65535.0, "float32": 1.0}
    images = np.zeros((count, height, width, 3), np.uint16)
    weights = np.empty((count, height, width), np.uint8)
    for k in range(count):
        photo = photos.images[k].numpy()
        shown = np.nan_to_num(resized(photo, width, height))
        weights[k] = resized(ground[k], width, height)
        if photos.valid is not None:
            weights[k][resized(photos.valid_of(k), width, height) < 255] = 0
        contrast = ground_contrast(shown, weights[k], factors[k], white[photo.dtype.name])
        images[k, ..., 0] = (contrast + np.float32(MOST)) * np.float32(_WORDS)
        images[k, ..., 1] = contrast * contrast * np.float32(_WORDS / MOST**2)
        if progress is not None:
            progress("comparing the ground in photos", k + 1, count)
    small = camera.scaled(width, height)
    device = photos.images.device
    return Integrator(small, images, photos.flight.poses, weights, device=device)
