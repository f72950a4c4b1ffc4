"""Make the pictures of the viewer's page in headless Chromium, on the demo flight.

python -m docs.make_viewer_pictures
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import hsvaos
from bench.viewer_browser import page
from hsvaos.demo import FOLDER
from hsvaos.kernels.device import quiet_start
from hsvaos.viewer.app import App
from hsvaos.viewer.session import Session
from hsvaos.viewer.tab import Tab

HERE = Path(__file__).parent
SIZE = (1280, 720)


def main() -> None:
    """Look at the flight from a photo, then from aside."""
    quiet_start()
    app = App(Session.open(hsvaos.open_flight(FOLDER)), port=0)
    with page(app.url, *SIZE) as shown:
        if shown is None:
            raise SystemExit("no Chromium or Playwright on this machine")
        while not app.tabs:
            time.sleep(0.1)
        tab = app.tabs[0]
        rest(tab, shown)
        close = shown.get_by_role("alert").get_by_role("button")
        if close.count():  # that WebGL runs in software
            close.first.click()
        tab.actions.autofocus()
        while not tab.controls.curve.visible:
            time.sleep(0.1)
        tab.controls.depth.value = tab.session.start.down_m
        rest(tab, shown)
        shown.screenshot(path=HERE / "viewer.jpg", type="jpeg", quality=85)
        shown.get_by_text("Overview").click()
        shown.get_by_role("tab", name="Mask").click()
        rest(tab, shown)
        shown.screenshot(path=HERE / "viewer_overview.jpg", type="jpeg", quality=85)
    app.close()


def rest(tab: Tab, shown: Any) -> None:
    """Wait until picture and finds are there."""
    shown.wait_for_timeout(1000)
    while tab.live.busy(tab) or not tab.controls.finds.content:
        time.sleep(0.1)
    shown.wait_for_timeout(4000)


if __name__ == "__main__":
    main()
