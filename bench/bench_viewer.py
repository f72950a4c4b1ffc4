"""Slider to picture, and pictures a second while dragging, of the viewer.

    python -m bench.bench_viewer [--seconds 10] [--browser]

Without --browser: from the call that a slider makes to the encoded picture (session, worker,
tone, JPEG), with slider events 60 times a second. With it: from a key press on the slider in
headless Chromium to the page's status line, which comes with the picture; there WebGL in software
shares the cores.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import warp as wp

from bench.harness import SMOKE
from bench.viewer_browser import page
from hsvaos import Camera, Flight, Frame, Settings, VirtualCamera
from hsvaos.benchmark.scenes import lawnmower, photos
from hsvaos.kernels.device import quiet_start
from hsvaos.photos import Photos
from hsvaos.settings import DetectSettings
from hsvaos.viewer.app import App
from hsvaos.viewer.live import Live
from hsvaos.viewer.picture import jpeg
from hsvaos.viewer.render import Picture
from hsvaos.viewer.request import Focus, Request
from hsvaos.viewer.session import Session

FLIGHTS = ((6, 64),) if SMOKE else ((30, 512), (117, 1024))
SIZES = ((64, 36),) if SMOKE else ((640, 360), (1280, 720))
EVENTS_A_SECOND = 60.0


def session(count: int, side: int, device: str) -> Session:
    """A flight over noise, all in memory."""
    camera, poses, _ = lawnmower(count, side)
    frames = tuple(
        Frame(f"{i:04d}.png", Path(f"{i:04d}.png"), pose, float(i)) for i, pose in enumerate(poses)
    )
    flight = Flight("noise", camera, frames, ground_down_m=0.0)
    images = wp.array(photos(count, side), dtype=wp.uint8, device=device)
    quiet = Settings(detect=DetectSettings(enabled=False))
    return Session(Photos(flight, images, None, ()), quiet)


def drag(made: Session, size: tuple[int, int], seconds: float, sigmas: bool) -> dict[str, float]:
    """Drag a slider and time every picture."""
    live = Live(made)
    camera = Camera.from_fov(*size, 80.0)
    view = VirtualCamera(camera, made.flight.poses[made.flight.centre_index])
    asked: dict[int, float] = {}
    latencies: list[float] = []
    scales: list[float] = []
    last: list[Picture] = []

    def deliver(picture: Picture) -> None:
        jpeg(picture.rgb)
        moment = asked.get(id(picture.request))
        if moment is not None and not last:
            latencies.append(1e3 * (time.perf_counter() - moment))
            scales.append(picture.quality.scale / picture.quality.every**0.5)

    def fail(error: Exception) -> None:
        raise error

    base = Request(view, made.start, mask=made.settings.mask, moving=True)
    kept = []  # so that no two requests have one id

    def move(i: int) -> Request:
        if sigmas:
            return replace(base, mask=replace(base.mask, sigmas=1.5 + 0.01 * (i % 150)))
        return replace(base, focus=Focus(-4.0 + 0.01 * (i % 600)))

    made.render(base)  # as after the first look: the mask is made

    def drive(duration: float) -> None:
        start, i = time.perf_counter(), 0
        while time.perf_counter() - start < duration:
            request = move(i)
            kept.append(request)
            asked[id(request)] = time.perf_counter()
            live.show("tab", request, deliver, fail)
            i += 1
            time.sleep(max(0.0, start + i / EVENTS_A_SECOND - time.perf_counter()))

    drive(min(3.0, seconds))  # compiles, and finds its pace
    latencies.clear()
    scales.clear()
    start, cpu = time.perf_counter(), time.process_time()
    drive(seconds)
    elapsed, used = time.perf_counter() - start, time.process_time() - cpu
    shown = list(latencies)
    last.append(None)  # type: ignore[arg-type]
    start = time.perf_counter()
    while live.busy("tab"):
        time.sleep(0.005)
    full = 1e3 * (time.perf_counter() - start)
    live.close()
    sharp = []
    for _ in range(3):
        cpu_start = time.process_time()
        jpeg(made.render(kept[-1]).rgb)
        sharp.append(1e3 * (time.process_time() - cpu_start))
    return {
        "median ms": statistics.median(shown),
        "p95 ms": float(np.percentile(shown, 95)),
        "pictures/s": len(shown) / elapsed,
        "share of the pixels": statistics.median(scales) ** 2,
        "still ms": full,
        "CPU ms/moving picture": 1e3 * used / len(shown),
        "CPU ms/full picture": min(sharp),
    }


_WATCH = """() => {
  window.arrivals = [];
  const line = [...document.querySelectorAll("*")].find(
    e => e.children.length === 0 && / of \\d+ photos/.test(e.textContent));
  const options = {childList: true, subtree: true, characterData: true};
  new MutationObserver(() => window.arrivals.push(performance.now()))
    .observe(line.parentElement.parentElement, options);
}"""


def browse(made: Session, size: tuple[int, int], seconds: float) -> dict[str, float] | None:
    """The same through viser, websocket and browser."""
    app = App(made, port=0)
    try:
        with page(app.url, *size) as shown:
            if shown is None:
                return None
            while not app.tabs:
                time.sleep(0.05)
            tab = app.tabs[0]
            _until(lambda: tab.last is not None and not app.live.busy(tab))
            shown.wait_for_timeout(2000)
            shown.evaluate(_WATCH)
            thumb = shown.get_by_role("slider").first
            thumb.focus()
            latencies = []
            for i in range(5 if SMOKE else 25):
                before = shown.evaluate("window.arrivals.length")
                start = shown.evaluate("performance.now()")
                thumb.press("ArrowLeft" if i % 2 else "ArrowRight")
                _until(lambda b=before: shown.evaluate("window.arrivals.length") > b)
                latencies.append(shown.evaluate(f"window.arrivals[{before}]") - start)
                _until(lambda: not app.live.busy(tab))
                shown.wait_for_timeout(300)
            shown.evaluate("window.arrivals = []")
            start, i = time.perf_counter(), 0
            while time.perf_counter() - start < seconds:
                thumb.press("ArrowLeft" if (i // 40) % 2 else "ArrowRight")
                i += 1
                shown.wait_for_timeout(10)
            elapsed = time.perf_counter() - start
            arrived = shown.evaluate("window.arrivals.length")
            return {
                "median ms": statistics.median(latencies),
                "p95 ms": float(np.percentile(latencies, 95)),
                "pictures/s": arrived / elapsed,
                "slider events/s": i / elapsed,
            }
    finally:
        app.close()


def _until(condition: Callable[[], object], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("the page did not answer")
        time.sleep(0.01)


def test_dragging() -> None:
    """See that it runs; the figures come from `main`."""
    row = drag(session(6, 64, "cpu"), (64, 36), 0.5, sigmas=False)
    assert row["pictures/s"] > 0.0


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=0.5 if SMOKE else 10.0)
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    quiet_start()
    write = sys.stdout.write
    for count, side in FLIGHTS:
        made = session(count, side, options.device)
        for size in SIZES:
            name = f"{count} x {side}x{side} at {size[0]}x{size[1]}"
            rows: dict[str, dict[str, float] | None] = {}
            if options.browser:
                rows["browser"] = browse(made, size, options.seconds)
            else:
                rows["depth"] = drag(made, size, options.seconds, sigmas=False)
                rows["sigmas"] = drag(made, size, options.seconds, sigmas=True)
            for slider, row in rows.items():
                text = "no Chromium, Playwright or viser here"
                if row is not None:
                    text = ", ".join(f"{key} {value:.2f}" for key, value in row.items())
                load = os.getloadavg()[0]
                write(f"{name}, {slider}: {text} (load {load:.1f})\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
