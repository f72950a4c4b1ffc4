"""The live integrator as its users drive it: threads, drops, detector, navigator, faults."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest

from hsvaos import Camera, Detections, FocalPlane, Integrator, LiveIntegrator, VirtualCamera
from hsvaos.live.integrator import following
from hsvaos.live.result import LiveResult
from hsvaos.nav.error_state_ekf import ErrorStateEkf
from hsvaos.nav.online import OnlineFilter
from hsvaos.settings import MaskSettings
from tests.kernels.test_tiles import decibel
from tests.live.conftest import Strip
from tests.nav.conftest import *  # noqa: F403 - its fixtures
from tests.nav.models import BARO, GNSS, IMU
from tests.nav.test_online import events, feed


def fresh(strip: Strip, first: int, last: int, view: VirtualCamera) -> Any:
    part = slice(first, last)
    made = Integrator(strip.camera, strip.images[part], strip.poses[part])
    return made.integrate(view, strip.surface)


def test_it_follows_the_photos_and_equals_a_fresh_integrator(device: str, strip: Strip) -> None:
    with LiveIntegrator(strip.camera, frames=4, size=64, mask="none", device=device) as live:
        assert live.latest() is None
        for i in range(9):
            assert live.push(strip.images[i], strip.poses[i], t_s=0.1 * i) == i
            assert live.drain(60.0)
        result = live.latest()
        assert result is not None
        assert (result.number, result.t_s, result.frames) == (8, pytest.approx(0.8), 4)
        assert result.latency_s > 0.0
        view = VirtualCamera(following(strip.camera, 64), strip.poses[8])
        image, footprint = fresh(strip, 5, 9, view)
        assert decibel(result.image, image, 255.0) > 60.0
        np.testing.assert_allclose(result.footprint, footprint, atol=2e-3)
        stats = live.stats()
        assert (stats.arrived, stats.integrated, stats.dropped) == (9, 9, 0)
        assert stats.latency["count"] == 9
        assert live.recent_latency()["count"] == 9
        assert live.recent_latency() == {
            "count": 0, "p50_ms": None, "p95_ms": None, "p99_ms": None, "max_ms": None
        }  # fmt: skip


def test_the_view_may_rest_move_and_follow(strip: Strip) -> None:
    same_size = VirtualCamera(following(strip.camera, 64), strip.poses[5])
    with LiveIntegrator(strip.camera, frames=3, size=64, mask="none") as live:
        shown: VirtualCamera | None = None
        for i in range(12):
            if i in (3, 9):
                shown = same_size if i == 3 else None
                live.look(shown)
            if i == 7:
                live.look(shown, FocalPlane(1.0))
            live.push(strip.images[i], strip.poses[i])
            assert live.drain(60.0)
            result = live.latest()
            assert result is not None
            view = shown or VirtualCamera(following(strip.camera, 64), strip.poses[i])
            surface = FocalPlane(1.0 if i >= 7 else 0.0)
            part = slice(max(0, i - 2), i + 1)
            twin = Integrator(strip.camera, strip.images[part], strip.poses[part])
            assert decibel(result.image, twin.integrate(view, surface)[0], 255.0) > 60.0
        with pytest.raises(ValueError, match="view must have the size"):
            live.look(VirtualCamera(Camera.from_fov(9, 9, 50), strip.poses[0]))
        with pytest.raises(TypeError, match="surface must be"):
            live.look(None, 3.0)  # type: ignore[arg-type]
    resting = LiveIntegrator(strip.camera, view=strip.view, mask="none")
    with resting, pytest.raises(ValueError, match="cannot follow"):
        resting.look(None)


def test_what_is_too_much_is_dropped_and_counted(strip: Strip) -> None:
    """While a photo is at work, of those that come only the newest ones wait."""
    started, go = threading.Event(), threading.Event()

    def hold(result: LiveResult) -> None:
        started.set()
        go.wait(60.0)

    with LiveIntegrator(
        strip.camera, frames=30, size=64, mask="none", waiting=2, on_result=hold
    ) as live:
        live.push(strip.images[0], strip.poses[0])
        assert started.wait(60.0)
        for i in range(1, 10):
            live.push(strip.images[i], strip.poses[i])
        assert live.stats().dropped == 7
        go.set()
        assert live.drain(60.0)
        result = live.latest()
        assert result is not None
        assert (result.number, result.frames) == (9, 3)  # 0, 8 and 9
        chosen = [0, 8, 9]
        twin = Integrator(strip.camera, strip.images[chosen], strip.poses[chosen])
        view = VirtualCamera(following(strip.camera, 64), strip.poses[9])
        assert decibel(result.image, twin.integrate(view, strip.surface)[0], 255.0) > 60.0
        stats = live.stats()
        assert (stats.arrived, stats.integrated, stats.dropped) == (10, 3, 7)


def test_latency_counts_the_waiting(strip: Strip) -> None:
    def slow(result: LiveResult) -> None:
        time.sleep(0.05)

    with LiveIntegrator(
        strip.camera, size=32, mask="none", waiting=8, on_result=slow
    ) as live:  # fmt: skip
        for i in range(8):
            live.push(strip.images[i], strip.poses[i])
        assert live.drain(60.0)
        stats = live.stats()
    assert stats.dropped == 0
    assert stats.latency["max_ms"] >= 6 * 50.0  # seven waited for
    assert stats.work["p50_ms"] >= 50.0


class Slow:
    """A detector that takes its time and remembers what it was shown."""

    def __init__(self) -> None:
        self.go, self.shown = threading.Event(), []

    def detect(
        self, image: Any, *, footprint: Any = None, gsd_m: float | None = None
    ) -> Detections:
        self.shown.append((image.copy(), footprint.copy(), gsd_m))
        if not self.go.wait(60.0):
            raise ValueError("never told to go on")
        box = np.array([[1.0, 2.0, 3.0, 4.0]], np.float32)
        return Detections(box, np.ones(1, np.float32), np.zeros(1, np.int64))


def test_a_slow_detector_never_stalls_the_integration(strip: Strip) -> None:
    finder = Slow()
    live = LiveIntegrator(
        strip.camera, frames=4, size=64, mask="none", detector=finder, detect_every=2
    )
    with live:
        first, late = None, time.monotonic() + 60.0
        for i in range(8):  # all of them integrated while the detector looks at the first
            live.push(strip.images[i], strip.poses[i])
            while live.stats().integrated <= i:
                assert time.monotonic() < late
                time.sleep(0.001)
            first = first or live.latest()
        newest = live.latest()
        assert newest is not None
        assert newest.number == 7
        assert newest.finds is None
        finder.go.set()
        assert live.drain(60.0)
        live.push(strip.images[8], strip.poses[8])
        assert live.drain(60.0)
        stats = live.stats()
        assert (stats.detected, stats.detections_skipped) == (2, 3)
        newest = live.latest()
        assert newest is not None
        assert newest.finds is not None
        assert newest.finds.number == 0  # of the first image: the newest is still looked at then
        assert len(newest.finds.detections) == 1
    image, footprint, gsd_m = finder.shown[0]
    assert first is not None
    np.testing.assert_array_equal(image, first.image)
    np.testing.assert_array_equal(footprint, first.footprint)
    eye = following(strip.camera, 64)
    assert gsd_m == pytest.approx(20.0 / eye.fx, rel=1e-3)


def test_the_navigator_says_where_photos_were_taken(
    simulated: Any, start: Any, short_mission: Any, strip: Strip
) -> None:
    log = simulated(2)
    navigator = OnlineFilter(ErrorStateEkf(IMU, GNSS, BARO), start(2), mounting=log.mounting)
    poses: list[np.ndarray] = []

    def seen(result: LiveResult) -> None:
        poses.append(result.view.world_from_camera)

    with LiveIntegrator(
        strip.camera, size=32, mask="none", navigator=navigator, on_result=seen
    ) as live:
        live.push(strip.images[0], t_s=2.0)  # the IMU has not got there
        assert live.drain(60.0)
        for event in events(log):
            feed(navigator, log, event)
            if event[0] > 10.0:
                break
        for i in range(4):
            live.push(strip.images[i], t_s=9.6 + 0.1 * i)
            assert live.drain(60.0)
        assert live.stats().without_pose == 1
        with pytest.raises(ValueError, match="time of exposure"):
            live.push(strip.images[0])
    assert len(poses) == 4
    motion, _ = short_mission
    position = motion.at(np.array([9.9]))[0][0]
    assert np.linalg.norm(poses[3][:2, 3] - position[:2]) < 3.0


def test_faults_reach_the_caller(strip: Strip) -> None:
    class Broken:
        def detect(self, image: Any, **_: Any) -> Detections:
            raise ValueError("no weights")

    with LiveIntegrator(strip.camera, size=32, mask="none", detector=Broken()) as live:
        live.push(strip.images[0], strip.poses[0])
        with pytest.raises(RuntimeError, match="no weights"):
            live.drain(60.0)

    def fail(result: LiveResult) -> None:
        raise OSError("disk full")

    with LiveIntegrator(strip.camera, size=32, mask="none", on_result=fail) as live:
        live.push(strip.images[0], strip.poses[0])
        with pytest.raises(RuntimeError, match="disk full"):
            live.drain(60.0)
        with pytest.raises(RuntimeError, match="disk full"):
            live.push(strip.images[0], strip.poses[0])


def test_what_makes_no_sense_is_refused(strip: Strip) -> None:
    with LiveIntegrator(strip.camera, size=32) as live:
        with pytest.raises(ValueError, match="image must have shape"):
            live.push(strip.images[0, 1:], strip.poses[0])
        with pytest.raises(ValueError, match="no navigator"):
            live.push(strip.images[0])
        with pytest.raises(ValueError, match="world_from_camera must"):
            live.push(strip.images[0], np.zeros((4, 4)))
    with pytest.raises(ValueError, match="was closed"):
        live.push(strip.images[0], strip.poses[0])
    with pytest.raises(ValueError, match="waiting"):
        LiveIntegrator(strip.camera, waiting=0)
    with pytest.raises(ValueError, match="detect_every"):
        LiveIntegrator(strip.camera, detect_every=0)
    with pytest.raises(TypeError, match="view must be"):
        LiveIntegrator(strip.camera, view=strip.camera)  # type: ignore[arg-type]


def test_hue_statistics_are_those_of_the_window(strip: Strip) -> None:
    from hsvaos.kernels.hue_mask import measure_hue

    mask = MaskSettings(scope="flight", sigmas=1.0)
    with LiveIntegrator(strip.camera, frames=4, size=32, mask=mask) as live:
        for i in range(10):
            live.push(strip.images[i], strip.poses[i])
            assert live.drain(60.0)
        expected = measure_hue(strip.images[6:10], 1.0, scope="flight")[0][0]
        result = live.latest()
    assert result is not None
    found = result.hue
    assert found is not None
    assert found.mean_deg == pytest.approx(expected.mean_deg)
    assert found.sigma_deg == pytest.approx(expected.sigma_deg)
