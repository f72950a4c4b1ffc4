"""A view is looked at with what lies around it: who lies across its border is seen whole.

The other photos have seen the ground beyond the border of a virtual camera as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections

REACH_M = 2.0
"""How far beyond the border of a view our own networks look: a person and what is beside them."""

_MOST_SHARE = 0.5
"""Widest surroundings, in the longer side of the view: of a view of a few metres, or at a sampling
distance that is wrong."""

_LEAST_INSIDE = 1.0 / 3.0
"""Share of a box that a view must hold: of those who lie half in it, most are still found."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """A view with what lies around it.

    Args:
        inner: The view.
        margin_px: Rows and columns around it [px].
    """

    inner: VirtualCamera
    margin_px: int

    @property
    def view(self) -> VirtualCamera:
        """The wider view."""
        if self.inner.camera is None or self.margin_px == 0:
            return self.inner
        wider = self.inner.camera.widened(self.margin_px)
        return VirtualCamera(wider, self.inner.world_from_camera)

    def cut(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the part of the wider view's pixels that the view has, shape (H, W, ...)."""
        rows, columns = (slice(self.margin_px, self.margin_px + n) for n in self.inner.size[::-1])
        return np.ascontiguousarray(array[rows, columns])

    def within(self, found: Detections) -> Detections:
        """Return the finds that lie in the view, cut off at its border, in its pixels.

        Args:
            found: In the wider view.
        """
        if self.margin_px == 0:
            return found
        boxes = found.boxes_xyxy - np.float32(self.margin_px)
        low, high = np.float32(-0.5), np.array(self.inner.size * 2, np.float32) - np.float32(0.5)
        cut = np.clip(boxes, low, high)
        inside, whole = (np.prod(b[:, 2:] - b[:, :2], axis=1) for b in (cut, boxes))
        kept = inside >= _LEAST_INSIDE * whole
        return Detections(cut[kept], found.scores[kept], found.class_ids[kept])


def with_surroundings(view: VirtualCamera, gsd_m: float, reach_m: float) -> Surroundings:
    """Return a view with so many metres around it; a ground grid, which has all, with none.

    Args:
        view: The virtual camera.
        gsd_m: Its ground sampling distance [m/px]; not finite or 0 where it sees no ground.
        reach_m: How far beyond its border to look [m].
    """
    if view.is_ortho or reach_m <= 0.0 or not (np.isfinite(gsd_m) and gsd_m > 0.0):
        return Surroundings(view, 0)
    return Surroundings(view, int(np.ceil(min(reach_m / gsd_m, _MOST_SHARE * max(view.size)))))
