"""Precision over recall as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from hsvaos.evaluate.measures import ALL, CurvePoints, Evaluation
from hsvaos.report.figures import Rgba, fit

_SIDE = 520
"""Side of the square plot [px]."""

_LEFT, _TOP, _BOTTOM, _RIGHT = 76, 52, 64, 300
"""Around it, with the legend to the right [px]."""

_FINE = 2
"""Drawn larger by this factor and shrunk, for smooth lines and letters."""

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_INK, _GRID = (40, 36, 28, 255), (225, 225, 225, 255)
_COLOURS = (
    (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233),
    (60, 60, 60), (150, 140, 0),
)  # fmt: skip
"""Okabe and Ito's, told apart by the colour-blind too."""


class Line(NamedTuple):
    """One curve.

    Args:
        name: For the legend.
        points: The curve.
        ap: Average precision to write behind the name, or None.
    """

    name: str
    points: CurvePoints
    ap: float | None = None


def lines_of(evaluation: Evaluation) -> list[Line]:
    """Return the curves of an evaluation, one for each threshold."""
    return [
        Line(f"IoU {points.iou:.2f}", points, evaluation.boxes(ALL, points.iou).ap_coco101)
        for points in evaluation.curves
    ]


def curve_picture(lines: Sequence[Line], title: str) -> Rgba:
    """Draw precision over recall.

    Args:
        lines: Up to eight curves.
        title: Above the plot.

    Returns:
        Shape (H, W, 4), uint8 RGBA.

    Raises:
        ValueError: If there are more curves than colours.
    """
    if len(lines) > len(_COLOURS):
        raise ValueError(f"expected at most {len(_COLOURS)} curves, got {len(lines)}")
    height, width = _TOP + _SIDE + _BOTTOM, _LEFT + _SIDE + _RIGHT
    picture = np.full((height * _FINE, width * _FINE, 4), 255, np.uint8)
    _axes(picture, title)
    for number, (line, colour) in enumerate(zip(lines, _COLOURS, strict=False)):
        rgba = (*colour, 255)
        _draw(picture, line.points, rgba)
        y = _TOP + 24 + 30 * number
        _stroke(picture, [(_LEFT + _SIDE + 18, y - 5), (_LEFT + _SIDE + 46, y - 5)], rgba, 3)
        ap = "" if line.ap is None else f"  AP {line.ap:.3f}"
        _text(picture, f"{line.name}{ap}", (_LEFT + _SIDE + 54, y))
    picture[..., 3] = 255  # smooth letters and lines would thin it
    return fit(picture, max(height, width))


def _at(recall: float, precision: float) -> tuple[float, float]:
    return _LEFT + _SIDE * recall, _TOP + _SIDE * (1.0 - precision)


def _axes(picture: Rgba, title: str) -> None:
    _text(picture, title, (_LEFT, _TOP - 20), 0.6)
    for tenth in range(0, 11, 2):
        share = tenth / 10.0
        _stroke(picture, [_at(share, 0.0), _at(share, 1.0)], _GRID, 1)
        _stroke(picture, [_at(0.0, share), _at(1.0, share)], _GRID, 1)
        label = f"{share:.1f}"
        x, y = _at(share, 0.0)
        _text(picture, label, (x - 11, y + 22))
        x, y = _at(0.0, share)
        _text(picture, label, (x - 36, y + 5))
    _stroke(picture, [_at(0, 0), _at(1, 0), _at(1, 1), _at(0, 1), _at(0, 0)], _INK, 1)
    x, y = _at(0.5, 0.0)
    _text(picture, "recall", (x - 22, y + 46))
    # letters upright above the axis would leave the picture: written sideways
    strip = np.full((30 * _FINE, 100 * _FINE, 4), 255, np.uint8)
    _text(strip, "precision", (10, 20))
    turned = cv2.rotate(strip, cv2.ROTATE_90_COUNTERCLOCKWISE)
    top = (_TOP + _SIDE // 2 - 50) * _FINE
    picture[top : top + turned.shape[0], 4 * _FINE : 4 * _FINE + turned.shape[1]] = turned


def _draw(picture: Rgba, points: CurvePoints, colour: tuple[int, int, int, int]) -> None:
    if not points.recall:
        return
    places = [_at(0.0, points.precision[0])]
    places += [_at(r, p) for r, p in zip(points.recall, points.precision, strict=True)]
    _stroke(picture, places, colour, 2)
    # where the finds end is part of the outcome
    x, y = (round(v * _FINE) for v in places[-1])
    cv2.circle(picture, (x, y), 4 * _FINE, colour, cv2.FILLED, cv2.LINE_AA)


def _stroke(
    picture: Rgba,
    places: Sequence[tuple[float, float]],
    colour: tuple[int, int, int, int],
    thick: int,
) -> None:
    line = np.rint(np.array(places) * _FINE).astype(np.int32)
    cv2.polylines(picture, [line], False, colour, thick * _FINE, cv2.LINE_AA)


def _text(picture: Rgba, text: str, place: tuple[float, float], size: float = 0.5) -> None:
    at = (round(place[0] * _FINE), round(place[1] * _FINE))
    cv2.putText(picture, text, at, _FONT, size * _FINE, _INK, _FINE, cv2.LINE_AA)
