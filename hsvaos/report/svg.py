"""Small drawings as inline SVG: the map of the flight and the hue histogram."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Matrix
from hsvaos.detect.detections import Person
from hsvaos.report.draw import length_label, nice_length

_MAP_SIDE = 420.0
_MAP_MARGIN = 34.0


@dataclass(frozen=True)
class _Fit:
    """North-up map coordinates [SVG units] from north and east [m]."""

    north_top: float
    east_left: float
    scale: float
    width: float
    height: float

    def at(self, north: float, east: float) -> tuple[float, float]:
        x = _MAP_MARGIN + (east - self.east_left) * self.scale
        return x, _MAP_MARGIN + (self.north_top - north) * self.scale

    def points(self, places: Matrix) -> str:
        return " ".join("{:.1f},{:.1f}".format(*self.at(n, e)) for n, e in places)


def _fit(places: Matrix) -> _Fit:
    low, high = places.min(axis=0), places.max(axis=0)
    span = np.maximum(high - low, 1e-3)
    if span.max() < 1e-2:  # a single place: show ten metres around it
        low, high = low - 5.0, high + 5.0
        span = high - low
    scale = (_MAP_SIDE - 2 * _MAP_MARGIN) / float(span.max())
    north, east = (float(s) * scale + 2 * _MAP_MARGIN for s in span)
    return _Fit(float(high[0]), float(low[1]), scale, max(east, 200.0), max(north, 120.0))


def site_map(
    track: Matrix, centre: int | None, outlines: Sequence[Matrix], persons: Sequence[Person]
) -> str:
    """Draw the drone's track, what the pictures show, and the finds; north is up.

    Args:
        track: Shape (N, 2), north and east of every photo, in order of time [m].
        centre: Number of the photo shown on the page, or None.
        outlines: Polygons, each shape (K, 2), covered ground [m].
        persons: The finds.

    Returns:
        An `<svg>` element; colours come from the page's classes.
    """
    finds = np.array([[p.north_m, p.east_m] for p in persons], dtype=np.float64).reshape(-1, 2)
    fit = _fit(np.concatenate([track, *outlines, finds]))
    parts = [
        f'<svg class="map" viewBox="0 0 {fit.width:.0f} {fit.height + 26:.0f}" role="img" '
        f'aria-label="Map, north up: track of the drone, covered ground, finds">'
    ]
    parts += [f'<polygon class="area" points="{fit.points(o)}"/>' for o in outlines]
    parts.append(f'<polyline class="track" points="{fit.points(track)}"/>')
    for number, (north, east) in enumerate(track):
        x, y = fit.at(north, east)
        shown = number == centre
        kind, radius = ("shot shown", 5) if shown else ("shot", 2.6)
        parts.append(f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius}"/>')
    for number, (north, east) in reversed(list(enumerate(finds, start=1))):
        x, y = fit.at(north, east)
        parts.append(
            f'<g class="find"><circle cx="{x:.1f}" cy="{y:.1f}" r="9"/>'
            f'<text x="{x:.1f}" y="{y + 3.6:.1f}">{number}</text></g>'
        )
    length = nice_length((fit.width - 2 * _MAP_MARGIN) / fit.scale / 2.5)
    end, base = 12 + length * fit.scale, fit.height + 14
    parts.append(
        f'<path class="ink" d="M12 {base - 5:.1f}V{base:.1f}H{end:.1f}V{base - 5:.1f}"/>'
        f'<text class="label" x="{end + 7:.1f}" y="{base + 2:.1f}">{length_label(length)}</text>'
    )
    x = fit.width - 14
    parts.append(
        f'<path class="north" d="M{x:.1f} 6l6 17-6-4-6 4z"/>'
        f'<text class="label mid" x="{x:.1f}" y="36">N</text></svg>'
    )
    return "".join(parts)


def hue_histogram(
    histogram: NDArray[np.float64], mean_deg: float | None, half_width_deg: float | None
) -> str:
    """Draw the hue histogram with its mean and the two cuts; hues between the cuts are removed.

    Args:
        histogram: Shape (B,), weight of each hue bin, evenly from 0 to 360 degrees.
        mean_deg: Mean hue [deg], or None if hue said nothing.
        half_width_deg: Distance of the cuts from the mean [deg], or None.

    Returns:
        An `<svg>` element.
    """
    bins, width, height = len(histogram), 360.0, 120.0
    top = float(np.max(histogram, initial=0.0)) or 1.0
    step = width / bins
    parts = ['<svg class="hue" viewBox="-24 -20 408 164" role="img" aria-label="Histogram of hue">']
    cuts: list[tuple[float, str]] = []
    if mean_deg is not None and half_width_deg is not None and half_width_deg < 180.0:
        cuts = [((mean_deg + s * half_width_deg) % 360.0, "cut") for s in (-1.0, 1.0)]
        (low, _), (high, _) = cuts
        spans = [(low, high)] if low <= high else [(0.0, high), (low, 360.0)]
        parts += [
            f'<rect class="removed" x="{a:.1f}" y="0" width="{b - a:.1f}" height="{height:.0f}"/>'
            for a, b in spans
        ]
    for number, value in enumerate(np.asarray(histogram, np.float64) / top):
        red, green, blue = (
            round(255 * v) for v in colorsys.hsv_to_rgb((number + 0.5) / bins, 0.85, 0.85)
        )
        tall = float(value) * height
        if tall < 0.05:
            continue
        parts.append(
            f'<rect x="{number * step:.2f}" y="{height - tall:.2f}" width="{step + 0.05:.2f}" '
            f'height="{tall:.2f}" fill="#{red:02x}{green:02x}{blue:02x}"/>'
        )
    parts.append(f'<path class="ink" d="M0 {height:.0f}H360"/>')
    marks = [*cuts] if mean_deg is None else [*cuts, (mean_deg % 360.0, "mean")]
    for place, kind in marks:
        parts.append(
            f'<path class="{kind}" d="M{place:.1f} -4V{height:.0f}"/>'
            f'<text class="label mid" x="{place:.1f}" y="-8">{escape(kind)}</text>'
        )
    for degrees, name in ((0, "0° red"), (120, "120° green"), (240, "240° blue"), (360, "360°")):
        parts.append(f'<text class="label mid" x="{degrees}" y="138">{name}</text>')
    return "".join([*parts, "</svg>"])
