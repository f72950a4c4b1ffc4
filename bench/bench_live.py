"""One photo more: into the window and out as an integral image, against starting anew."""

from __future__ import annotations

from functools import partial
from itertools import count
from typing import Any

import numpy as np

from bench.harness import Contenders, size
from bench.peers import opencv, plane_homography, premultiply
from hsvaos import FocalPlane, Integrator, VirtualCamera
from hsvaos.benchmark.scenes import lawnmower, photos
from hsvaos.kernels.hue_mask import apply_hue_cut, measure_hue
from hsvaos.live.ring import Format, Out
from hsvaos.live.window import Window
from hsvaos.settings import MaskSettings

WINDOW = 30


class Scene:
    """A flight that goes on and on, and what is made of its next photo."""

    def __init__(self, side: int, view_side: int, window: int) -> None:
        self.camera, self.poses, view = lawnmower(2 * window, side, view_side)
        self.images = photos(8, side)
        self.view, self.window = view, window
        self.surface = FocalPlane(0.0)

    def ours(self, method: str, moving: bool) -> Any:
        mask = MaskSettings(method=method, scope="flight")
        window = Window(Format(self.camera), self.window, self.view.size, mask)
        out = Out.empty(self.view.size, 3, window.device)
        turn = count()

        def work() -> None:
            i = next(turn)
            pose = self.poses[i % len(self.poses)]
            view = VirtualCamera(self.view.camera, pose) if moving else self.view
            window.step(self.images[i % 8], pose, view, self.surface, out)

        for _ in range(self.window + 1):
            work()
        return work

    def anew(self) -> Any:
        """A fresh integrator of all photos, masked before; the newest is masked each time."""
        images = np.stack([self.images[i % 8] for i in range(self.window)])
        stats, _ = measure_hue(images, scope="flight")
        masks = apply_hue_cut(images, stats)
        poses = self.poses[: self.window]

        def work() -> None:
            newest = measure_hue(images[-1:])[0]
            apply_hue_cut(images[-1:], newest, out=masks[-1:])
            Integrator(self.camera, images, poses, masks).integrate(self.view, self.surface)

        return work

    def opencv(self) -> Any:
        """OpenCV's loop over all photos, premultiplied before, without the mask's time."""
        images = np.stack([self.images[i % 8] for i in range(self.window)])
        weights = np.full(images.shape[:3], 255, np.uint8)
        to_view = np.linalg.inv(self.camera.matrix()) @ self.view.camera.matrix()
        homographies = [
            plane_homography(self.camera.matrix(), self.view, pose, 0.0) @ np.linalg.inv(to_view)
            for pose in self.poses[: self.window]
        ]
        return opencv(premultiply(images, weights), homographies, self.view.width)


def one_more(side: int, view_side: int, window: int) -> Contenders:
    scene = Scene(size(side), size(view_side), size(window, 3))
    return {
        "hsvaos live, hue cut, moving view": scene.ours("hue", True),
        "hsvaos live, hue cut, fixed view": scene.ours("hue", False),
        "hsvaos live, no mask, moving view": scene.ours("none", True),
        "hsvaos live, no mask, fixed view": scene.ours("none", False),
        "hsvaos live, rarity, moving view": scene.ours("rarity", True),
        "hsvaos Integrator anew, hue cut": scene.anew(),
        "OpenCV warpPerspective + accumulate, all photos, no mask": scene.opencv(),
    }


RACES: dict[str, Any] = {
    f"one photo more of {side} x {side}, window of {window}, picture {view} x {view}": partial(
        one_more, side, view, window
    )
    for side, view, window in ((1024, 512, WINDOW), (1024, 1024, WINDOW))
}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic(RACES[contender[0]]()[contender[1]], rounds=5, warmup_rounds=1)
