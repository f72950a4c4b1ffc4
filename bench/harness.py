"""Benchmarks as races: contenders on the same work, by name, first ours, then the peers."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable
from time import perf_counter

SMOKE = os.environ.get("HSVAOS_BENCH") == "smoke"
"""Whether only to see that everything runs: tiny pictures, one round."""

Contenders = dict[str, Callable[[], object]]


def size(full: int, smoke: int = 48) -> int:
    """Side of the pictures of a race."""
    return smoke if SMOKE else full


def race(contenders: Contenders, rounds: int) -> dict[str, float]:
    """Median seconds of each contender; they take turns, so that noise hits all of them."""
    for contender in contenders.values():
        contender()  # compiles, fills caches
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, contender in contenders.items():
            start = perf_counter()
            contender()
            seconds[name].append(perf_counter() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}
