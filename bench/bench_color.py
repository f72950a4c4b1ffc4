"""RGB -> HSV and brightening against the NumPy twin and OpenCV."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from bench.harness import Contenders, size
from hsvaos import brighten, reference, rgb_to_hsv
from hsvaos.benchmark.scenes import masks, photos


def hsv() -> Contenders:
    images = photos(1, size(1024))
    scaled = images[0].astype(np.float32) / 255.0
    out = np.empty(images.shape, np.float32)
    return {
        "hsvaos kernel": lambda: rgb_to_hsv(images, out=out),
        "NumPy twin": lambda: reference.rgb_to_hsv(images),
        "OpenCV cvtColor float32": lambda: cv2.cvtColor(scaled, cv2.COLOR_RGB2HSV),
    }


def brightening() -> Contenders:
    images, keep = photos(1, size(1024)), masks(1, size(1024))
    out = np.empty_like(images)
    return {
        "hsvaos kernel": lambda: brighten(images, keep, out=out),
        "NumPy twin": lambda: reference.brighten(images, keep, 0.25, 0.6, 3.0),
    }


RACES = {"RGB to HSV, 1 photo": hsv, "brighten, 1 photo": brightening}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark(RACES[contender[0]]()[contender[1]])
