"""Integral images against the NumPy twin, the plain kernel, OpenCV, numba and PyTorch."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import warp as wp

from bench.gpu_forms import FORMS
from bench.harness import Contenders, size
from bench.peers import GPU_PEERS, PEERS, opencv, plane_homography, premultiply
from hsvaos import FocalPlane, Integrator, reference
from hsvaos.benchmark.scenes import lawnmower, masks, photos

FRAMES = 12
FLIGHT = 117
"""Photos of the paper's mission."""


class Scene:
    """Photos with masks, poses and one view, for us and in the peers' best form."""

    def __init__(self, frames: int, side: int, view_side: int | None = None) -> None:
        self.camera, self.poses, self.view = lawnmower(frames, side, view_side)
        self.images, self.weights = photos(frames, side), masks(frames, side)
        self.surface = FocalPlane(0.0)
        self.side = self.view.width
        shape = (self.side, self.side)
        self.out = (np.empty((*shape, 3), np.float32), np.empty(shape, np.float32))

    def resident(self, device: Any, *, graph: bool = False) -> Any:
        """Photos resident on the device; a call ends when the picture is there.

        Args:
            device: Where.
            graph: Whether all launches of an integral are captured and replayed at once.
        """
        images = wp.array(self.images, dtype=wp.uint8, device=device)
        integrator = Integrator(self.camera, images, self.poses, self.weights)
        out = tuple(wp.array(part, dtype=float, device=device) for part in self.out)

        def launches() -> None:
            integrator.integrate(self.view, self.surface, out=out)

        if graph:
            launches()  # loads kernels, allocates what it keeps
            with wp.ScopedCapture(device) as capture:
                launches()

        def work() -> tuple[Any, Any]:
            if graph:
                wp.capture_launch(capture.graph)
            else:
                launches()
            wp.synchronize_device(device)
            return out[0], out[1]

        return work

    def ours(self) -> Any:
        integrator = Integrator(self.camera, self.images, self.poses, self.weights)
        return lambda: integrator.integrate(self.view, self.surface, out=self.out)

    def plain(self) -> Any:
        integrator = Integrator(self.camera, self.images, self.poses, self.weights)
        integrator._packed = None  # as if there were no packed form
        return lambda: integrator.integrate(self.view, self.surface, out=self.out)

    def peer(self, make: Any) -> Any:
        to_view = np.linalg.inv(self.camera.matrix()) @ self.view.camera.matrix()
        homographies = [
            plane_homography(self.camera.matrix(), self.view, pose, 0.0) @ np.linalg.inv(to_view)
            for pose in self.poses
        ]
        return make(premultiply(self.images, self.weights), homographies, self.side)

    def twin(self) -> Any:
        place = (self.camera, self.images, self.poses, self.view, self.surface)
        return lambda: reference.integrate(*place, self.weights)


def integral() -> Contenders:
    scene = Scene(FRAMES, size(1024))
    return {
        "hsvaos kernel": scene.ours(),
        "NumPy twin": scene.twin(),
        "OpenCV warpPerspective + accumulate": scene.peer(opencv),
    }


def flight() -> Contenders:
    scene = Scene(size(FLIGHT, 3), size(1024))
    contenders = {"hsvaos kernel": scene.ours()}
    contenders |= {name: scene.peer(make) for name, make in PEERS.items()}
    contenders["hsvaos plain kernel"] = scene.plain()
    return {name: work for name, work in contenders.items() if work is not None}


def flight_on_gpu() -> Contenders:
    scene = Scene(size(FLIGHT, 3), size(1024))
    device = wp.get_device("cuda:0")
    contenders = {
        "hsvaos kernel": scene.resident(device),
        "hsvaos kernel in a CUDA graph": scene.resident(device, graph=True),
    }
    contenders |= {name: make(scene, device) for name, make in FORMS.items()}
    contenders |= {name: scene.peer(make) for name, make in GPU_PEERS.items()}
    return {name: work for name, work in contenders.items() if work is not None}


def scaled(frames: int, side: int, view_side: int) -> Contenders:
    scene = Scene(size(frames, 2), size(side), size(view_side))
    return {
        "hsvaos kernel": scene.ours(),
        "OpenCV warpPerspective + accumulate": scene.peer(opencv),
    }


RACES: dict[str, Any] = {
    f"integral image, {FRAMES} RGB photos with masks": integral,
    f"integral image, {FLIGHT} RGB photos with masks": flight,
}
_BY_FRAMES = {
    frames: f"integral image 512 x 512, {frames} photos of 512 x 512"
    for frames in (1, 3, 10, 30, 100, 300, 1000)
}
_BY_PIXELS = {
    side: f"integral image {side} x {side}, 30 photos" for side in (128, 256, 512, 1024, 2048)
}
RACES |= {name: partial(scaled, frames, 512, 512) for frames, name in _BY_FRAMES.items()}
RACES |= {name: partial(scaled, 30, 1024, side) for side, name in _BY_PIXELS.items()}
_AS_JKU = {
    _BY_FRAMES[30]: (30 * 512 * 512, 110.0),
    "integral image, 10 RGB photos with masks": (10 * 1024 * 1024, 197.0),
}
RACES["integral image, 10 RGB photos with masks"] = partial(scaled, 10, 1024, 1024)
ELSEWHERE = {
    "JKU's renderer on software OpenGL": _AS_JKU,
}
"""Peers that do not run here: race -> samples (pixels x photos), and their CPU milliseconds of the
same sizes, measured once on a machine of this class with 2 cores."""
SCALINGS = {
    "photos of 512 x 512, to one integral of 512 x 512": _BY_FRAMES,
    "side of the integral [px], from 30 photos of 1024 x 1024": _BY_PIXELS,
}
GPU_RACES = {f"CUDA: integral image, {FLIGHT} RGB photos with masks": flight_on_gpu}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic((RACES | GPU_RACES)[contender[0]]()[contender[1]], rounds=3, warmup_rounds=1)
