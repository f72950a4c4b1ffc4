"""What the hardware can do at most: bytes a second of a large copy, samples a second from cache."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import warp as wp

from hsvaos.kernels.corners import read_corners
from hsvaos.kernels.device import threads

_COPIED = 1 << 28
"""Bytes of the large copy: far more than any cache of a processor holds."""

_SIDE = 64
"""Side of the picture that the sampling limit reads [px]: it stays in the nearest cache."""

_SEGMENT = 4096
_REPEATS = 64


@dataclass(frozen=True)
class Limits:
    """What nothing on this machine can beat, measured.

    Args:
        copy_gb_s: Bytes read and written a second by a large copy, all threads [GB/s].
        samples_g_s: Bilinear samples a second, where only the four corners are read, from the
            nearest cache, all threads [1e9/s].
    """

    copy_gb_s: float
    samples_g_s: float


@dataclass(frozen=True)
class Timing:
    """Seconds that a piece of work takes.

    Args:
        median_s: Median of the rounds.
        best_s: Least.
        rounds: Number of rounds.
    """

    median_s: float
    best_s: float
    rounds: int


def measure(work: Callable[[], object], device: Any, seconds: float, least: int = 3) -> Timing:
    """Time a piece of work until its time is used up; the call before it counts for nothing.

    Args:
        work: What to do; it may only launch on the device.
        device: Warp device, which is waited for.
        seconds: Time to spend.
        least: Rounds at least.
    """
    work()
    wp.synchronize_device(device)
    taken: list[float] = []
    while len(taken) < least or sum(taken) < seconds:
        start = perf_counter()
        work()
        wp.synchronize_device(device)
        taken.append(perf_counter() - start)
    return Timing(statistics.median(taken), min(taken), len(taken))


def measure_limits(device: Any, seconds: float = 0.5) -> Limits:
    """Measure what the hardware can do at most.

    Args:
        device: Warp device.
        seconds: Time for each of the two.
    """
    return Limits(_copy_gb_s(device, seconds), _samples_g_s(device, seconds))


def _copy_gb_s(device: Any, seconds: float) -> float:
    if device.is_cuda:
        source = wp.full(_COPIED, 1, dtype=wp.uint8, device=device)
        target = wp.zeros_like(source)
        best = measure(lambda: wp.copy(target, source), device, seconds).best_s
        return 2e-9 * _COPIED / best
    arrays = (np.zeros(_COPIED, np.uint8), np.ones(_COPIED, np.uint8))
    parts = list(zip(*(np.array_split(array, threads()) for array in arrays), strict=True))
    with ThreadPoolExecutor(threads()) as pool:

        def copy() -> None:
            list(pool.map(lambda part: np.copyto(*part), parts))

        return 2e-9 * _COPIED / measure(copy, device, seconds).best_s


def _samples_g_s(device: Any, seconds: float) -> float:
    """The gather without its arithmetic: places are known, and only the corners are read."""
    places = np.random.default_rng(0).integers(0, (_SIDE - 1) * _SIDE - 1, _SEGMENT)
    words = wp.zeros(_SIDE * _SIDE, dtype=wp.uint32, device=device)
    at: Any = wp.array(places.astype(np.int32), dtype=int, device=device)
    segments = 8 * threads() if device.is_cpu else 1 << 17
    sums = wp.zeros(segments, dtype=wp.uint64, device=device)
    repeats = _REPEATS if device.is_cpu else 1
    best = measure(lambda: read_corners(words, _SIDE, at, repeats, sums), device, seconds).best_s
    return 1e-9 * segments * _SEGMENT * repeats / best
