"""Hue histogram by a parallel reduction, and the mask that cuts mean +- k sigma (the trees)."""

from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.hue_statistics import BINS, HueStatistics, check_statistics, hue_statistics
from hsvaos.kernels.arrays import (
    Stack,
    device_of,
    like_input,
    output_array,
    pixel_scales,
    pixel_view,
    require_unit_range,
    valid_array,
)
from hsvaos.kernels.color import rgb_to_hsv_pixel
from hsvaos.kernels.device import in_vectors, launch
from hsvaos.kernels.hue_chunks import count_bands, count_hues, cut_hues
from hsvaos.kernels.pixels import as_vec3, is_colour

wp.set_module_options({"enable_backward": False})

_UNIT = 65535.0
"""Chroma 1 as a whole number: sums of whole numbers do not depend on their order."""

_SUMS = BINS + 2
"""Entries of an accumulator: the bins, the sum of chroma, the number of valid pixels."""


@lru_cache
def _histogram_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def hue_histogram_kernel(
        offset: int,
        band: int,
        scale: wp.vec3,
        circular: int,
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        sums: wp.array2d(dtype=wp.int64),
    ):
        i = wp.tid() + offset
        if valid[i] == wp.uint8(0):
            return
        colour = wp.cw_mul(as_vec3(rgb[i]), scale)
        if not is_colour(colour):
            return
        hsv = rgb_to_hsv_pixel(colour)
        chroma = wp.int64(hsv[1] * hsv[2] * _UNIT + 0.5)
        weight = wp.int64(1)
        if circular != 0:
            weight = chroma
        bin = wp.min(int(hsv[0] * (float(BINS) / 360.0)), BINS - 1)
        wp.atomic_add(sums, band, bin, weight)
        wp.atomic_add(sums, band, BINS, chroma)
        wp.atomic_add(sums, band, BINS + 1, wp.int64(1))

    return hue_histogram_kernel


@lru_cache
def _mask_kernel(pixel: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def hue_mask_kernel(
        offset: int,
        band: int,
        scale: wp.vec3,
        circular: int,
        mean: float,
        half_width: float,
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        mask: wp.array(dtype=wp.uint8),
    ):
        i = wp.tid() + offset
        colour = wp.cw_mul(as_vec3(rgb[i]), scale)
        if not is_colour(colour):
            mask[i] = wp.uint8(0)
            return
        hsv = rgb_to_hsv_pixel(colour)
        distance = wp.abs(hsv[0] - mean)
        keep = valid[i]
        if circular != 0:
            distance = wp.min(distance, 360.0 - distance)
        if distance <= half_width and (circular == 0 or hsv[1] > 0.0):
            keep = wp.uint8(0)
        mask[i] = keep

    return hue_mask_kernel


def hue_histograms(
    images: Any,
    *,
    statistics: str = "circular",
    valid: Any = None,
    gains: Any = None,
    device: Any = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Count the hues of every image.

    Args:
        images: Shape (N, H, W, 3) RGB; uint8, uint16 or float32 (0..1).
        statistics: "circular" weighs each pixel by saturation x value, because dark grey pixels
            have noise for a hue; "linear" counts every pixel once, as the paper does.
        valid: Shape (H, W) or (N, H, W), uint8 or bool, pixels to use; None for all.
        gains: Shape (N, 3), factors on R, G and B of each image; see `kernels.levels`.
        device: Where to run; by default where the images lie.

    Returns:
        histograms, shape (N, 1440), float64, quarter-degree bins, and the mean chroma (saturation
        x value) of each image, shape (N,), 0 where no pixel is valid.

    Raises:
        ValueError: If images or masks have the wrong shape.
        TypeError: If their type is not supported.
    """
    check_statistics(statistics, 1.0)
    stack = Stack(images, device_of(images, device))
    stack.require_colour()
    masks = valid_array(valid, stack)
    require_unit_range(stack)
    sums = wp.zeros(
        (stack.count, *sums_shape(stack.size, stack.device)), dtype=wp.int64, device=stack.device
    )
    scales = pixel_scales(stack, gains)
    for i in range(stack.count):
        valid_row = masks[i % masks.shape[0]]
        add_hues(stack.pixels[i], valid_row, scales[i], statistics, sums[i])
    return histogram_of(sums.numpy().sum(axis=1), statistics)


def sums_shape(size: int, device: Any) -> tuple[int, int]:
    """Return the shape of the accumulators of an image of a size [px]: one row a band."""
    return count_bands(size, device) if in_vectors(device) else 1, _SUMS


def add_hues(pixels: Any, valid: Any, scale: Any, statistics: str, sums: Any) -> None:
    """Add the hues of an image to whole-number accumulators.

    Args:
        pixels: Warp array (H * W) of RGB pixels.
        valid: Warp array (H * W), uint8.
        scale: Vector that brings pixels to 0..1, see `arrays.pixel_scales`.
        statistics: "circular" or "linear".
        sums: Warp array of `sums_shape`, int64, added to.
    """
    inputs = [scale, int(statistics == "circular"), pixels, valid, sums]
    if in_vectors(pixels.device):
        count_hues(pixels, pixels.size, inputs, pixels.device)
    else:
        launch(_histogram_kernel(pixels.dtype), pixels.size, inputs, pixels.device)


def histogram_of(
    sums: NDArray[np.int64], statistics: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return hue histograms and mean chroma from accumulators.

    Args:
        sums: Shape (..., 1442), summed over bands.
        statistics: "circular" or "linear".

    Returns:
        histograms, shape (..., 1440), and the mean chroma, shape (...).
    """
    totals = sums.astype(np.float64)
    unit = _UNIT if statistics == "circular" else 1.0
    chroma = totals[..., BINS] / _UNIT / np.maximum(totals[..., BINS + 1], 1.0)
    return totals[..., :BINS] / unit, chroma


def apply_hue_cut(
    images: Any,
    stats: list[HueStatistics],
    *,
    valid: Any = None,
    gains: Any = None,
    out: Any = None,
    device: Any = None,
) -> Any:
    """Make the masks of a hue cut that was measured before; see `hue_masks`.

    Args:
        images: Shape (N, H, W, 3) RGB.
        stats: N statistics, one an image.
        valid: User masks that multiply in.
        gains: Shape (N, 3), factors on R, G and B of each image, as when measured.
        out: Shape (N, H, W), uint8, written in place; new if None.
        device: Where to run; by default where the images lie.
    """
    stack = Stack(images, device_of(images, device))
    stack.require_colour()
    masks = valid_array(valid, stack)
    shape = (stack.count, stack.height, stack.width)
    result = output_array(out, shape, wp.uint8, stack.device, "out")
    target = pixel_view(result, wp.uint8, (stack.count, stack.size))
    scales = pixel_scales(stack, gains)
    for i, s in enumerate(stats):
        cut_photo(stack.pixels[i], masks[i % masks.shape[0]], scales[i], s, target[i])
    return like_input(result, images) if out is None else out


def cut_photo(pixels: Any, valid: Any, scale: Any, stats: HueStatistics, mask: Any) -> None:
    """Write the mask of one image.

    Args:
        pixels: Warp array (H * W) of RGB pixels.
        valid: Warp array (H * W), uint8, multiplied in.
        scale: Vector that brings pixels to 0..1, see `arrays.pixel_scales`.
        stats: What to cut.
        mask: Warp array (H * W), uint8, written.
    """
    half_width = stats.half_width_deg if stats.informative else -1.0
    circular = int(stats.statistics == "circular")
    inputs = [scale, circular, stats.mean_deg, half_width, pixels, valid, mask]
    if in_vectors(pixels.device):
        cut_hues(pixels, pixels.size, inputs, pixels.device)
    else:
        launch(_mask_kernel(pixels.dtype), pixels.size, inputs, pixels.device)


def measure_hue(
    images: Any,
    sigmas: float = 2.0,
    statistics: str = "circular",
    scope: str = "image",
    *,
    valid: Any = None,
    gains: Any = None,
    device: Any = None,
) -> tuple[list[HueStatistics], NDArray[np.float64]]:
    """Measure the cut of every image; see `hue_masks` for the arguments.

    Returns:
        N `HueStatistics`, and the hue histogram over the flight, shape (1440,), float64.
    """
    check_statistics(statistics, sigmas)
    if scope not in ("image", "flight"):
        raise ValueError(f'scope must be "image" or "flight", got {scope!r}')
    histograms, chroma = hue_histograms(
        images, statistics=statistics, valid=valid, gains=gains, device=device
    )
    whole = histograms.sum(axis=0)
    rows, means = (histograms, chroma) if scope == "image" else ([whole], [chroma.mean()])
    stats = [
        hue_statistics(row, float(mean), statistics=statistics, sigmas=sigmas)
        for row, mean in zip(rows, means, strict=True)
    ]
    return stats * (len(histograms) // len(stats)), whole


def hue_masks(
    images: Any,
    sigmas: float = 2.0,
    statistics: str = "circular",
    scope: str = "image",
    *,
    valid: Any = None,
    gains: Any = None,
    out: Any = None,
    device: Any = None,
) -> tuple[Any, list[HueStatistics]]:
    """Cut the trees: pixels whose hue lies within mean +- sigmas sigma (section 3.1 of the paper).

    Where hue says nothing (snow, grey, thermal; see `hue_statistics`) every pixel is kept, and the
    statistics say so. With circular statistics a pixel of no saturation has no hue and is kept.

    Args:
        images: Shape (N, H, W, 3), RGB; uint8, uint16 or float32 (0..1).
        sigmas: Half width of the cut.
        statistics: "circular" (weighted by saturation x value) or "linear" (the paper's).
        scope: "image" measures each image by itself, "flight" all of them together.
        valid: Shape (H, W) or (N, H, W), uint8 or bool: user masks (0 = ignore), which multiply
            into the result and keep pixels out of the statistics.
        gains: Shape (N, 3), factors on R, G and B of each image; see `kernels.levels`.
        out: Shape (N, H, W), uint8, written in place; new if None.
        device: Where to run; by default where the images lie.

    Returns:
        masks, shape (N, H, W), uint8, 255 = keep and 0 = cut (in between where user masks are), and
        N `HueStatistics` (the same one N times for scope "flight").

    Raises:
        ValueError: If a parameter is out of range or images are not RGB.
        TypeError: If a type is not supported.
    """
    stats, _ = measure_hue(
        images, sigmas, statistics, scope, valid=valid, gains=gains, device=device
    )
    masks = apply_hue_cut(images, stats, valid=valid, gains=gains, out=out, device=device)
    return masks, stats
