"""People looked for in the integral image itself, by any detector."""

from __future__ import annotations

import time
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.locate import ViewFinds, box_places
from hsvaos.kernels.rays import focal_points
from hsvaos.live.finds import LiveFinds
from hsvaos.live.looking import LookThread
from hsvaos.live.result import LiveResult
from hsvaos.surface import FocalSurface


class LooksForPeople(Protocol):
    """What `hsvaos.Detector` offers."""

    def detect(self, image: Any, *, footprint: Any = None, gsd_m: float | None = None) -> Any:
        """Return `Detections`."""


class DetectionThread(LookThread):
    """Looks at copies of integral images.

    Args:
        detector: Looks for people.
        size: (width, height) of the images [px].
        channels: Their channels.
    """

    def __init__(self, detector: LooksForPeople, size: tuple[int, int], channels: int) -> None:
        super().__init__()
        self._detector = detector
        self._image = np.zeros((size[1], size[0], channels), np.float32)
        self._footprint = np.zeros((size[1], size[0]), np.float32)
        self._shown: tuple[int, VirtualCamera, FocalSurface, float] | None = None
        self.start()

    def take(self, number: int, image: NDArray[Any], pose: NDArray[Any]) -> None:
        """See `LookThread`: the picture is all it looks at."""

    def _hold(self, result: LiveResult, surface: FocalSurface, gsd_m: float) -> None:
        np.copyto(self._image, result.image)
        np.copyto(self._footprint, result.footprint)
        self._shown = (result.number, result.view, surface, gsd_m)

    def _look(self, started_s: float) -> LiveFinds:
        if self._shown is None:
            raise RuntimeError("nothing is held to be looked at")
        number, view, surface, gsd_m = self._shown
        image = self._image if self._image.shape[2] == 3 else self._image[..., 0]
        found = self._detector.detect(image, footprint=self._footprint, gsd_m=gsd_m or None)
        hits = focal_points(view, surface, device="cpu").numpy()
        placed = box_places(found, hits.reshape(view.height, view.width, 4), view)
        seconds = time.monotonic() - started_s
        return LiveFinds(number, found, seconds, ViewFinds(view, found, *placed))
