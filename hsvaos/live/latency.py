"""Latencies of a whole flight in fixed memory: a histogram with bins of one percent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEAST_S, _MOST_S = 1e-5, 1e3
_STEP = math.log(1.01)
_BINS = math.ceil(math.log(_MOST_S / _LEAST_S) / _STEP)

QUANTILES = (50.0, 95.0, 99.0)
"""Percentiles that are told."""


class Latencies:
    """Counts of latencies from 10 microseconds to 1000 seconds, and the greatest one."""

    def __init__(self) -> None:
        self._counts: NDArray[np.int64] = np.zeros(_BINS, np.int64)
        self.most_s = 0.0

    def add(self, seconds: float) -> None:
        """Count one latency [s]."""
        bin = int(math.log(max(seconds, _LEAST_S) / _LEAST_S) / _STEP)
        self._counts[min(bin, _BINS - 1)] += 1
        self.most_s = max(self.most_s, seconds)

    def __len__(self) -> int:
        return int(self._counts.sum())

    def clear(self) -> None:
        """Forget all."""
        self._counts[:] = 0
        self.most_s = 0.0

    def percentile(self, percent: float) -> float:
        """Return the latency that a share of all do not exceed, to one percent of itself [s].

        Args:
            percent: 0 to 100.

        Returns:
            NaN where nothing was counted.
        """
        total = len(self)
        if total == 0:
            return math.nan
        rank = max(1, math.ceil(percent / 100.0 * total))
        bin = int(np.searchsorted(np.cumsum(self._counts), rank))
        return min(_LEAST_S * math.exp((bin + 1) * _STEP), self.most_s)

    def to_dict(self) -> dict[str, Any]:
        """Return count, percentiles and maximum in milliseconds; None where there are none."""
        if len(self) == 0:
            return {"count": 0} | {f"p{q:.0f}_ms": None for q in QUANTILES} | {"max_ms": None}
        return (
            {"count": len(self)}
            | {f"p{q:.0f}_ms": round(1e3 * self.percentile(q), 2) for q in QUANTILES}
            | {"max_ms": round(1e3 * self.most_s, 2)}
        )
