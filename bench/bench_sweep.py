"""Focal stack and focus measure against the NumPy twins."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.data import lawnmower, photos
from bench.harness import Contenders, size
from hsvaos import FocalPlane, Integrator, focus_measure, reference

FRAMES, PLANES = 6, 4


def focal_stack() -> Contenders:
    side = size(512)
    camera, poses, view = lawnmower(FRAMES, side)
    images = photos(FRAMES, side)
    integrator = Integrator(camera, images, poses)
    downs = np.linspace(-3.0, 0.0, PLANES)
    return {
        "hsvaos kernel": lambda: integrator.sweep(view, downs),
        "NumPy twin": lambda: [
            reference.integrate(camera, images, poses, view, FocalPlane(down)) for down in downs
        ],
    }


def focus() -> Contenders:
    side = size(128)  # the twin loops over pixels in Python
    stack = np.random.default_rng(0).random((1, side, side, 1)).astype(np.float32)
    cover = np.ones(stack.shape[:3], np.float32)
    return {
        "hsvaos kernel": lambda: focus_measure(stack, cover),
        "NumPy twin": lambda: reference.focus_measure(stack[0], cover[0], "kurtosis", 2, 12),
    }


RACES = {
    f"focal stack, {PLANES} planes, {FRAMES} photos": focal_stack,
    "focus measure, 128 x 128 px": focus,
}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic(RACES[contender[0]]()[contender[1]], rounds=3, warmup_rounds=1)
