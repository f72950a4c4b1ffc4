"""People looked for beside the integration: in a thread of its own, which never holds it up."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.detections import Detections
from hsvaos.live.latency import Latencies

_POLITE = 10
"""Niceness of the thread: the integration goes first where cores are short."""


class LooksForPeople(Protocol):
    """What `hsvaos.Detector` offers."""

    def detect(self, image: Any, *, footprint: Any = None, gsd_m: float | None = None) -> Any:
        """Return `Detections`."""


@dataclass(frozen=True, eq=False)
class LiveFinds:
    """What was found in one integral image.

    Args:
        number: Number of the newest photo in that image.
        detections: The boxes.
        seconds: Time that looking took [s].
    """

    number: int
    detections: Detections
    seconds: float


class DetectionThread:
    """Looks at copies of integral images; one that comes while it is busy is skipped and counted.

    Args:
        detector: Looks for people.
        size: (width, height) of the images [px].
        channels: Their channels.
    """

    def __init__(self, detector: LooksForPeople, size: tuple[int, int], channels: int) -> None:
        self._detector = detector
        self._image = np.zeros((size[1], size[0], channels), np.float32)
        self._footprint = np.zeros((size[1], size[0]), np.float32)
        self._number, self._gsd_m = -1, 0.0
        self._changed = threading.Condition()
        self._busy = self._closed = False
        self.latest: LiveFinds | None = None
        self.error: Exception | None = None
        self.skipped = 0
        self.times = Latencies()
        self._thread = threading.Thread(target=self._work, name="hsvaos-detect", daemon=True)
        self._thread.start()

    def offer(
        self,
        number: int,
        image: NDArray[np.float32],
        footprint: NDArray[np.float32],
        gsd_m: float,
    ) -> None:
        """Copy an integral image to be looked at, unless one is being looked at."""
        with self._changed:
            if self._busy:
                self.skipped += 1
                return
            np.copyto(self._image, image)
            np.copyto(self._footprint, footprint)
            self._number, self._gsd_m, self._busy = number, gsd_m, True
            self._changed.notify_all()

    def _work(self) -> None:
        if sys.platform == "linux":  # elsewhere threads have no niceness of their own
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _POLITE)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._busy or self._closed)
                if self._closed:
                    return
            start = time.monotonic()
            try:
                image = self._image if self._image.shape[2] == 3 else self._image[..., 0]
                found = self._detector.detect(
                    image, footprint=self._footprint, gsd_m=self._gsd_m or None
                )
                seconds = time.monotonic() - start
                self.latest = LiveFinds(self._number, found, seconds)
                self.times.add(seconds)
            except Exception as error:  # told to the caller by the integrator
                self.error = error
            with self._changed:
                self._busy = False
                self._changed.notify_all()

    def rest(self, timeout_s: float | None = None) -> bool:
        """Wait until nothing is being looked at; return whether that came to be."""
        with self._changed:
            return bool(self._changed.wait_for(lambda: not self._busy, timeout_s))

    def close(self) -> None:
        """End the thread after the image that it looks at."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()
