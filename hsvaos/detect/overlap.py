"""How much boxes overlap."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def overlaps(boxes: ArrayLike, truth: ArrayLike, regions: ArrayLike | None = None) -> Array:
    """Return the intersection over union of boxes.

    Args:
        boxes: Shape (K, 4), left, top, right, bottom.
        truth: Shape (T, 4).
        regions: Shape (T,), bool; over these the intersection is divided by the area of the first
            box alone (COCO's crowds).

    Returns:
        Shape (K, T), float64, 0..1.
    """
    a = np.asarray(boxes, dtype=np.float64).reshape(-1, 1, 4)
    b = np.asarray(truth, dtype=np.float64).reshape(1, -1, 4)
    low, high = np.maximum(a[..., :2], b[..., :2]), np.minimum(a[..., 2:], b[..., 2:])
    common = np.maximum(high - low, 0.0).prod(axis=-1)
    own = np.broadcast_to((a[..., 2:] - a[..., :2]).prod(axis=-1), common.shape)
    other = (b[..., 2:] - b[..., :2]).prod(axis=-1)
    loose = np.zeros(b.shape[1], np.bool_) if regions is None else np.asarray(regions, np.bool_)
    whole = np.where(loose, own, own + other - common)
    return np.asarray(np.divide(common, whole, out=np.zeros_like(common), where=whole > 0.0))
