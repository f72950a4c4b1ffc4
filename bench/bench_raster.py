"""Seconds a simulated photo of 1024 x 1024 takes, by season and detail.

    pytest bench/bench_raster.py -o addopts=
    python bench/bench_raster.py          CPU seconds (all threads) and peak memory, as a table

Photos are drawn by one thread each, so wall and CPU seconds of one photo agree on a quiet machine.
"""

from __future__ import annotations

import os
import resource
import sys
import time

import numpy as np
import pytest
import warp as wp

from hsvaos.camera import Camera
from hsvaos.kernels.device import quiet_start
from hsvaos.simulate.buffers import ray_table
from hsvaos.simulate.forest import ForestSettings, grow_forest
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.photo import CameraEffects, expose
from hsvaos.simulate.scene import Scene

SMOKE = os.environ.get("HSVAOS_BENCH") == "smoke"
SIZE = 64 if SMOKE else 1024
CAMERA = Camera.from_fov(SIZE, SIZE, 90.0)
POSE = Mission(photos=117).poses()[58]
CASES = [("summer", "light"), ("fall", "light"), ("snow", "light"), ("summer", "heavy")]


def build(season: str, detail: str, device: str) -> tuple[Scene, object]:
    wanted = ForestSettings(season=season, detail=detail, seed=1)
    if SMOKE:
        wanted = wanted.replace(half_m=8.0)
    scene = grow_forest(wanted).scene(device=device)
    scene.prepare()
    return scene, ray_table(CAMERA, device)


def take(scene: Scene, rays: object) -> np.ndarray:
    keys = scene.keys(CAMERA, POSE, rays)
    light = scene.radiance(CAMERA, POSE, rays, keys)
    rgb = np.ascontiguousarray(light[..., :3])
    return expose(rgb, CameraEffects(), 1.0, np.array([0.1, -0.3]), np.random.default_rng(0))


def devices() -> list[str]:
    return ["cpu"] + (["cuda:0"] if wp.is_cuda_available() else [])


@pytest.mark.parametrize("device", devices())
@pytest.mark.parametrize(("season", "detail"), CASES)
def test_photo(benchmark: object, season: str, detail: str, device: str) -> None:
    scene, rays = build(season, detail, device)
    take(scene, rays)
    photo = benchmark.pedantic(take, (scene, rays), rounds=5)  # type: ignore[attr-defined]
    assert photo.std() > 10.0


def table() -> None:
    print(
        "device  season  detail  patches  scene CPU s  keys  shading  camera  photo CPU s  peak GB"
    )
    for device in devices():
        for season, detail in CASES:
            started = time.process_time()
            scene, rays = build(season, detail, device)
            built = time.process_time() - started
            take(scene, rays)
            parts = []
            for _ in range(5):
                t0 = time.process_time()
                keys = scene.keys(CAMERA, POSE, rays)
                wp.synchronize_device(device)
                t1 = time.process_time()
                light = scene.radiance(CAMERA, POSE, rays, keys)
                t2 = time.process_time()
                expose(
                    np.ascontiguousarray(light[..., :3]),
                    CameraEffects(),
                    1.0,
                    np.array([0.1, -0.3]),
                    np.random.default_rng(0),
                )
                parts.append((t1 - t0, t2 - t1, time.process_time() - t2))
            middle = np.median(parts, axis=0)
            patches = sum(len(scene.instances.meshes[m]) for m in scene.instances.mesh)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            print(
                f"{device:7} {season:7} {detail:6} {patches / 1e6:6.2f} M {built:10.1f} "
                f"{middle[0]:7.2f} {middle[1]:7.2f} {middle[2]:7.2f} {middle.sum():10.2f} "
                f"{peak:10.2f}"
            )
            del scene, rays


if __name__ == "__main__":
    if len(sys.argv) > 1:
        CASES = [tuple(word.split(",")) for word in sys.argv[1:]]  # type: ignore[misc]
    quiet_start()
    table()
