"""Photos from the host's memory to a picture on a GPU: ways of bringing them over.

The package brings photos over as they are decoded, which takes longer than any copy. Whoever has
them in memory may let copies run beside kernels; what that is worth is seen here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import warp as wp

from bench.bench_integrate import FLIGHT, Scene
from bench.harness import Contenders, size
from hsvaos import Integrator, hue_masks

BATCH = 9
"""Photos that are copied before their masks are made."""


def from_host(
    scene: Scene, device: Any, *, pinned: bool, beside: bool
) -> Callable[[], tuple[Any, Any]]:
    """Photos on the host; a call brings them over, cuts hues, integrates, and ends when that is
    done.

    Args:
        scene: Photos, poses and view.
        device: Where the kernels run.
        pinned: Whether the photos lie in memory that the device reads by itself.
        beside: Whether copies have a stream of their own; else kernels wait for them in turn.
    """
    host = wp.array(
        scene.images, dtype=wp.uint8, device="cpu", pinned=pinned and device.is_cuda, copy=True
    )
    images = wp.empty_like(host, device=device, pinned=False)
    masks = wp.empty(images.shape[:3], dtype=wp.uint8, device=device)
    integrator = Integrator(scene.camera, images, scene.poses, masks)
    out = tuple(wp.array(part, dtype=float, device=device) for part in scene.out)
    count = len(scene.images)
    parts = [slice(k, min(k + BATCH, count)) for k in range(0, count, BATCH)]
    copies = wp.Stream(device) if beside and device.is_cuda else None
    there = [wp.Event(device) for _ in parts] if copies else []

    def work() -> tuple[Any, Any]:
        if copies:
            for part, event in zip(parts, there, strict=True):
                wp.copy(images[part], host[part], stream=copies)
                copies.record_event(event)
        for k, part in enumerate(parts):
            if copies:
                wp.wait_event(there[k])
            else:
                wp.copy(images[part], host[part])
            hue_masks(images[part], out=masks[part])
        integrator.integrate(scene.view, scene.surface, out=out)
        wp.synchronize_device(device)
        return out[0], out[1]

    return work


WAYS = {
    "hsvaos, copies beside kernels": partial(from_host, pinned=True, beside=True),
    "hsvaos, pinned copies in turn": partial(from_host, pinned=True, beside=False),
    "hsvaos, plain copies in turn": partial(from_host, pinned=False, beside=False),
}


def flight_from_host() -> Contenders:
    scene = Scene(size(FLIGHT, 3), size(1024))
    device = wp.get_device("cuda:0")
    return {name: make(scene, device) for name, make in WAYS.items()}


GPU_RACES = {f"CUDA: upload, hue cut and integral, {FLIGHT} RGB photos": flight_from_host}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic(GPU_RACES[contender[0]]()[contender[1]], rounds=3, warmup_rounds=1)
