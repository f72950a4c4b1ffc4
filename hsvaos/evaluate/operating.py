"""Finds for curves go down to weak ones; persons are merged from what a run reports by default."""

from __future__ import annotations

from typing import Any

from hsvaos.detect.detections import Detections, Person
from hsvaos.detect.locate import ViewFinds, box_places, merge_views
from hsvaos.evaluate.results import rendered_views
from hsvaos.finding import operating_scores
from hsvaos.kernels.rays import focal_points
from hsvaos.result import Result
from hsvaos.settings import Settings

_TAIL = 0.5
"""Peaks of a curve go down to this share of the local z from which a run reports them."""

_LEAST_SCORE = 0.02
"""Boxes of a network go down to this score."""

_MOST = 100
"""Finds kept in a view, as COCO keeps them."""


def widened(settings: Settings) -> Settings:
    """Return settings that keep weaker finds too, so that curves do not end where reports do."""
    detect = settings.detect
    low = {
        "min_z": _TAIL * detect.min_z,
        "min_score": min(_LEAST_SCORE, *operating_scores(detect)),
        "max_finds": max(detect.max_finds, _MOST),
    }
    return settings.with_values(detect=low)


def persons_from(result: Result, settings: Settings, device: Any) -> tuple[Person, ...]:
    """Return the persons that a run reports, from a run that kept weaker finds too.

    Args:
        result: Of a run with `widened` settings.
        settings: The settings before they were widened.
        device: Where to cast rays.
    """
    detect = settings.detect
    colour = result.photo.ndim == 3
    score = operating_scores(detect, colour).of_persons
    finds = []
    for (_, found), view in zip(result.views, rendered_views(result), strict=True):
        kept = _strongest(found, score, detect.max_finds)
        hits = focal_points(view, result.surface, device=device).numpy()
        hits = hits.reshape(view.height, view.width, 4)
        finds.append(ViewFinds(view, kept, *box_places(kept, hits, view)))
    least = score * detect.min_agreement
    return merge_views(finds, detect.person_m, least, result.flight.origin)


def _strongest(found: Detections, score: float, most: int) -> Detections:
    keep = (found.scores >= score).nonzero()[0][:most]  # strongest first already
    return Detections(found.boxes_xyxy[keep], found.scores[keep], found.class_ids[keep])
