"""What looking for people in the pictures of a live flight found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections
from hsvaos.detect.locate import ViewFinds


@dataclass(frozen=True, eq=False)
class LiveFinds:
    """What was found in one integral image.

    Args:
        number: Number of the newest photo in that image.
        detections: The boxes.
        seconds: Time that looking took [s].
        on_ground: The same boxes, and where they lie; None where that is not known.
    """

    number: int
    detections: Detections
    seconds: float
    on_ground: ViewFinds | None = None

    def seen_from(self, view: VirtualCamera) -> Detections:
        """Return the boxes where their places show in another view, those outside left out.

        Args:
            view: Of a later picture.
        """
        ground = self.on_ground
        if ground is None or ground.view is view:
            return self.detections
        found, last = self.detections, np.array(view.size, np.float64) - 1.0
        before, now = (eye.project(ground.places) for eye in (ground.view, view))
        shown = ((now >= 0.0) & (now <= last)).all(axis=1)  # places that are not known are NaN
        moved = found.boxes_xyxy + np.tile(now - before, 2)
        boxes: NDArray[np.float32] = moved[shown].astype(np.float32)
        return Detections(boxes, found.scores[shown], found.class_ids[shown])
