"""Doubt about finds on ground that hardly any photo has seen.

An integral image of one or two photos is those photos: crowns stand sharp in it, and what shows
between leaves looks like a thing. At the edges of a flight much ground is seen so.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

ENOUGH_RAYS = 5.0
"""Rays from which a find is taken as it is; half of the most of a view are enough too. On two
tuning flights the false boxes at the edges lay on 1 to 4 rays, no right one on fewer than 10."""


def doubted(boxes: Array, scores: Array, rays: Array) -> Array:
    """Return scores whose odds are lowered in proportion to the rays that are missing.

    With n rays in the middle of a box of the N that are enough, n < N, the odds of the find are
    n / N of what the network says. Someone who lies in the open at the edge is still found; what
    was in doubt is dropped.

    Args:
        boxes: Shape (N, 4), corners with pixel k covering k to k + 1 [px].
        scores: Shape (N,), 0..1.
        rays: Shape (H, W), rays of each pixel; NaN counts as 0.

    Returns:
        Shape (N,), float32.
    """
    known = np.nan_to_num(rays, nan=0.0)
    enough = min(ENOUGH_RAYS, 0.5 * float(known.max(initial=0.0)))
    if not len(boxes) or enough <= 0.0:
        return np.asarray(scores, dtype=np.float32)
    middle = np.floor(0.5 * (boxes[:, :2] + boxes[:, 2:])).astype(np.int64)
    x, y = np.clip(middle, 0, np.array(known.shape)[::-1] - 1).T
    share = np.clip(known[y, x] / enough, 0.0, 1.0)
    rest = 1.0 - (1.0 - share) * scores  # 0 only where the surest find has no ray
    return np.asarray(share * scores / np.maximum(rest, 1e-9), dtype=np.float32)
