"""Marks drawn into display pictures: boxes, a legend, a north arrow and a scale bar (OpenCV)."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.detections import Detections
from hsvaos.report.figures import Rgba, colour_map

Colour = tuple[int, int, int, int]

_WHITE: Colour = (255, 255, 255, 255)
_BLACK: Colour = (0, 0, 0, 255)
_MARK: Colour = (255, 214, 10, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX

LEGEND_HEIGHT = 44
"""Height of the strip that `with_legend` adds [px]."""


def draw_boxes(picture: Rgba, found: Detections) -> Rgba:
    """Draw boxes with their scores, yellow edged in black: readable on light and on dark.

    Args:
        picture: Shape (H, W, 4), uint8 RGBA.
        found: Boxes in the pixels of this picture.

    Returns:
        A new picture.
    """
    out = picture.copy()
    unit = max(1, round(max(out.shape[:2]) / 900))
    for box, score in zip(found.boxes_xyxy, found.scores, strict=True):
        left, top, right, bottom = (int(v) for v in np.rint(box))
        for colour, thick in ((_BLACK, 4 * unit), (_MARK, 2 * unit)):
            cv2.rectangle(out, (left, top), (right, bottom), colour, thick)
        _tag(out, f"{score:.2g}" if score < 1 else f"{score:.1f}", left, top - 4 * unit, unit)
    return out


def draw_rings(picture: Rgba, places: NDArray[np.float64]) -> Rgba:
    """Draw rings around places without a box, in the colours of boxes.

    Args:
        picture: Shape (H, W, 4), uint8 RGBA.
        places: Shape (N, 2), pixels of this picture.

    Returns:
        A new picture.
    """
    out = picture.copy()
    unit = max(1, round(max(out.shape[:2]) / 900))
    for x, y in np.rint(places).astype(int).tolist():
        for colour, thick in ((_BLACK, 4 * unit), (_MARK, 2 * unit)):
            cv2.circle(out, (x, y), 16 * unit, colour, thick, cv2.LINE_AA)
    return out


def _tag(out: Rgba, text: str, left: int, bottom: int, unit: int) -> None:
    """Write black on a yellow plate, moved into the picture where it would stick out."""
    (wide, high), _ = cv2.getTextSize(text, _FONT, 0.5 * unit, unit)
    left = int(np.clip(left, 0, max(0, out.shape[1] - wide - 6 * unit)))
    bottom = int(np.clip(bottom, high + 6 * unit, out.shape[0] - 1))
    cv2.rectangle(
        out, (left, bottom - high - 6 * unit), (left + wide + 6 * unit, bottom), _MARK, cv2.FILLED
    )
    place = (left + 3 * unit, bottom - 3 * unit)
    cv2.putText(out, text, place, _FONT, 0.5 * unit, _BLACK, unit, cv2.LINE_AA)


def nice_length(longest: float) -> float:
    """Return the longest of 1, 2 or 5 times a power of ten that is not above `longest`.

    Args:
        longest: A positive length.
    """
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(m * power for m in (1.0, 2.0, 5.0) if m * power <= longest * (1 + 1e-9)))


def length_label(metres: float) -> str:
    """Return a length as people write it: "20 m", "1.5 km", "5 cm"."""
    if metres >= 1000:
        return f"{metres / 1000:g} km"
    return f"{metres:g} m" if metres >= 1 else f"{metres * 100:g} cm"


def draw_scale_and_north(picture: Rgba, gsd_m: float) -> Rgba:
    """Draw a scale bar (bottom left) and an arrow to the north (top right) on a ground grid.

    Args:
        picture: Shape (H, W, 4), uint8 RGBA, north up.
        gsd_m: Ground sampling distance [m/px].

    Returns:
        A new picture.
    """
    out = picture.copy()
    height, width = out.shape[:2]
    unit = max(1, round(max(height, width) / 600))
    margin = 16 * unit
    if min(height, width) < 6 * margin:  # marks would hide what they explain
        return out
    length = nice_length(width * gsd_m / 4)
    end, base = margin + round(length / gsd_m), height - margin

    def bar(colour: Colour, extra: int) -> None:
        cv2.line(out, (margin, base), (end, base), colour, 3 * unit + extra)

    def arrow(colour: Colour, extra: int) -> None:
        x = width - margin - 6 * unit
        cv2.arrowedLine(
            out, (x, margin + 44 * unit), (x, margin), colour, 2 * unit + extra, cv2.LINE_AA, 0, 0.3
        )

    _twice(bar, unit)
    _twice(arrow, unit)
    _write(out, length_label(length), (margin, base - 8 * unit), unit)
    _write(out, "N", (width - margin - 11 * unit, margin + 62 * unit), unit)
    return out


def with_legend(picture: Rgba, name: str, low: float, high: float, title: str) -> Rgba:
    """Add a strip below a picture that says what the colours mean; pixels above stay in place.

    Args:
        picture: Shape (H, W, 4), uint8 RGBA.
        name: Colour map, as for `colour_map`.
        low: Value of the first colour.
        high: Value of the last colour.
        title: What is shown, with its unit.

    Returns:
        Shape (H + LEGEND_HEIGHT, W, 4).
    """
    width = picture.shape[1]
    strip = np.full((LEGEND_HEIGHT, width, 4), 255, np.uint8)
    bar_width = max(1, width - 16)
    ramp = np.tile(np.linspace(0.0, 1.0, bar_width, dtype=np.float32), (10, 1))
    strip[6:16, 8 : 8 + bar_width] = colour_map(ramp, ramp >= 0, 0.0, 1.0, name)[:, : width - 8]
    last = f"{high:.3g}"
    wide = cv2.getTextSize(last, _FONT, 0.45, 1)[0][0]
    first = f"{low:.3g}"
    cv2.putText(strip, first, (8, 34), _FONT, 0.45, _BLACK, 1, cv2.LINE_AA)
    cv2.putText(strip, last, (width - 8 - wide, 34), _FONT, 0.45, _BLACK, 1, cv2.LINE_AA)
    title_wide = cv2.getTextSize(title, _FONT, 0.45, 1)[0][0]
    if title_wide + wide + 60 < width:
        place = ((width - title_wide) // 2, 34)
        cv2.putText(strip, title, place, _FONT, 0.45, _BLACK, 1, cv2.LINE_AA)
    return np.concatenate([picture, strip])


def _twice(stroke: Callable[[Colour, int], None], unit: int) -> None:
    """Draw a stroke black and wide, then white and thin: visible on any ground."""
    stroke(_BLACK, 2 * unit)
    stroke(_WHITE, 0)


def _write(out: Rgba, text: str, place: tuple[int, int], unit: int) -> None:
    """Write white with a black edge, made of shifted copies: fonts ignore thickness in OpenCV 5."""
    around = [(x, y) for x in (-unit, 0, unit) for y in (-unit, 0, unit) if (x, y) != (0, 0)]
    for (x, y), colour in [*((shift, _BLACK) for shift in around), ((0, 0), _WHITE)]:
        at = (place[0] + x, place[1] + y)
        cv2.putText(out, text, at, _FONT, 0.5 * unit, colour, unit, cv2.LINE_AA)
