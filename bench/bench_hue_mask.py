"""Hue statistics and mask against the NumPy twin and OpenCV."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from bench.data import photos
from bench.harness import Contenders, size
from hsvaos import hue_masks, reference
from hsvaos.hue_statistics import BINS, hue_statistics


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


RACES = {"hue statistics and mask, 1 photo": hue_cut}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark(RACES[contender[0]]()[contender[1]])
