from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.live.latency import Latencies


@given(st.lists(st.floats(1e-4, 100.0), min_size=1, max_size=200), st.floats(0.0, 100.0))
def test_percentiles_are_true_to_a_percent(seconds: list[float], percent: float) -> None:
    latencies = Latencies()
    for one in seconds:
        latencies.add(one)
    exact = np.percentile(seconds, percent, method="inverted_cdf")
    assert exact * 0.999 <= latencies.percentile(percent) <= exact * 1.011
    assert len(latencies) == len(seconds)
    assert latencies.to_dict()["max_ms"] == pytest.approx(1e3 * max(seconds), abs=0.006)


def test_the_ends_of_the_scale_hold_what_lies_beyond() -> None:
    latencies = Latencies()
    assert math.isnan(latencies.percentile(50.0))
    latencies.add(0.0)
    latencies.add(1e9)
    assert latencies.percentile(0.0) < 1.1e-5
    assert latencies.percentile(100.0) == pytest.approx(1e3, rel=0.02)
    latencies.clear()
    assert len(latencies) == 0
