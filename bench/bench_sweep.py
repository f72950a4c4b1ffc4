"""Focal stack and focus measure against the NumPy twins."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from bench.harness import Contenders, size
from bench.peers import opencv, plane_homography, premultiply
from hsvaos import FocalPlane, Integrator, focus_measure, reference
from hsvaos.benchmark.scenes import lawnmower, masks, photos

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


def deep_stack(count: int) -> Contenders:
    side, frames = size(512), size(30, 2)
    camera, poses, view = lawnmower(frames, side)
    images, weights = photos(frames, side), masks(frames, side)
    integrator = Integrator(camera, images, poses, weights)
    downs = np.linspace(-3.0, 0.0, count)
    shape = (len(downs), side, side)
    out = (np.empty((*shape, 3), np.float32), np.empty(shape, np.float32))
    ready = premultiply(images, weights)
    planes = [
        opencv(ready, [plane_homography(camera.matrix(), view, pose, down) for pose in poses], side)
        for down in downs
    ]
    return {
        "hsvaos kernel": lambda: integrator.sweep(view, downs, out=out),
        "OpenCV warpPerspective + accumulate": lambda: [plane() for plane in planes],
    }


def focus() -> Contenders:
    side = size(128)  # the twin loops over pixels in Python
    stack = np.random.default_rng(0).random((1, side, side, 1)).astype(np.float32)
    cover = np.ones(stack.shape[:3], np.float32)
    return {
        "hsvaos kernel": lambda: focus_measure(stack, cover),
        "NumPy twin": lambda: reference.focus_measure(stack[0], cover[0], "kurtosis", 2, 12),
    }


_BY_PLANES = {
    count: f"focal stack, {count} planes 512 x 512, 30 photos 512 x 512 with masks"
    for count in (1, 4, 8, 32, 64)
}
RACES: dict[str, Any] = {
    name: partial(deep_stack, size(count, min(count, 9))) for count, name in _BY_PLANES.items()
}
RACES |= {
    f"focal stack, {PLANES} planes, {FRAMES} photos": focal_stack,
    "focus measure, 128 x 128 px": focus,
}
SCALINGS = {"planes of 512 x 512, from 30 photos of 512 x 512": _BY_PLANES}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic(RACES[contender[0]]()[contender[1]], rounds=3, warmup_rounds=1)
