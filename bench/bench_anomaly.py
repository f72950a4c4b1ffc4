"""RX distances and masks against the NumPy twin."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.harness import Contenders, size
from hsvaos import reference, rx_masks
from hsvaos.benchmark.scenes import photos


def rx() -> Contenders:
    images = photos(1, size(1024))
    out = np.empty(images.shape[:3], np.uint8)

    def twin() -> None:
        distances = reference.rx_distances(images[0])
        (distances > np.quantile(distances, 0.99)).astype(np.uint8)

    return {"hsvaos kernels": lambda: rx_masks(images, out=out), "NumPy twin": twin}


RACES = {"RX mask, 1 photo": rx}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark(RACES[contender[0]]()[contender[1]])
