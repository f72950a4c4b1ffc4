"""How sharp each plane of a focal stack is, and which plane holds the ground."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from hsvaos.kernels.arrays import device_of, to_array
from hsvaos.kernels.device import ROW_GRAIN, launch

wp.set_module_options({"enable_backward": False})

MEASURES = ("kurtosis", "contrast", "gradient")

RING = 16
"""Samples on the surround of the centre-surround filter."""

_MIN_COVER = 0.6
"""Share of the plane's largest footprint that a pixel needs, so that borders do not count."""


@wp.func
def grey(image: wp.array3d(dtype=float), row: int, column: int) -> float:
    """Mean of the channels of a pixel."""
    total = float(0.0)
    for c in range(image.shape[2]):
        total += image[row, column, c]
    return total / float(image.shape[2])


@wp.func
def centre_surround(
    image: wp.array3d(dtype=float), row: int, column: int, core: int, ring: int
) -> float:
    """Mean of 3 x 3 samples `core` pixels apart minus the mean of a ring of 16 samples."""
    centre = float(0.0)
    for i in range(3):
        for j in range(3):
            centre += grey(image, row + (i - 1) * core, column + (j - 1) * core)
    surround = float(0.0)
    for k in range(RING):
        angle = 2.0 * wp.pi * float(k) / float(RING)
        y = int(wp.floor(float(ring) * wp.sin(angle) + 0.5))
        x = int(wp.floor(float(ring) * wp.cos(angle) + 0.5))
        surround += grey(image, row + y, column + x)
    return centre / 9.0 - surround / float(RING)


@wp.kernel(module="unique", enable_backward=False)
def _row_moments(
    offset: int,
    band: int,
    core: int,
    ring: int,
    min_footprint: wp.array(dtype=float),
    plane: int,
    image: wp.array3d(dtype=float),
    footprint: wp.array2d(dtype=float),
    sums: wp.array3d(dtype=wp.float64),
):
    row = wp.tid() + offset
    reach = wp.max(core, ring)
    if row < reach or row >= image.shape[0] - reach:
        return
    count = wp.float64(0.0)
    second = wp.float64(0.0)
    fourth = wp.float64(0.0)
    slope = wp.float64(0.0)
    least = min_footprint[plane]
    for column in range(reach, image.shape[1] - reach):
        covered = footprint[row, column] >= least
        covered = covered and footprint[row - reach, column] >= least
        covered = covered and footprint[row + reach, column] >= least
        covered = covered and footprint[row, column - reach] >= least
        covered = covered and footprint[row, column + reach] >= least
        if covered and least > 0.0:
            band_pass = wp.float64(centre_surround(image, row, column, core, ring))
            dx = wp.float64(grey(image, row, column + 1) - grey(image, row, column - 1))
            dy = wp.float64(grey(image, row + 1, column) - grey(image, row - 1, column))
            square = band_pass * band_pass
            count += wp.float64(1.0)
            second += square
            fourth += square * square
            slope += wp.float64(0.25) * (dx * dx + dy * dy)
    sums[plane, row, 0] = count
    sums[plane, row, 1] = second
    sums[plane, row, 2] = fourth
    sums[plane, row, 3] = slope


def focus_measure(
    stack: Any,
    footprint: Any,
    measure: str = "kurtosis",
    *,
    core_px: int = 2,
    ring_px: int = 12,
    device: Any = None,
) -> NDArray[np.float64]:
    """Measure how well each plane of a focal stack is in focus.

    Variance alone focuses on tree crowns, which have the most texture. The kurtosis of a
    centre-surround filter asks for few, strong, small things instead: on the rarity map of a
    focal stack it peaks where rare objects lie, on the ground.

    Args:
        stack: Shape (D, H, W, C), float32, focal stack of images or rarity maps.
        footprint: Shape (D, H, W), float32, its sum of weights.
        measure: "kurtosis" (fourth moment over squared second of the filter's output),
            "contrast" (its standard deviation) or "gradient" (mean squared gradient, Tenengrad).
        core_px: Spacing of the 3 x 3 samples of the filter's centre [px].
        ring_px: Radius of its surround [px].
        device: Where to run; by default where the stack lies.

    Returns:
        Shape (D,), float64; 0 for planes that nothing covers.

    Raises:
        ValueError: If a shape or the name of the measure is wrong.
    """
    if measure not in MEASURES:
        raise ValueError(f"measure must be one of {', '.join(MEASURES)}, got {measure!r}")
    if core_px < 1 or ring_px < 1:
        raise ValueError(f"core_px and ring_px must be at least 1, got {core_px} and {ring_px}")
    where = device_of(stack, device)
    images = to_array(stack, where, "stack")
    weights = to_array(footprint, where, "footprint")
    if images.ndim != 4 or tuple(weights.shape) != tuple(images.shape[:3]):
        raise ValueError(
            f"stack must have shape (D, H, W, C) and footprint (D, H, W), got "
            f"{tuple(images.shape)} and {tuple(weights.shape)}"
        )
    planes, rows = images.shape[:2]
    least = wp.array(_MIN_COVER * weights.numpy().max(axis=(1, 2)), dtype=float, device=where)
    sums = wp.zeros((planes, rows, 4), dtype=wp.float64, device=where)
    for i in range(planes):
        inputs = [core_px, ring_px, least, i, images[i], weights[i], sums]
        launch(_row_moments, rows, inputs, where, ROW_GRAIN)
    count, second, fourth, slope = sums.numpy().sum(axis=1).T
    some = np.maximum(count, 1.0)
    if measure == "kurtosis":
        result = (fourth / some) / np.maximum((second / some) ** 2, 1e-30)
    else:
        result = np.sqrt(second / some) if measure == "contrast" else slope / some
    return np.where(count > 0, result, 0.0)


def best_focus(downs_m: ArrayLike, curve: ArrayLike) -> tuple[float, float]:
    """Return the depth of the most prominent peak of a focus curve.

    The curve's logarithm is searched for local maxima; prominence is the height of a maximum above
    the higher of the two valleys beside it. The place is refined by a parabola through three
    points. A curve without an inner maximum yields its greatest value's depth and prominence 0.
    Planes of measure 0, which nothing covers, are left out.

    Args:
        downs_m: Shape (D,), rising depths of the planes [m].
        curve: Shape (D,), positive focus measure of each.

    Returns:
        Down [m] and prominence (factor by which the peak rises above its valleys, minus 1).

    Raises:
        ValueError: If shapes differ or there are no planes.
    """
    downs = np.asarray(downs_m, dtype=np.float64)
    values = np.asarray(curve, dtype=np.float64)
    if downs.ndim != 1 or downs.shape != values.shape or downs.size == 0:
        raise ValueError(f"expected two lists of equal length, got {downs.shape}, {values.shape}")
    if not (values > 0.0).any():
        return float(downs[0]), 0.0
    downs, heights = downs[values > 0.0], np.log(values[values > 0.0])
    best, prominence = int(np.argmax(heights)), 0.0
    for i in range(1, downs.size - 1):
        if heights[i] < heights[i - 1] or heights[i] <= heights[i + 1]:
            continue
        valleys = [_valley(heights[i::-1]), _valley(heights[i:])]
        rise = float(heights[i] - max(valleys))
        if rise > prominence:
            best, prominence = i, rise
    down = float(downs[best])
    if prominence > 0.0:
        left, middle, right = heights[best - 1 : best + 2]
        bend = left - 2.0 * middle + right
        shift = 0.0 if bend == 0.0 else 0.5 * (left - right) / bend
        step = downs[best + 1] - downs[best] if shift > 0.0 else downs[best] - downs[best - 1]
        down += float(shift * step)
    return down, float(np.expm1(prominence))


def _valley(heights: NDArray[np.float64]) -> float:
    """Lowest point on the way from the first entry to a higher one, or to the end."""
    higher = np.flatnonzero(heights > heights[0])
    end = higher[0] if higher.size else heights.size
    return float(heights[:end].min())
