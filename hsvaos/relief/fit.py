"""Heights that fit an agreement best and are as smooth as ground is."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.relief.agreement import CELL, Agreement

_WINDOWS = (40.0, 24.0, 14.0, 8.0)
"""Radii (sigma) of the windows over which agreement is summed, from coarse to fine, in points of
the grid."""

_REACHES = (np.inf, 8.0, 5.0, 3.0)
"""How far from the heights so far each window looks for its own, in steps of depth."""

_SURE = (2.0, 5.0)
"""Deviations above chance from which a peak counts, and from which it counts fully."""

_SEMBLANCE = (0.03, 0.09)
"""The same for its semblance: chance alone is not what misleads, crowns are."""

_TOGETHER = 6.0
"""Neighbouring points that say the same, as they see the same pixels."""

_APART = 3.5
"""Steps of depth from a peak, from which on there is only what it is compared with."""

_STIFF = 1.5
"""Weight of smoothness against that of one sure window: membrane."""

_LEVEL = 0.001
"""Weight with which unseen ground returns to the plane."""

_ROUNDS = 150


def fit_heights(agreement: Agreement) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the ground's offsets from the focal plane, and how sure they are.

    From coarse to fine windows: the depth at which the rays in a window agree most, near the
    heights found so far, and a membrane drawn through these depths by how sure they are.

    Args:
        agreement: What was measured.

    Returns:
        Shape (H, W), downwards [m], and shape (H, W), 0..1.
    """
    shape = agreement.chance.shape
    heights, sure = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for window, reach in zip(_WINDOWS, _REACHES, strict=True):
        depth, sure = _peaks(agreement, window / CELL, heights, reach)
        heights = _membrane(depth, sure * np.float32(4.0 * (CELL / window) ** 2), heights)
    return heights, sure


def _peaks(
    agreement: Agreement, sigma: float, heights: NDArray[np.float32], reach: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth of the best agreement around each cell [m], and how sure it is, 0..1."""
    offsets = agreement.offsets_m
    step = float(offsets[1] - offsets[0])
    levels = offsets[:, None, None].astype(np.float32)
    agreed = np.stack([cv2.GaussianBlur(part, (0, 0), sigma) for part in agreement.agreed])
    near = np.abs(levels - heights) <= reach * step
    best = np.where(near, agreed, -np.inf).argmax(axis=0).clip(1, len(offsets) - 2)

    def at(values: NDArray[np.float32], shift: int = 0) -> NDArray[np.float32]:
        return np.asarray(np.take_along_axis(values, (best + shift)[None], axis=0)[0])

    above, top, below = at(agreed, -1), at(agreed), at(agreed, 1)
    bend = above + below - 2.0 * top
    is_peak = (top >= above) & (top >= below) & (bend < 0.0)
    between = np.where(is_peak, 0.5 * (above - below) / np.where(is_peak, bend, -1.0), 0.0)
    depth = (offsets[best] + step * between.clip(-0.5, 0.5)).astype(np.float32)
    elsewhere = np.abs(levels - depth) > _APART * step
    others = (agreed * elsewhere).sum(axis=0) / np.maximum(elsewhere.sum(axis=0), 1)
    power = np.stack([cv2.GaussianBlur(part, (0, 0), sigma) for part in agreement.power])
    semblance = top / (at(power) + np.float32(1e-4))
    # a sum under a Gaussian counts as many points as it has under its square
    spread = cv2.GaussianBlur(agreement.chance, (0, 0), sigma / np.sqrt(2.0))
    points = 4.0 * np.pi * (sigma * CELL) ** 2 / _TOGETHER
    deviation = np.sqrt(spread / points) + np.float32(1e-9)
    sure = _ramp((top - others) / deviation, _SURE) * _ramp(semblance, _SEMBLANCE)
    return depth, np.where(is_peak, sure, 0.0).astype(np.float32)


def _ramp(values: NDArray[np.float32], ends: tuple[float, float]) -> NDArray[np.float32]:
    return np.asarray(np.clip((values - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0))


def _membrane(
    depth: NDArray[np.float32], weight: NDArray[np.float32], start: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Minimise weight (h - depth)^2 + stiff |grad h|^2 + level h^2 by conjugate gradients."""
    own = weight.astype(np.float64) + _LEVEL

    def applied(h: NDArray[np.float64]) -> NDArray[np.float64]:
        beside = np.pad(h, 1, mode="edge")
        around = beside[:-2, 1:-1] + beside[2:, 1:-1] + beside[1:-1, :-2] + beside[1:-1, 2:]
        return own * h + _STIFF * (4.0 * h - around)

    heights = start.astype(np.float64)
    rest = weight * depth.astype(np.float64) - applied(heights)
    scale = 1.0 / (own + 4.0 * _STIFF)
    way = scale * rest
    left = first = float((rest * way).sum())
    for _ in range(_ROUNDS):
        if left <= 1e-10 * first or left == 0.0:
            break
        pull = applied(way)
        step = left / float((way * pull).sum())
        heights += step * way
        rest -= step * pull
        scaled = scale * rest
        before, left = left, float((rest * scaled).sum())
        way = scaled + left / before * way
    return heights.astype(np.float32)
