"""How sharp each depth is in the viewer's picture, and films of a sweep through them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.focusing import clearest_focus
from hsvaos.kernels.sweep import focus_measure
from hsvaos.viewer.pace import Quality
from hsvaos.viewer.picture import Rgb
from hsvaos.viewer.render import integral
from hsvaos.viewer.request import Request, resized
from hsvaos.viewer.session import Session
from hsvaos.viewer.weights import Abandoned, Wanted

_CURVE_PX = 320
"""Longest side of the pictures that sharpness is measured in."""

Step = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class FocusCurve:
    """Sharpness of small things by depth.

    Args:
        downs_m: Shape (D,), depths [m].
        plain: Shape (D,), kurtosis of the plain integral.
        rarity: Shape (D,), kurtosis of the rarity map.
        best_m: Depth of the most prominent peak of either [m].
        prominence: How far it rises above its valleys; 0 where there is no inner peak.
    """

    downs_m: NDArray[np.float64]
    plain: NDArray[np.float64]
    rarity: NDArray[np.float64]
    best_m: float
    prominence: float


def focus_curve(
    session: Session,
    request: Request,
    span: tuple[float, float],
    steps: int = 40,
    wanted: Wanted = lambda: True,
    progress: Step | None = None,
) -> FocusCurve:
    """Measure sharpness over depth as `hsvaos run --autofocus` does, in this view and aperture.

    Args:
        session: The flight.
        request: View, tilt or terrain, and aperture.
        span: First and last depth [m].
        steps: Number of depths.
        wanted: Asked between them.
        progress: Told of every depth.

    Raises:
        Abandoned: If it is no longer wanted.
        ValueError: If the range is empty.
    """
    if not (np.isfinite(span).all() and span[0] < span[1]) or steps < 3:
        raise ValueError(f"a focus curve needs a range of depths and 3 steps, got {span}, {steps}")
    view = resized(request.view, min(1.0, _CURVE_PX / max(request.view.size)))
    frames = session.frames(request)
    kinds = ("plain", "rarity_map")
    by = [session.weights.integrator(kind, request.mask, wanted) for kind in kinds]
    downs = np.linspace(*span, steps)
    curves = np.zeros((2, steps))
    for i, down in enumerate(downs):
        if not wanted():
            raise Abandoned
        surface = session.surface(replace(request.focus, down_m=float(down)))
        for curve, integrator in zip(curves, by, strict=True):
            image, footprint = integral(integrator, view, surface, frames)
            curve[i] = focus_measure(image[None], footprint[None])[0]
        if progress is not None:
            progress(i + 1, steps)
    best, prominence = clearest_focus(downs, curves)
    return FocusCurve(downs, curves[0], curves[1], best, prominence)


def sweep_pictures(
    session: Session,
    request: Request,
    downs_m: NDArray[np.float64],
    wanted: Wanted = lambda: True,
    progress: Step | None = None,
) -> list[Rgb]:
    """Render the request's picture at many depths, each labelled with its depth.

    Args:
        session: The flight.
        request: What to show.
        downs_m: Shape (D,), depths [m].
        wanted: Asked between them.
        progress: Told of every depth.

    Raises:
        Abandoned: If it is no longer wanted.
    """
    pictures = []
    for i, down in enumerate(downs_m):
        focus = replace(request.focus, down_m=float(down))
        picture = session.render(replace(request, focus=focus), Quality(), wanted)
        pictures.append(_labelled(picture.rgb, f"down {down:.2f} m"))
        if progress is not None:
            progress(i + 1, len(downs_m))
    return pictures


def _labelled(picture: Rgb, text: str) -> Rgb:
    out = np.ascontiguousarray(picture)
    place = (10, out.shape[0] - 12)
    for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(out, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, thick, cv2.LINE_AA)
    return out
