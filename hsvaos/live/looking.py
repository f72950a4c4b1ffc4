"""Looking for people beside the integration: in a thread of its own, which never holds it up."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from abc import ABC, abstractmethod
from typing import Any

from numpy.typing import NDArray

from hsvaos.kernels.device import on_one_thread
from hsvaos.live.finds import LiveFinds
from hsvaos.live.latency import Latencies
from hsvaos.live.result import LiveResult
from hsvaos.surface import FocalSurface

_POLITE = 10
"""Niceness of the thread: the integration goes first where cores are short."""


class LookThread(ABC):
    """Looks at what it is offered; what comes while it is busy is skipped and counted."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._busy = self._closed = False
        self.latest: LiveFinds | None = None
        self.error: Exception | None = None
        self.skipped = 0
        self.times = Latencies()
        self._thread = threading.Thread(target=self._work, name="hsvaos-detect", daemon=True)

    def start(self) -> None:
        """Begin; called once all is made."""
        self._thread.start()

    @abstractmethod
    def take(self, number: int, image: NDArray[Any], pose: NDArray[Any]) -> None:
        """Be told of every photo that was integrated.

        Args:
            number: Of the photo.
            image: The photo, on the host; copied if it is kept.
            pose: Shape (4, 4).
        """

    def offer(self, result: LiveResult, surface: FocalSurface, gsd_m: float) -> None:
        """Hold on to what a picture shows, to be looked at, unless something is being looked at.

        Args:
            result: The picture; what is needed of it is copied.
            surface: That it was integrated onto.
            gsd_m: Its ground sampling distance [m/px].
        """
        with self._changed:
            if self._busy:
                self.skipped += 1
                return
            self._hold(result, surface, gsd_m)
            self._busy = True
            self._changed.notify_all()

    @abstractmethod
    def _hold(self, result: LiveResult, surface: FocalSurface, gsd_m: float) -> None:
        """Copy what is to be looked at."""

    @abstractmethod
    def _look(self, started_s: float) -> LiveFinds:
        """Look at what is held; called in the thread, with the time it began."""

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
                # kernels in this thread, at its priority: those of the integration come first
                with on_one_thread():
                    self.latest = self._look(start)
                self.times.add(self.latest.seconds)
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
        """End the thread after what it looks at."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()
