"""What CUDA runs allocates nothing once it has run, so that a graph can hold it."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import warp as wp

from hsvaos import Camera, FocalPlane, Integrator, VirtualCamera
from hsvaos.kernels.scratch import scratch
from hsvaos.live.ring import Format, Out
from hsvaos.live.window import Window
from hsvaos.settings import MaskSettings
from hsvaos.surface import FocalSurface
from tests.kernels.test_portable import CAMERA, scene, terrain, view_from

SURFACES = [FocalPlane(), FocalPlane(point=(0, 0, 1), normal=(0.1, 0, 1)), terrain()]


@pytest.fixture(autouse=True)
def portable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HSVAOS_PORTABLE", "1")


def allocated(work: Callable[[], Any]) -> list[str]:
    """Lines that Warp reports of what was allocated meanwhile, by device."""
    with wp.ScopedMemoryTracker(print=False) as tracker:
        tracker.clear()  # its totals are those of the process
        work()
        report = io.StringIO()
        tracker.report(file=report)
    return [line for line in report.getvalue().splitlines() if "cpu" in line or "cuda" in line]


def work_of(device: str) -> tuple[Integrator, VirtualCamera, tuple[Any, Any], Any]:
    images, masks, poses = scene()
    held = wp.array(images, dtype=wp.uint8, device=device)
    view = view_from(poses)
    shape = (view.height, view.width)
    out = [wp.zeros(size, dtype=float, device=device) for size in ((*shape, 3), shape)]
    return Integrator(CAMERA, held, poses, masks), view, (out[0], out[1]), held


def test_the_tracker_sees_allocations() -> None:
    assert allocated(lambda: wp.zeros(10, dtype=float, device="cpu"))


@pytest.mark.parametrize("surface", SURFACES, ids=["level", "tilted", "terrain"])
def test_an_integral_allocates_nothing(device: str, surface: FocalSurface) -> None:
    integrator, view, out, _ = work_of(device)
    other = VirtualCamera(Camera.from_fov(40, 36, 60.0), integrator.world_from_camera[1])
    for work in (integrator.integrate, integrator.coherence):
        work(view, surface, out=out)
        assert not allocated(lambda work=work: work(other, surface, out=out))
        assert not allocated(lambda work=work: work(view, surface, frames=[1, 2, 3], out=out))


@pytest.mark.parametrize("surface", SURFACES, ids=["level", "tilted", "terrain"])
def test_an_integral_fits_into_a_graph(device: str, surface: FocalSurface) -> None:
    integrator, view, out, held = work_of(device)
    integrator.integrate(view, surface, out=out)
    image, footprint = (part.numpy().copy() for part in out)
    with wp.ScopedCapture(device) as capture:
        integrator.integrate(view, surface, out=out)
    held.fill_(7)
    out[0].zero_()
    # what comes in between in this thread uses the same scratch
    small = (wp.zeros((6, 8, 3), dtype=float, device=device), wp.zeros((6, 8), device=device))
    elsewhere = VirtualCamera(Camera.from_fov(8, 6, 50.0), integrator.world_from_camera[0])
    integrator.integrate(elsewhere, FocalPlane(2.0), out=small)
    wp.capture_launch(capture.graph)
    seen = footprint > 0.0
    assert np.ptp(image[seen]) > 50.0
    np.testing.assert_allclose(out[0].numpy()[seen], 7.0, rtol=1e-5)
    np.testing.assert_array_equal(out[1].numpy(), footprint)


@pytest.mark.parametrize("method", ["none", "hue", "rarity"])
@pytest.mark.parametrize("moving", [False, True], ids=["resting", "moving"])
def test_a_live_photo_allocates_nothing(device: str, method: str, moving: bool) -> None:
    images, _, poses = scene()
    views = [VirtualCamera(Camera.from_fov(40, 36, 50.0), pose) for pose in poses]
    window = Window(Format(CAMERA), 3, (40, 36), MaskSettings(method=method), device=device)
    out = Out.empty((40, 36), 3, window.device)
    surface = FocalPlane()

    def photo(k: int) -> None:
        window.step(images[k], poses[k], views[k if moving else 0], surface, out)
        out.numpy()

    for k in range(5):
        photo(k)
    assert not allocated(lambda: [photo(k) for k in range(5)])


def test_threads_have_memory_of_their_own() -> None:
    cpu = wp.get_device("cpu")
    own = scratch("test", 5, wp.float32, cpu)
    others: list[Any] = []
    thread = threading.Thread(target=lambda: others.append(scratch("test", 5, wp.float32, cpu)))
    thread.start()
    thread.join()
    assert own.ptr != others[0].ptr
    assert scratch("test", 8, wp.float32, cpu).ptr == own.ptr
    assert scratch("test", 9, wp.float32, cpu).ptr != own.ptr
    assert scratch("test", 5, wp.float32, cpu).shape == (5,)
