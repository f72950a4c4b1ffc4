"""The viewer in headless Chromium, for the benchmark and the endurance run."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SOFTWARE_GL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextmanager
def page(url: str, width: int, height: int) -> Iterator[Any]:
    """Give a page that shows the viewer; None where there is no Chromium or Playwright."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        path = None
    if path is None:
        yield None
        return
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=[*SOFTWARE_GL, "--no-sandbox"])
        made = browser.new_page(viewport={"width": width, "height": height})
        made.goto(url)
        yield made
        browser.close()
