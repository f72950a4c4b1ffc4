"""Users' arrays are looked at where they lie."""

from __future__ import annotations

import numpy as np
import warp as wp

from hsvaos.kernels.arrays import Stack, to_array


def test_one_image_with_an_axis_in_front_is_not_copied() -> None:
    image = np.zeros((40, 30, 3), np.uint8)
    stack = Stack(image[None], wp.get_device("cpu"))
    assert stack.array.ptr == image.ctypes.data
    assert stack.pixels.ptr == image.ctypes.data
    empty = to_array(np.zeros((0, 4), np.uint8), wp.get_device("cpu"), "empty")
    assert tuple(empty.shape) == (0, 4)
