"""Who is in a view: the method that the settings name, over the layers it looks at."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from hsvaos.detect.anomaly import find_persons
from hsvaos.detect.detections import Detections
from hsvaos.detect.network_input import PHOTO_LAYERS
from hsvaos.detect.surroundings import REACH_M
from hsvaos.settings import DetectSettings

if TYPE_CHECKING:
    from hsvaos.detect.yolo import Detector


@dataclass(frozen=True, eq=False)
class Finder:
    """Looks for people in the layers of a view.

    Args:
        layers: Names of the layers it looks at: "plain", "chosen", "rarity", "rarity_map",
            "anomaly_map", "coherence", "fragments", "fragment_coherence", "ground"; the last three
            where there are some.
        scores: From which a find is reported in its view, and from which it counts for a person.
        min_agreement: Share of the second that a person's score, the mean over all views, must
            reach.
        find: Called with layers by name, each (image, footprint), and the ground sampling distance
            [m/px].
        reach_m: How far beyond the border of a view it wants to see [m].
    """

    layers: tuple[str, ...]
    scores: Scores
    min_agreement: float
    find: Callable[[Mapping[str, Any], float], Detections]
    reach_m: float = 0.0

    @property
    def least_score(self) -> float:
        """Score below which a person, seen over all views, is left out."""
        return self.scores.of_persons * self.min_agreement

    @property
    def looks_at_photos(self) -> bool:
        """Whether every photo is to be looked at for pieces of people."""
        return not PHOTO_LAYERS.keys().isdisjoint(self.layers)

    def __call__(self, layers: Mapping[str, Any], gsd_m: float) -> Detections:
        """Return the finds of a view.

        Args:
            layers: By name, at least those of `layers`: image (H, W, C) and footprint (H, W).
            gsd_m: Ground sampling distance [m/px].
        """
        return self.find(layers, gsd_m)


class Scores(NamedTuple):
    """From which scores finds count.

    What one view shows is judged alone, so few of its boxes may be wrong. A person may be less
    sure: who searches would rather go and look at one place too many in a flight.

    Attributes:
        of_boxes: In its view.
        of_persons: For a person over all views.
    """

    of_boxes: float
    of_persons: float


def operating_scores(settings: DetectSettings, colour: bool = True) -> Scores:
    """Return the scores from which finds count.

    Args:
        settings: The method and its thresholds.
        colour: Whether the photos are RGB.

    Raises:
        ValueError: If the threshold is the network's own and that cannot be read.
    """
    if settings.method != "network":
        return Scores(settings.min_z, settings.min_z)
    score = settings.min_score
    if score is not None:  # nothing need be read for that
        return Scores(score, score if settings.person_score is None else settings.person_score)
    from hsvaos.detect.yolo import Detector

    return _asked(settings, Detector(settings.model, settings.layout), colour)


def _asked(settings: DetectSettings, detector: Detector, colour: bool) -> Scores:
    own = settings.person_score
    if own is None:
        own = detector.person_score(all_known=colour and settings.inputs == "all")
    return Scores(detector.score, own)


def make_finder(
    settings: DetectSettings, photos: int, colour: bool = True, threads: int | None = None
) -> Finder | None:
    """Return what looks for people; None where nobody is looked for.

    Args:
        settings: The method and its thresholds.
        photos: Number of photos of the flight.
        colour: Whether they are RGB: grey ones are not looked at one by one.
        threads: CPU threads that a network uses; by default one a core.

    Raises:
        ValueError: If the network cannot be used, or is not there.
    """
    if not settings.enabled:
        return None
    if settings.method == "network":
        return _network_finder(settings, colour, threads)
    enough = replace(settings, min_rays=min(settings.min_rays, 0.5 * photos))
    layer = f"{settings.method}_map"

    def find(layers: Mapping[str, Any], gsd_m: float) -> Detections:
        values, rays = layers[layer]
        return find_persons(values[..., 0], rays, gsd_m, enough)

    return Finder((layer,), operating_scores(settings), settings.min_agreement, find)


def _network_finder(settings: DetectSettings, colour: bool, threads: int | None) -> Finder:
    from hsvaos.detect.yolo import Detector

    detector = Detector(settings.model, settings.layout, score=settings.min_score, threads=threads)
    scores = _asked(settings, detector, colour)
    least = min(scores)
    reach_m = REACH_M if detector.layout == "hsvaos" else 0.0

    def best(found: Detections) -> Detections:
        kept = slice(settings.max_finds)
        return Detections(found.boxes_xyxy[kept], found.scores[kept], found.class_ids[kept])

    def find_in_image(layers: Mapping[str, Any], gsd_m: float) -> Detections:
        image, footprint = layers["chosen"]
        return best(detector.detect(image, footprint=footprint, gsd_m=gsd_m, score=least))

    def find_in_all(layers: Mapping[str, Any], gsd_m: float) -> Detections:
        rarity, rays = layers["rarity_map"]
        found = detector.detect(
            layers["rarity"][0],
            footprint=rays,
            rarity=rarity[..., 0],
            plain=layers["plain"][0],
            coherence=layers["coherence"],
            fragments=layers["fragments"][0][..., 0] if "fragments" in layers else None,
            fragment_coherence=layers.get("fragment_coherence"),
            ground=layers.get("ground"),
            gsd_m=gsd_m,
            score=least,
        )
        return best(found)

    if settings.inputs == "image" or detector.layout != "hsvaos":
        return Finder(("chosen",), scores, settings.min_agreement, find_in_image, reach_m)
    looked_at: tuple[str, ...] = ("rarity_map", "rarity", "plain", "coherence")
    if settings.inputs == "all" and colour:
        looked_at = (*looked_at, *detector.photo_layers)
    return Finder(looked_at, scores, settings.min_agreement, find_in_all, reach_m)
