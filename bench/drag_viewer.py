"""Drag the viewer's sliders at random for a while: memory, errors and stale pictures.

    python -m bench.drag_viewer [--minutes 10] [FLIGHT]

Everything goes through viser and, where it is here, headless Chromium, whose mouse drags the
sliders; without a browser the session's worker gets the requests. Ends with status 1 where memory
grew by more than 5 %, something was raised, or a picture stayed that is not the one asked for.
"""

from __future__ import annotations

import argparse
import random
import sys
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np

import hsvaos
from bench.viewer_browser import page
from hsvaos.demo import FOLDER
from hsvaos.kernels.device import quiet_start
from hsvaos.live.memory import resident_mb
from hsvaos.viewer.app import App
from hsvaos.viewer.controls import LAYER_NAMES, PLACES
from hsvaos.viewer.render import Picture
from hsvaos.viewer.request import Aperture, Focus, Look, Request
from hsvaos.viewer.session import Session

WARM_UP_S = 120.0
"""Before memory counts: until the caches are full and the allocator knows all sizes of pictures."""

CHECK_EVERY_S = 20.0
SETTLE_S = 60.0
MOST_GROWTH = 0.05
METHODS = ("hue", "rarity", "anomaly", "none")


class Watch:
    """What is looked at all the time: errors, and memory after the warm-up."""

    def __init__(self) -> None:
        self.errors: list[str] = []
        self.pictures = 0
        self.checks = 0
        self.memory: list[float] = []
        threading.excepthook = lambda args: self.errors.append(f"thread: {args.exc_value!r}")

    def failed(self, error: Exception) -> None:
        self.errors.append(repr(error))

    def check(self, session: Session, asked: Request, shown: Picture | None) -> None:
        """Compare the picture that stayed with the one asked for last."""
        self.checks += 1
        if shown is None or shown.request is not asked or not shown.quality.full:
            self.errors.append("a stale picture stayed")
            return
        off = np.abs(session.render(asked).rgb.astype(int) - shown.rgb).max()
        if off > 1:
            self.errors.append(f"the picture that stayed is {off} levels off")

    def report(self, minutes: float) -> int:
        """Print the outcome and return the exit status."""
        memory = np.array(self.memory or [resident_mb()])
        third = max(1, len(memory) // 3)
        early, late = float(np.median(memory[:third])), float(np.median(memory[-third:]))
        growth = late / early - 1.0
        parts = [part.mean() for part in np.array_split(memory, 10) if part.size]
        tenths = " ".join(f"{part:.0f}" for part in parts)
        sys.stdout.write(
            f"{minutes:g} minutes, {self.pictures} pictures, {self.checks} compared, "
            f"{len(self.errors)} errors; memory {early:.0f} MB early, {late:.0f} MB late "
            f"({100 * growth:+.1f} %), by tenths {tenths}\n"
        )
        for error in self.errors[:10]:
            sys.stdout.write(f"  {error}\n")
        return int(bool(self.errors) or growth > MOST_GROWTH)


def with_browser(session: Session, seconds: float, watch: Watch, seed: int) -> bool:
    """Drag in Chromium; False where there is none."""
    rng = random.Random(seed)
    app = App(session, port=0)
    try:
        with page(app.url, 640, 480) as shown:
            if shown is None:
                return False
            while not app.tabs:
                time.sleep(0.05)
            tab = app.tabs[0]
            latest: list[Picture] = []
            put = tab.scene.put_picture

            def count(picture: Picture) -> None:
                latest[:] = [picture]
                watch.pictures += 1
                put(picture)

            tab.scene.put_picture = count  # type: ignore[method-assign]
            said = tab.failed

            def failed(error: Exception) -> None:
                watch.failed(error)
                said(error)

            tab.failed = failed  # type: ignore[method-assign]
            start = checked = time.monotonic()
            while time.monotonic() - start < seconds:
                _drag_one(shown, rng)
                _change_one(tab.controls, rng, len(session.flight))
                now = time.monotonic()
                watch.memory.append(resident_mb())
                if now - checked > CHECK_EVERY_S:
                    end = time.monotonic() + SETTLE_S
                    while app.live.busy(tab) and time.monotonic() < end:
                        time.sleep(0.05)
                    time.sleep(0.5)
                    if app.live.busy(tab):
                        watch.errors.append(f"no rest within {SETTLE_S:g} s")
                    elif tab.last is not None:
                        watch.check(session, tab.last, latest[0] if latest else None)
                    checked = time.monotonic()
    finally:
        app.close()
    return True


def _drag_one(shown: Any, rng: random.Random) -> None:
    thumbs = shown.locator("[role=slider]:visible")
    number = thumbs.count()
    box = thumbs.nth(rng.randrange(number)).bounding_box() if number else None
    if box is None:
        return
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    shown.mouse.move(x, y)
    shown.mouse.down()
    for _ in range(rng.randrange(3, 12)):
        shown.mouse.move(x + rng.uniform(-60, 60), y)
        shown.wait_for_timeout(rng.uniform(5, 40))
    shown.mouse.up()


def _change_one(controls: Any, rng: random.Random, photos: int) -> None:
    """Change what is not on the visible sheet of the panel."""
    choice = rng.randrange(9)
    if choice == 0:
        controls.sigmas.value = rng.uniform(0.5, 4.0)
    elif choice == 1:
        controls.layer.value = rng.choice(list(LAYER_NAMES))
    elif choice == 2:
        controls.method.value = rng.choice(METHODS)
    elif choice == 3:
        controls.place.value = rng.choice(PLACES)
    elif choice == 4:
        controls.all_photos.value = rng.random() < 0.5
        controls.radius.value = rng.uniform(1.0, 20.0)
    elif choice == 5 and controls.span is not None:
        controls.span.value = tuple(sorted(rng.sample(range(photos), 2)))
    elif choice == 6 and controls.cuts is not None:
        first = controls.cuts.min
        controls.cuts.value = tuple(sorted(first + rng.uniform(0, 360) for _ in range(2)))
        controls.by_hand.value = rng.random() < 0.5
    elif choice == 7:
        controls.size.value = rng.choice((320, 480, 640))


def without_browser(session: Session, seconds: float, watch: Watch, seed: int) -> None:
    """Drag in the session's worker."""
    from hsvaos.viewer.live import Live

    rng = random.Random(seed)
    live = Live(session)
    latest: list[Picture] = []

    def deliver(picture: Picture) -> None:
        latest[:] = [picture]
        watch.pictures += 1

    asked = Request(session.flight.view(0), session.start, moving=True)
    start = checked = time.monotonic()
    while time.monotonic() - start < seconds:
        changes: dict[str, Any] = {"focus": Focus(rng.uniform(-15, 5), rng.uniform(-20, 20))}
        choice = rng.randrange(12)
        if choice == 0:
            changes["mask"] = replace(asked.mask, sigmas=rng.uniform(0.5, 4.0))
        elif choice == 1:
            changes["mask"] = replace(asked.mask, method=rng.choice(METHODS))
        elif choice == 2:
            changes["layer"] = rng.choice(list(LAYER_NAMES.values()))
        elif choice == 3:
            changes["view"] = session.flight.view(rng.randrange(len(session.flight)))
        elif choice == 4:
            changes["aperture"] = Aperture(rng.uniform(1.0, 20.0), every=rng.randrange(1, 4))
        elif choice == 5:
            changes["look"] = Look(rng.uniform(0.3, 3.0), rng.uniform(0.5, 2.0))
        asked = replace(asked, **changes)
        live.show("tab", asked, deliver, watch.failed)
        time.sleep(rng.uniform(0.005, 0.05))
        now = time.monotonic()
        watch.memory.append(resident_mb())
        if now - checked > CHECK_EVERY_S:
            while live.busy("tab"):
                time.sleep(0.05)
            watch.check(session, asked, latest[0] if latest else None)
            checked = time.monotonic()
    live.close()


def _fill(session: Session) -> None:
    """Let the session keep as many masks as it ever will."""
    view = session.flight.view(0)
    for method in METHODS:
        for sigmas in (1.0, 1.5, 2.5, 3.0):
            mask = replace(session.settings.mask, method=method, sigmas=sigmas)
            session.render(Request(view, session.start, mask=mask))
            session.finds(Request(view, session.start, mask=mask))


def main() -> None:
    """Drag, watch and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flight", nargs="?", default=str(FOLDER))
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-browser", action="store_true")
    options = parser.parse_args()
    quiet_start()
    watch = Watch()
    session = Session.open(hsvaos.open_flight(options.flight))
    seconds = 60.0 * options.minutes
    _fill(session)
    without_browser(session, min(seconds, WARM_UP_S), watch, options.seed + 1)
    watch.memory.clear()
    if options.no_browser or not with_browser(session, seconds, watch, options.seed):
        without_browser(session, seconds, watch, options.seed)
    sys.exit(watch.report(options.minutes))


if __name__ == "__main__":
    main()
