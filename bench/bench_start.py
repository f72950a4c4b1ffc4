"""Cold start: a new process until the names are there, and until the first picture is.

The kernel cache is warm. CPU seconds of the whole process; the interpreter alone is the yardstick.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Any

from bench.harness import SMOKE, Contenders, size

_FIRST = """
import numpy as np, hsvaos
camera = hsvaos.Camera.from_fov({side}, {side}, 90.0)
poses = np.tile(np.eye(4), (10, 1, 1))
poses[:, 0, 3], poses[:, 2, 3] = np.arange(10), -20.0
images = np.full((10, {side}, {side}, 3), 9, np.uint8)
integrator = hsvaos.Integrator(camera, images, poses)
view = hsvaos.VirtualCamera(camera, poses[5])
image, footprint = integrator.integrate(view, hsvaos.FocalPlane(0.0))
if not image.max() == 9.0: raise SystemExit("wrong picture")
"""


def process(*options: str) -> Callable[[], object]:
    """Work: run Python to its end."""
    return lambda: subprocess.run([sys.executable, *options], check=True, capture_output=True)


def start() -> Contenders:
    return {
        "import hsvaos": process("-c", "import hsvaos"),
        "import hsvaos, first integral of 10 photos": process("-c", _FIRST.format(side=size(1024))),
        "hsvaos --help": process("-m", "hsvaos", "--help"),
        "Python alone": process("-c", "pass"),
        "import numpy, warp, cv2": process("-c", "import numpy, warp, cv2"),
    }


RACES: dict[str, Callable[[], Contenders]] = {"cold start, kernels in the cache": start}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark.pedantic(RACES[contender[0]]()[contender[1]], rounds=1 if SMOKE else 3)
