"""Slow, obvious NumPy twin of `kernels.running`; see `reference`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def running_mean(images: ArrayLike, footprints: ArrayLike) -> tuple[Array, Array]:
    """Twin of `kernels.running.RunningSums`: the weighted mean of views of single photos.

    Args:
        images: Shape (N, H, W, C), each photo seen from the view.
        footprints: Shape (N, H, W), its weights.

    Returns:
        image, shape (H, W, C), 0 where the footprint is, and footprint, shape (H, W).
    """
    weights = np.asarray(footprints, dtype=np.float64)
    colours = np.asarray(images, dtype=np.float64)
    footprint = weights.sum(axis=0)
    total = (colours * weights[..., None]).sum(axis=0)
    safe = np.where(footprint > 0.0, footprint, 1.0)
    return total / safe[..., None], footprint
