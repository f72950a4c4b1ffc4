"""Rarity weights and levelling against the NumPy twins."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.harness import Contenders, size
from hsvaos import rarity_weights, reference
from hsvaos.benchmark.scenes import photos
from hsvaos.kernels.levels import channel_quantiles


def rarity() -> Contenders:
    images = photos(2, size(1024))
    out = np.empty(images.shape[:3], np.uint8)

    def twin() -> None:
        bins = reference.rarity_bins(images)
        counts = np.bincount(bins.ravel(), minlength=16000).reshape(10, 40, 40)
        table = reference.rarity_table(counts, 2e-4, 1.5, 1.0)
        np.rint(255.0 * table.ravel()[bins]).astype(np.uint8)

    return {"hsvaos kernels": lambda: rarity_weights(images, out=out), "NumPy twin": twin}


def levels() -> Contenders:
    images = photos(1, size(1024))
    return {
        "hsvaos kernel": lambda: channel_quantiles(images),
        "NumPy twin": lambda: reference.channel_quantiles(images[0], (0.25, 0.5, 0.75)),
    }


RACES = {"rarity weights, 2 photos": rarity, "exposure quartiles, 1 photo": levels}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark(RACES[contender[0]]()[contender[1]])
