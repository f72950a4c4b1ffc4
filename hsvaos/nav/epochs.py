"""When a filter stops to look at measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hsvaos.nav.log import SensorLog

Array = NDArray[np.float64]

MICRO = 1e-6
"""Epochs closer than this are one [s]."""


@dataclass(frozen=True, eq=False)
class Epochs:
    """The epochs of a log, and which measurements belong to each.

    A late measurement belongs to the time it speaks of, not to that of its stamp: in a recorded
    log this equals a filter that keeps a buffer and runs it again when a measurement comes in.

    Args:
        t_s: Shape (K,), increasing [s].
        gnss: Shape (K,), number of the fix of each epoch, -1 for none.
        baro: Shape (K,), number of the baro sample of each epoch, -1 for none.
        left_out: Measurements that lie outside the IMU log, by sensor.
    """

    t_s: Array
    gnss: NDArray[np.int64]
    baro: NDArray[np.int64]
    left_out: dict[str, int]


def epochs_of(
    log: SensorLog,
    start_s: float,
    stop_s: float,
    *,
    gnss_latency_s: float = 0.0,
    baro_latency_s: float = 0.0,
    max_step_s: float = 0.1,
) -> Epochs:
    """Return the epochs of a log from `start_s` to `stop_s`.

    Args:
        log: The log.
        start_s: First epoch [s].
        stop_s: Last epoch [s].
        gnss_latency_s: How late fixes are stamped [s].
        baro_latency_s: How late baro samples are stamped [s].
        max_step_s: Epochs without measurement are put in where others are farther apart [s].
    """

    def ticks(t: Array) -> NDArray[np.int64]:
        return np.round((t - start_s) / MICRO).astype(np.int64)

    end = int(ticks(np.array([stop_s]))[0])
    found: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
    left_out = {}
    for sensor, times, latency in (
        ("gnss", None if log.gnss is None else log.gnss.t_s, gnss_latency_s),
        ("baro", None if log.baro is None else log.baro.t_s, baro_latency_s),
    ):
        when = ticks(np.zeros(0) if times is None else times - latency)
        inside = np.flatnonzero((when >= 0) & (when <= end))
        found[sensor] = when[inside], inside
        left_out[sensor] = len(when) - len(inside)
    stops = np.unique(np.concatenate([[0, end], found["gnss"][0], found["baro"][0]]))
    pieces = np.maximum(1, np.ceil(np.diff(stops) * MICRO / max_step_s - 1e-6)).astype(np.int64)
    if pieces.max() > 1:
        # stop k, then the inner points of the span to stop k + 1
        span = np.repeat(np.diff(stops), pieces)
        within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        inner = np.repeat(stops[:-1], pieces) + span * within // np.repeat(pieces, pieces)
        stops = np.append(inner, end)
    numbers = {}
    for sensor, (when, index) in found.items():
        number = np.full(len(stops), -1, dtype=np.int64)
        number[np.searchsorted(stops, when)] = index
        numbers[sensor] = number
    return Epochs(start_s + stops * MICRO, numbers["gnss"], numbers["baro"], left_out)
