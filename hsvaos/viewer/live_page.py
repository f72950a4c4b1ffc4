"""The page of a live flight: its newest integral image, with the boxes found last."""

from __future__ import annotations

import numpy as np

from hsvaos.detect.detections import Detections
from hsvaos.live.integrator import LiveIntegrator
from hsvaos.report.draw import draw_boxes
from hsvaos.viewer.picture import integral_picture
from hsvaos.viewer.request import Look
from hsvaos.viewer.stream import Shown, Stream


def live_page(name: str, live: LiveIntegrator, host: str, port: int) -> Stream:
    """Serve the pictures of a live integrator.

    Args:
        name: What to call the flight.
        live: The integrator.
        host: Address to listen at.
        port: Port to listen at; the next free one if it is taken.

    Raises:
        OSError: If the address or all ports from there cannot be used.
    """
    return Stream(name, live.newest, lambda: shown(live), host, port)


def shown(live: LiveIntegrator) -> Shown | None:
    """Return the newest picture for the page, with the boxes found last."""
    result = live.latest()
    if result is None:
        return None
    rgb = integral_picture(result.image, result.footprint, Look())
    found = Detections.none() if result.finds is None else result.finds.seen_from(result.view)
    if len(found):
        solid = np.full((*rgb.shape[:2], 1), 255, np.uint8)
        rgba = draw_boxes(np.concatenate([rgb, solid], axis=2), found)
        rgb = np.ascontiguousarray(rgba[..., :3])
    text = (
        f"photo {result.number}, {result.frames} in the window, "
        f"{1e3 * result.latency_s:.0f} ms after it came"
    )
    return Shown(rgb, {"text": text})
