"""The whole chain on a flight of the paper's size, from files; beside it the paper's in OpenCV."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import hsvaos
from bench.harness import SMOKE, Contenders, size
from bench.peers import opencv, plane_homography
from hsvaos import Settings
from hsvaos.benchmark.scenes import lawnmower, photos
from hsvaos.flight import Flight, Frame
from hsvaos.formats.native_write import write_native

PHOTOS = 5 if SMOKE else 117
GAMMA = 0.6


@lru_cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """A flight on disk; it is gone when the program ends."""
    holder = tempfile.TemporaryDirectory(prefix="hsvaos-bench-")
    camera, poses, _ = lawnmower(PHOTOS, size(1024))
    frames = tuple(
        Frame(f"{k:04d}.jpg", Path(f"{k:04d}.jpg"), pose) for k, pose in enumerate(poses)
    )
    flight = Flight("bench", camera, frames, ground_down_m=0.0)
    write_native(flight, Path(holder.name) / "flight", images=photos(PHOTOS, size(1024)))
    return holder


def _papers_chain(flight: Flight) -> np.ndarray:
    """Decode, linear hue cut of 2 sigma, brighten, warp and average: the view of the middle."""
    pictures = []
    for frame in flight.frames:
        image = cv2.cvtColor(cv2.imread(str(frame.path)), cv2.COLOR_BGR2RGB)
        hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
        counts = cv2.calcHist([hsv], [0], None, [180], [0, 180]).ravel()
        levels = np.arange(180)
        mean = float((counts * levels).sum() / counts.sum())
        spread = float(np.sqrt((counts * (levels - mean) ** 2).sum() / counts.sum()))
        low, high = np.array([mean - 2.0 * spread]), np.array([mean + 2.0 * spread])
        kept = cv2.bitwise_not(cv2.inRange(hsv[..., 0], low, high))
        bright = cv2.LUT(image, _CURVE)
        pictures.append(cv2.merge([*cv2.split(cv2.bitwise_and(bright, bright, mask=kept)), kept]))
    view = flight.view(len(flight) // 2)
    matrix = flight.camera.matrix()
    ways = [plane_homography(matrix, view, pose, 0.0) for pose in flight.poses]
    return np.asarray(opencv(pictures, ways, flight.camera.width)())


_CURVE = np.rint(255.0 * np.linspace(0.0, 1.0, 256) ** GAMMA).astype(np.uint8)


def chain() -> Contenders:
    flight = hsvaos.open_flight(Path(_folder().name) / "flight")
    every = Settings().with_values(view={"frame": "all"})
    blind = Settings().with_values(detect={"enabled": False})
    return {
        "hsvaos.run, one view": lambda: hsvaos.run(flight),
        "hsvaos.run, one view, no detector": lambda: hsvaos.run(flight, blind),
        f"hsvaos.run, all {PHOTOS} views": lambda: hsvaos.run(flight, every),
        "OpenCV, the paper's form, one view, no detector": lambda: _papers_chain(flight),
    }


RACES: dict[str, Any] = {f"whole chain, {PHOTOS} RGB photos from JPEG files": chain}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic(RACES[contender[0]]()[contender[1]], rounds=1, warmup_rounds=1)
