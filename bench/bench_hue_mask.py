"""Hue statistics and mask against the NumPy twin and OpenCV."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from bench.harness import Contenders, size
from hsvaos import hue_masks, reference
from hsvaos.benchmark.scenes import photos
from hsvaos.hue_statistics import BINS, hue_statistics
from hsvaos.kernels.device import threads
from hsvaos.kernels.hue_mask import measure_hue
from hsvaos.kernels.hue_pack import cut_and_pack


def hue_cut() -> Contenders:
    images = photos(1, size(1024))
    out = np.empty(images.shape[:3], np.uint8)

    def twin() -> None:
        histogram, chroma = reference.hue_histogram(images[0], BINS, "circular")
        stats = hue_statistics(histogram, chroma)
        away = reference.hue_distance(images, stats.mean_deg, "circular")
        (away > 2.0 * stats.sigma_deg).astype(np.uint8)

    def opencv() -> None:  # 8 bit, unweighted, linear: less work than ours
        hue = cv2.cvtColor(images[0], cv2.COLOR_RGB2HSV)[..., 0]
        counts = cv2.calcHist([hue], [0], None, [180], [0, 180]).ravel()
        levels = np.arange(180)
        mean = (counts * levels).sum() / counts.sum()
        sigma = np.sqrt((counts * (levels - mean) ** 2).sum() / counts.sum())
        low, high = float(mean - 2 * sigma), float(mean + 2 * sigma)
        cv2.bitwise_not(cv2.inRange(hue, np.array([low]), np.array([high])))

    return {
        "hsvaos kernels": lambda: hue_masks(images, out=out),
        "NumPy twin": twin,
        "OpenCV 8 bit, linear": opencv,
    }


def one_pass() -> Contenders:
    images = photos(1, size(1024))
    stats, _ = measure_hue(images)
    masks, packed = cut_and_pack(images, stats)
    bright = {"target_value": 0.25, "gamma": 0.6, "max_gain": 3.0}
    out = np.empty_like(images[0])
    cv2.setNumThreads(threads())

    def ours(brightening: Any) -> Any:
        return lambda: cut_and_pack(
            images, stats, brightening=brightening, out=masks, photos=packed
        )

    return {
        "hsvaos HSV + mask + pack": ours(None),
        "hsvaos HSV + mask + brighten + pack": ours(bright),
        "OpenCV cvtColor alone, 8 bit": lambda: cv2.cvtColor(images[0], cv2.COLOR_RGB2HSV, out),
    }


RACES = {
    "hue statistics and mask, 1 photo": hue_cut,
    "HSV, mask and packing in one pass, 1 photo": one_pass,
}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark(RACES[contender[0]]()[contender[1]])
