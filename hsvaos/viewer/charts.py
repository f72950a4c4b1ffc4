"""The two charts of the panel, as what viser's uPlot takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.settings import MaskSettings
from hsvaos.viewer.focus import FocusCurve
from hsvaos.viewer.session import Session

_HUE_STEP_DEG = 2.0
_SCALES = {"x": {"time": False}}
_RED, _GREY, _BLUE, _GOLD = "#d9480f", "#868e96", "#1c7ed6", "#e8a200"


def focus_chart(curve: FocusCurve | None, down_m: float) -> dict[str, Any]:
    """Return the focus curve: data and series of a chart.

    Args:
        curve: The curve; None before it was measured.
        down_m: Depth of the focal surface, marked in the chart [m].
    """
    series = (
        {"label": "down"},
        {"label": "plain", "stroke": _BLUE, "width": 2},
        {"label": "rarity", "stroke": _GOLD, "width": 2},
        {"label": "here", "stroke": _RED, "width": 2},
    )
    if curve is None:
        return {"data": (np.array([0.0, 1.0]),) * 4, "series": series, "scales": _SCALES}
    here = np.zeros(len(curve.downs_m))
    here[np.argmin(np.abs(curve.downs_m - down_m))] = 1.0
    data = (curve.downs_m, _unit(curve.plain), _unit(curve.rarity), here)
    return {"data": data, "series": series, "scales": _SCALES}


def hue_chart(session: Session, mask: MaskSettings, first: float) -> dict[str, Any]:
    """Return the hue histogram of the flight with what is cut in red.

    Args:
        session: Colour photos.
        mask: Statistics and cut.
        first: First hue of the axis [deg].
    """
    histograms, _ = session.weights.histograms(mask.statistics)
    whole = histograms.sum(axis=0)
    every = max(1, round(_HUE_STEP_DEG * whole.size / 360.0))
    coarse = whole.reshape(-1, every).sum(axis=1) if whole.size % every == 0 else whole
    centres = (np.arange(coarse.size) + 0.5) * (360.0 / coarse.size)
    hues = np.sort((centres - first) % 360.0 + first)
    heights = np.interp(hues % 360.0, centres, coarse, period=360.0)
    heights = heights / max(float(heights.max()), 1e-12)
    stats = session.weights.hue_stats(mask)
    middle = sorted(stats, key=lambda one: one.sigma_deg)[len(stats) // 2]
    away = np.abs((hues - middle.mean_deg + 180.0) % 360.0 - 180.0)
    inside = (away <= middle.half_width_deg) & middle.informative
    cut: NDArray[np.float64] = np.where(inside, heights, 0.0)
    series = (
        {"label": "hue"},
        {"label": "share", "stroke": _GREY, "width": 1.5},
        {"label": "cut", "stroke": _RED, "fill": _RED + "55", "width": 1.5},
    )
    return {"data": (hues, heights, cut), "series": series, "scales": _SCALES}


def _unit(curve: NDArray[np.float64]) -> NDArray[np.float64]:
    """A curve on a logarithmic scale from 0 to 1; 0 where nothing was seen."""
    seen = curve > 0.0
    if not seen.any():
        return np.zeros_like(curve)
    heights = np.log(np.where(seen, curve, curve[seen].min()))
    return np.asarray((heights - heights.min()) / (float(np.ptp(heights)) or 1.0))
