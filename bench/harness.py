"""Benchmarks as races: contenders on the same work, by name, first ours, then the peers.

A module of this folder defines RACES, by name; GPU_RACES, which need CUDA; and SCALINGS, tables of
races of growing size: title -> what grows -> name of the race.
"""

from __future__ import annotations

import os
import resource
import statistics
from collections.abc import Callable
from time import perf_counter, process_time

SMOKE = os.environ.get("HSVAOS_BENCH") == "smoke"
"""Whether only to see that everything runs: tiny pictures, one round."""

Contenders = dict[str, Callable[[], object]]
Clock = Callable[[], float]

wall_clock: Clock = perf_counter


def cpu_clock() -> float:
    """CPU seconds of all threads of this process, and of the processes it started that ended.

    On a machine that others use too this says what work costs; the wall says who else was there.
    """
    started = resource.getrusage(resource.RUSAGE_CHILDREN)
    return process_time() + started.ru_utime + started.ru_stime


def size(full: int, smoke: int = 48) -> int:
    """Side of the pictures of a race."""
    return smoke if SMOKE else full


def race(contenders: Contenders, rounds: int, clock: Clock = cpu_clock) -> dict[str, float]:
    """Median seconds of each contender; they take turns, so that noise hits all of them."""
    for contender in contenders.values():
        contender()  # compiles, fills caches
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, contender in contenders.items():
            start = clock()
            contender()
            seconds[name].append(clock() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}
