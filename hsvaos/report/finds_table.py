"""The finds on the page: a table with copyable positions, and the marks over the pictures."""

from __future__ import annotations

import base64
from html import escape

import cv2
import numpy as np

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Person
from hsvaos.report.figures import Rgba, encode
from hsvaos.report.panels import Panel
from hsvaos.report.places import box_around, places_of
from hsvaos.result import Result

MAX_ROWS = 60
"""Finds shown on the page; detections.json has them all."""

_MAX_CROPS = 20
_CROP_PX = 132
_CROP_M = 8.0
"""Ground shown around a find [m]: a person and enough to recognise the place."""


def finds_table(result: Result, panels: list[Panel], best: str) -> str:
    """Return the section with the finds, strongest first; empty without finds.

    Args:
        result: The run.
        panels: The page's pictures.
        best: Key of the one to cut the close-ups from.
    """
    if not result.persons:
        return ""
    by_key = {panel.key: panel for panel in panels}
    sources = [by_key[key] for key in dict.fromkeys(("photo", best)) if key in by_key]
    sources = [panel for panel in sources if panel.in_view]
    rows = "".join(
        f'<li><span class="rank">{number}</span>{_crops(result, person, number, sources)}'
        f"{_place(person)}{_figures(person)}</li>"
        for number, person in enumerate(result.persons[:MAX_ROWS], start=1)
    )
    more = len(result.persons) - MAX_ROWS
    rest = f'<p class="small">{more} weaker finds are in detections.json.</p>' if more > 0 else ""
    return f'<section class="finds"><h2>Finds</h2><ol>{rows}</ol>{rest}</section>'


def finds_marks(result: Result) -> str:
    """Return the marks of the main view, to be laid over every picture of it."""
    view = result.main.view
    big = max(view.size)
    text, ring = big / 34.0, big / 60.0
    boxes = result.main.detections.boxes_xyxy
    parts = [
        f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}"/>'
        for x0, y0, x1, y1 in boxes
    ]
    places = places_of(view, result.persons[:MAX_ROWS])
    around = box_around(places, boxes).tolist()
    for number, ((x, y), box) in enumerate(zip(places.tolist(), around, strict=True), start=1):
        if np.isnan(x):
            continue
        if box < 0:
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{ring:.1f}"/>')
            top, left = y - ring, x - ring
        else:
            left, top = boxes[box, :2]
        at_top = top - 0.25 * text if top > 1.3 * text else top + 1.2 * text
        left = min(max(left, 0.1 * text), view.width - 1.2 * text)
        parts.append(f'<text x="{left:.1f}" y="{at_top:.1f}">{number}</text>')
    return (
        f'<svg class="store" aria-hidden="true"><symbol id="marks" '
        f'viewBox="-0.5 -0.5 {view.width} {view.height}" preserveAspectRatio="none">'
        f'<g class="mark" style="font-size:{text:.1f}px;--edge:{text / 7:.2f}px">{"".join(parts)}'
        "</g></symbol></svg>"
    )


def _place(person: Person) -> str:
    local = f"N {person.north_m:.1f}  E {person.east_m:.1f}  D {person.down_m:.1f} m"
    if person.lat_deg is None or person.lon_deg is None:
        return _copyable(local) + '<div class="local">local metres; the flight has no origin</div>'
    place = f"{person.lat_deg:.7f}, {person.lon_deg:.7f}"
    link = f'<a href="geo:{person.lat_deg:.7f},{person.lon_deg:.7f}">open in maps</a>'
    return _copyable(place) + f'<div class="local">{local} · {link}</div>'


def _copyable(text: str) -> str:
    shown = escape(text)
    return (
        f'<div class="place"><code>{shown}</code>'
        f'<button type="button" class="copy" data-copy="{shown}">Copy</button></div>'
    )


def _figures(person: Person) -> str:
    std = f"± {person.std_m:.1f} m" if np.isfinite(person.std_m) else "not known"
    values = (("score", person.score_text), ("position", std), ("views", str(person.views)))
    return "".join(f'<div class="value"><b>{v}</b><span>{name}</span></div>' for name, v in values)


def _crops(result: Result, person: Person, number: int, sources: list[Panel]) -> str:
    if number > _MAX_CROPS:
        return '<span class="crops"></span>'
    window = _window(result.main.view, person)
    images = []
    for panel in sources if window is not None else []:
        crop = _crop(panel.picture, np.asarray(window))
        content = base64.b64encode(encode(crop, ".webp", 86)).decode("ascii")
        images.append(
            f'<img src="data:image/webp;base64,{content}" width="{_CROP_PX}" height="{_CROP_PX}" '
            f'alt="Find {number}: {escape(panel.title)}" title="{escape(panel.title)}">'
        )
    return f'<span class="crops">{"".join(images)}</span>'


def _window(view: VirtualCamera, person: Person) -> tuple[float, float, float] | None:
    """Return centre and half side of the close-up as shares of the view, or None if not in it."""
    place = np.array([person.north_m, person.east_m, person.down_m])
    x, y = view.project(place)
    if not (0 <= x <= view.width - 1 and 0 <= y <= view.height - 1):
        return None
    around = view.project(place + _CROP_M / 2 * np.array([[1.0, 0, 0], [0, 1.0, 0]]))
    reach = float(np.nanmax(np.linalg.norm(around - (x, y), axis=1), initial=8.0))
    reach = min(reach, min(view.size) / 2)
    return (x + 0.5) / view.width, (y + 0.5) / view.height, reach / view.width


def _crop(picture: Rgba, window: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Rgba:
    """Cut a square out of a picture and enlarge it; beyond the edge it is transparent."""
    height, width = picture.shape[:2]
    scale = 2 * window[2] * width / _CROP_PX
    left = window[0] * width - window[2] * width
    top = window[1] * height - window[2] * width
    # Picture from crop, pixel centres at integers on both sides.
    affine = np.array([[scale, 0, left + scale / 2 - 0.5], [0, scale, top + scale / 2 - 0.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (_CROP_PX, _CROP_PX)
    crop = cv2.warpAffine(picture, affine, size, flags=flags, borderValue=(0, 0, 0, 0))
    return np.asarray(crop, dtype=np.uint8)
