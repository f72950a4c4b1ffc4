"""Rarity of 8-bit photos as they come in: the bin of each of the 16.7 million colours, looked up.

Lab costs some fifty nanoseconds a pixel; the table (32 MB, made once) gives the same bins for a
tenth of that. A first pass counts and keeps the bins, a second one turns them into weights.
"""

from functools import lru_cache
from typing import Any

import warp as wp

from hsvaos.kernels.device import launch
from hsvaos.kernels.lab import lab_pixel, lab_tables
from hsvaos.kernels.rarity_bins import colour_bin

wp.set_module_options({"enable_backward": False})

_COLOURS = 1 << 24


@wp.kernel(module="unique", enable_backward=False)
def _table_kernel(
    offset: int,
    band: int,
    gamma: wp.array(dtype=float),
    curve: wp.array(dtype=float),
    table: wp.array(dtype=wp.uint16),
):
    i = wp.tid() + offset
    unit = 1.0 / 255.0
    colour = wp.vec3(float(i >> 16), float((i >> 8) & 255), float(i & 255)) * unit
    table[i] = wp.uint16(colour_bin(lab_pixel(colour, gamma, curve)))


@wp.kernel(module="unique", enable_backward=False)
def _count_kernel(
    offset: int,
    band: int,
    table: wp.array(dtype=wp.uint16),
    rgb: wp.array(dtype=wp.vec3ub),
    valid: wp.array(dtype=wp.uint8),
    bins: wp.array(dtype=wp.uint16),
    counts: wp.array2d(dtype=wp.int64),
):
    i = wp.tid() + offset
    colour = rgb[i]
    bin = table[(int(colour[0]) << 16) + (int(colour[1]) << 8) + int(colour[2])]
    bins[i] = bin
    if valid[i] > wp.uint8(0):
        wp.atomic_add(counts, band, int(bin), wp.int64(1))


@wp.kernel(module="unique", enable_backward=False)
def _weigh_kernel(
    offset: int,
    band: int,
    bins: wp.array(dtype=wp.uint16),
    valid: wp.array(dtype=wp.uint8),
    weights_of: wp.array(dtype=wp.uint8),
    weights: wp.array(dtype=wp.uint8),
):
    i = wp.tid() + offset
    weight = wp.uint8(0)
    if valid[i] > wp.uint8(0):
        weight = weights_of[int(bins[i])]
    weights[i] = weight


@lru_cache
def _table_on(device: str) -> Any:
    """The table on a device, made once."""
    place = wp.get_device(device)
    table = wp.empty(_COLOURS, dtype=wp.uint16, device=place)
    launch(_table_kernel, _COLOURS, [*lab_tables(place), table], place)
    return table


class BinTable:
    """The rarity bin of every 8-bit colour, and memory for those of one photo.

    Args:
        size: Pixels of a photo.
        device: Warp device.
    """

    def __init__(self, size: int, device: Any) -> None:
        self._device = device
        self._table = _table_on(str(device))
        self._bins = wp.zeros(size, dtype=wp.uint16, device=device)

    def count(self, pixels: Any, valid: Any, counts: Any) -> None:
        """Add the colours of a photo to a histogram, and keep its bins.

        Args:
            pixels: Warp array (H * W) of vec3ub.
            valid: Warp array (H * W), uint8, 0 = ignore.
            counts: Warp array of `rarity_bins.counts_shape`, int64, added to.
        """
        inputs = [self._table, pixels, valid, self._bins, counts]
        launch(_count_kernel, pixels.size, inputs, self._device)

    def weigh(self, valid: Any, weights_of: Any, weights: Any) -> None:
        """Write the weight of every pixel of the photo counted last.

        Args:
            valid: Warp array (H * W), uint8, 0 = weight 0.
            weights_of: Warp array of the weight of each bin, uint8.
            weights: Warp array (H * W), uint8, written.
        """
        inputs = [self._bins, valid, weights_of, weights]
        launch(_weigh_kernel, weights.size, inputs, self._device)
