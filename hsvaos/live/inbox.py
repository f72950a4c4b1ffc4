"""Photos that wait for the integrator: a bounded queue in fixed memory that drops the oldest."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(eq=False)
class Arrival:
    """A photo that waits.

    Args:
        image: Memory of the photo.
        number: Number of the photo, from 0.
        pose: Shape (4, 4), or None where the navigator is to say.
        t_s: Its time [s].
        arrived_s: When it came, on the monotonic clock [s].
    """

    image: NDArray[Any]
    number: int = -1
    pose: NDArray[np.float64] | None = None
    t_s: float = float("nan")
    arrived_s: float = 0.0


class Inbox:
    """Photos between the thread that brings them and the one that integrates them.

    Args:
        waiting: Most photos that wait; the oldest is dropped for one more.
        memory: Returns memory for one photo.

    Raises:
        ValueError: If none may wait.
    """

    def __init__(self, waiting: int, memory: Callable[[], NDArray[Any]]) -> None:
        if waiting < 1:
            raise ValueError(f"waiting must be at least 1 photo, got {waiting!r}")
        # one more is being filled and one is being integrated
        self._free = [Arrival(memory()) for _ in range(waiting + 2)]
        self._most = waiting
        self._waiting: deque[Arrival] = deque()
        self._changed = threading.Condition()
        self._filling = threading.Lock()
        self._taken = 0
        self.closed = False
        self.arrived = self.dropped = 0

    def put(
        self, image: NDArray[Any], pose: NDArray[np.float64] | None, t_s: float, arrived_s: float
    ) -> int:
        """Copy a photo into the queue; return its number.

        Raises:
            ValueError: If the queue was closed.
        """
        with self._filling:
            with self._changed:
                if self.closed:
                    raise ValueError("the live integrator was closed: it takes no more photos")
                if len(self._waiting) == self._most:
                    self._free.append(self._waiting.popleft())
                    self.dropped += 1
                arrival = self._free.pop()
                number = self.arrived
                self.arrived += 1
            np.copyto(arrival.image, image)
            arrival.number, arrival.pose = number, pose
            arrival.t_s, arrival.arrived_s = t_s, arrived_s
            with self._changed:
                self._waiting.append(arrival)
                self._changed.notify_all()
        return number

    def take(self) -> Arrival | None:
        """Wait for the oldest photo; None where the queue was closed."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or self._waiting)
            if self.closed:
                return None
            self._taken += 1
            return self._waiting.popleft()

    def give_back(self, arrival: Arrival) -> None:
        """Say that a photo that was taken is done with."""
        with self._changed:
            self._free.append(arrival)
            self._taken -= 1
            self._changed.notify_all()

    def drain(self, timeout_s: float | None = None) -> bool:
        """Wait until no photo waits or is at work; return whether that came to be."""
        with self._changed:
            idle = self._changed.wait_for(
                lambda: self.closed or not (self._waiting or self._taken), timeout_s
            )
            return bool(idle)

    def close(self) -> None:
        """Take no more photos, and let those that wait go."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()
