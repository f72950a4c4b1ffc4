"""Fly in real time for a long while: latencies and memory, tenth by tenth of the flight.

    python -m bench.live_soak [--minutes 10] [--rate 10] [--side 1024] [--size 512] [--window 30]
                              [--mask hue] [--view moving] [--detect-every 0] [--search] [FLIGHT]

Photos are drawn ones in memory, or those of a flight, decoded before: on board a camera brings them
decoded. Ends with status 1 where the p99 latency is above --budget, a photo was dropped, or memory
grew by more than 2 % from the second tenth to the last.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

import hsvaos
from hsvaos.benchmark.scenes import lawnmower, photos
from hsvaos.kernels.device import quiet_start, set_threads
from hsvaos.live.latency import Latencies
from hsvaos.live.memory import resident_mb
from hsvaos.live.window import METHODS

MOST_GROWTH = 0.02
HELD = 60
"""Photos held in memory at most."""


@dataclass
class Tenth:
    """What was seen in a tenth of the flight."""

    latency: dict[str, Any]
    dropped: int
    cpu_s: float
    resident: list[float]


class Soak:
    """A flight over the same photos again and again, and what is measured of it."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        if options.flight is None:
            self.camera, self.poses, _ = lawnmower(HELD, options.side)
            self.images = list(photos(8, options.side))
            down = 0.0
        else:
            flight = hsvaos.open_flight(options.flight)
            flight = flight.subset(range(min(HELD, len(flight))))
            self.camera, self.poses = flight.camera, flight.poses
            self.images, down = list(flight.images()), flight.ground_down_m or 0.0
        eye = self.camera.without_distortion().scaled(options.size, options.size)
        middle = hsvaos.VirtualCamera(eye, self.poses[len(self.poses) // 2])
        detector = hsvaos.Detector(options.model, threads=1) if options.detect_every else None
        self.live = hsvaos.LiveIntegrator(
            self.camera,
            hsvaos.FocalPlane(down),
            frames=options.window,
            view=middle if options.view == "fixed" else None,
            size=options.size,
            mask=options.mask,
            channels=3 if self.images[0].ndim == 3 else 1,
            dtype=self.images[0].dtype.name,
            detector=detector,
            search=hsvaos.Settings() if options.search else None,
            detect_every=max(1, options.detect_every),
        )
        self.tenths: list[Tenth] = []
        self.behind = Latencies()

    def fly(self) -> None:
        """Fly all tenths, printing each."""
        seconds = 6.0 * self.options.minutes
        start, turn = time.monotonic(), 0
        for tenth in range(10):
            self.live.recent_latency()
            dropped, cpu = self.live.stats().dropped, time.process_time()
            resident = [resident_mb()]
            watched = time.monotonic()
            while (due := turn / self.options.rate) < (tenth + 1) * seconds:
                time.sleep(max(0.0, start + due - time.monotonic()))
                self.behind.add(max(0.0, time.monotonic() - start - due))
                k = turn % len(self.poses)
                self.live.push(self.images[turn % len(self.images)], self.poses[k], due)
                turn += 1
                if time.monotonic() - watched > 1.0:
                    watched = time.monotonic()
                    resident.append(resident_mb())
            if not self.options.search:  # a search takes longer than photos can wait
                self.live.drain(10.0)
            spent = time.process_time() - cpu
            after = self.live.stats().dropped - dropped
            self.tenths.append(Tenth(self.live.recent_latency(), after, spent, resident))
            self._tell(tenth)

    def _tell(self, number: int) -> None:
        tenth = self.tenths[number]
        said = tenth.latency
        load = os.getloadavg()[0]
        sys.stdout.write(
            f"{number + 1:2d}/10  {said['count']:5d} photos  p50 {said['p50_ms']:6.1f}  "
            f"p95 {said['p95_ms']:6.1f}  p99 {said['p99_ms']:6.1f}  max {said['max_ms']:6.1f} ms  "
            f"dropped {tenth.dropped:3d}  CPU {1e3 * tenth.cpu_s / max(1, said['count']):5.1f} "
            f"ms a photo  memory {np.mean(tenth.resident):7.1f} MB  load {load:.1f}\n"
        )
        sys.stdout.flush()

    def report(self) -> int:
        """Print the outcome and return the exit status."""
        stats = self.live.stats()
        early = float(np.mean(self.tenths[1].resident))
        late = float(np.mean(self.tenths[-1].resident))
        growth = late / early - 1.0
        said = stats.latency
        sys.stdout.write(
            f"{self.options.minutes:g} minutes: {stats.integrated} of {stats.arrived} photos, "
            f"{stats.dropped} dropped; latency p50 {said['p50_ms']:.1f}, p95 {said['p95_ms']:.1f}, "
            f"p99 {said['p99_ms']:.1f}, max {said['max_ms']:.1f} ms; work alone p99 "
            f"{stats.work['p99_ms']:.1f} ms; memory {early:.1f} MB in the second tenth, {late:.1f} "
            f"MB in the last ({100 * growth:+.2f} %); photos pushed up to "
            f"{1e3 * self.behind.most_s:.0f} ms late\n"
        )
        if stats.detected:
            sys.stdout.write(
                f"looked for people {stats.detected} times, skipped {stats.detections_skipped}, "
                f"p50 {stats.detection['p50_ms']:.0f} p99 {stats.detection['p99_ms']:.0f} ms\n"
            )
        slow = said["p99_ms"] > self.options.budget
        return int(slow or stats.dropped > 0 or growth > MOST_GROWTH)


def main() -> None:
    """Fly, watch and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flight", nargs="?")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--side", type=int, default=1024)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--window", type=int, default=30)
    parser.add_argument("--mask", choices=METHODS, default="hue")
    parser.add_argument("--view", choices=("moving", "fixed"), default="moving")
    parser.add_argument("--detect-every", type=int, default=0)
    parser.add_argument("--model", help="ONNX file for --detect-every; the package's by default")
    parser.add_argument("--search", action="store_true", help="with all that run looks at")
    parser.add_argument("--threads", type=int, default=0, help="kernel threads; one a core")
    parser.add_argument("--budget", type=float, default=150.0, help="greatest p99 latency [ms]")
    options = parser.parse_args()
    quiet_start()
    set_threads(options.threads)
    soak = Soak(options)
    with soak.live:
        soak.fly()
        status = soak.report()
    left = [t.name for t in threading.enumerate() if t.name in ("hsvaos-live", "hsvaos-detect")]
    sys.exit(status or int(bool(left)))


if __name__ == "__main__":
    main()
