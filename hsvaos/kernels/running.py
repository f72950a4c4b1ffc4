"""Running sums of integral images: a photo is added and later taken out without a trace.

The sums are whole numbers held in float64, which adds and subtracts them exactly below 2^53: what
a photo brought is taken away to the last bit, after any number of photos, and nothing drifts.
"""

from functools import lru_cache
from typing import Any

import warp as wp

from hsvaos.kernels.arrays import pixel_view
from hsvaos.kernels.device import launch

wp.set_module_options({"enable_backward": False})

MOST_PHOTOS = 4096
"""Photos that the sums hold exactly, each with weights of at most 1."""

WEIGHT_STEPS = 2.0**40
"""Steps of a weight of 1: 2^40 times 4096 photos stay below 2^53."""

_SUMS = {wp.vec3: wp.vec4d, wp.float32: wp.vec2d}
"""Colour times weight, and weight, by what an image holds."""


@wp.func
def _with_weight(value: wp.vec3, weight: float, white: float) -> wp.vec4d:
    share = wp.float64(weight) * wp.float64(WEIGHT_STEPS)
    unit = share / wp.float64(white)
    return wp.vec4d(
        wp.round(wp.float64(value[0]) * unit),
        wp.round(wp.float64(value[1]) * unit),
        wp.round(wp.float64(value[2]) * unit),
        wp.round(share),
    )


@wp.func
def _with_weight(value: float, weight: float, white: float) -> wp.vec2d:
    share = wp.float64(weight) * wp.float64(WEIGHT_STEPS)
    return wp.vec2d(wp.round(wp.float64(value) * share / wp.float64(white)), wp.round(share))


@wp.func
def _mean(sums: wp.vec4d, white: wp.float64) -> wp.vec3:
    scale = white / sums[3]
    return wp.vec3(float(sums[0] * scale), float(sums[1] * scale), float(sums[2] * scale))


@wp.func
def _mean(sums: wp.vec2d, white: wp.float64) -> float:
    return float(sums[0] * (white / sums[1]))


@wp.func
def _weight(sums: wp.vec4d) -> wp.float64:
    return sums[3]


@wp.func
def _weight(sums: wp.vec2d) -> wp.float64:
    return sums[1]


@lru_cache
def _add_kernel(value: Any) -> Any:
    sums_type = _SUMS[value]

    @wp.kernel(module="unique", enable_backward=False)
    def add_kernel(
        offset: int,
        band: int,
        sign: wp.float64,
        white: float,
        image: wp.array(dtype=value),
        footprint: wp.array(dtype=float),
        sums: wp.array(dtype=sums_type),
    ):
        i = wp.tid() + offset
        if footprint[i] > 0.0:
            sums[i] = sums[i] + sign * _with_weight(image[i], footprint[i], white)

    return add_kernel


@lru_cache
def _mean_kernel(value: Any) -> Any:
    sums_type = _SUMS[value]

    @wp.kernel(module="unique", enable_backward=False)
    def mean_kernel(
        offset: int,
        band: int,
        white: float,
        sums: wp.array(dtype=sums_type),
        image: wp.array(dtype=value),
        footprint: wp.array(dtype=float),
    ):
        i = wp.tid() + offset
        total = _weight(sums[i])
        mean = value(0.0)
        if total > wp.float64(0.0):
            mean = _mean(sums[i], wp.float64(white))
        image[i] = mean
        footprint[i] = float(total / wp.float64(WEIGHT_STEPS))

    return mean_kernel


class RunningSums:
    """Sums over photos at the pixels of one view.

    Args:
        size: Pixels of the view.
        channels: Channels of the images, 3 or 1.
        white: Value of full white in the images.
        device: Warp device.
    """

    def __init__(self, size: int, channels: int, white: float, device: Any) -> None:
        self._value = wp.vec3 if channels == 3 else wp.float32
        self._white, self._device = float(white), device
        self._sums = wp.zeros(size, dtype=_SUMS[self._value], device=device)

    def clear(self) -> None:
        """Forget all photos."""
        self._sums.zero_()

    def add(self, image: Any, footprint: Any, sign: int = 1) -> None:
        """Add one photo, or take it out.

        Args:
            image: Warp array of H * W * C float32, the photo seen from the view.
            footprint: Warp array of H * W float32, its weights, 0..1.
            sign: 1 to add, -1 to take out the same image again.
        """
        size = self._sums.size
        inputs = [
            *(float(sign), self._white, pixel_view(image, self._value, (size,))),
            *(pixel_view(footprint, wp.float32, (size,)), self._sums),
        ]
        launch(_add_kernel(self._value), size, inputs, self._device)

    def mean(self, image: Any, footprint: Any) -> None:
        """Write the weighted mean of all photos and the sum of their weights.

        Args:
            image: Warp array of H * W * C float32, written; 0 where the footprint is.
            footprint: Warp array of H * W float32, written.
        """
        size = self._sums.size
        inputs = [
            *(self._white, self._sums, pixel_view(image, self._value, (size,))),
            pixel_view(footprint, wp.float32, (size,)),
        ]
        launch(_mean_kernel(self._value), size, inputs, self._device)
