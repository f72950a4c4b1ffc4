"""Real thermal photos: JKU's flight F0, three people under trees, an open field; who finds them.

    python bench/thermal.py F0 FIELD     F0: a folder with all 382 photos and their poses.json;
                                         FIELD: JKU's pictures of an open field, may be left out

Writes bench/THERMAL.md. The flights are JKU's (https://github.com/JKU-ICG/AOS, for research and
education) and no part of this project; nothing was trained on them. Where F0's people lie was read
by eye from the integral image of all photos, 18 units below the origin of the poses. In parts of
the flight some of them are hardly to be seen; they count all the same.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import hsvaos
from hsvaos import Detector, FocalPlane, Integrator, VirtualCamera
from hsvaos.detect.anomaly import find_persons
from hsvaos.detect.detections import Detections
from hsvaos.detect.yolo import PACKAGED
from hsvaos.evaluate.detection import Matches, match_boxes
from hsvaos.evaluate.tables import cell, markdown_table
from hsvaos.kernels.device import quiet_start
from hsvaos.settings import DetectSettings

try:
    from thermal_field import PERSON_PX, field_pictures  # run as a script
except ImportError:
    from bench.thermal_field import PERSON_PX, field_pictures

PAGE = Path(__file__).with_name("THERMAL.md")
FOV_DEG = 50.815436217896945
GROUND_DOWN_M = 18.0
REACH_M = 22.0
PEOPLE_M = np.array(
    [[-8.45, -4.05, -10.0, -1.85], [-13.2, 0.95, -14.6, 3.65], [-14.85, -7.65, -16.7, -6.5]]
)
"""Northern, western, southern and eastern edge of each."""

SAMPLINGS_M = (0.05, 0.09)
FIELD_GSD_M = 0.06
IOUS = (0.10, 0.25, 0.50)
FLOOR = 0.02

Find = Callable[[np.ndarray, np.ndarray, float], Detections]


def parts(count: int) -> Iterator[list[int]]:
    """Yield the photos of each integral image: all, eight stretches of 60, every sixth one."""
    yield list(range(count))
    for first in range(0, count - 60, 40):
        yield list(range(first, first + 60))
    for first in range(6):
        yield list(range(first, count, 6))


def contenders() -> dict[str, Find]:
    """Return the ways of finding people, by name."""
    ours, colour = Detector(score=FLOOR), Detector(PACKAGED.read_bytes(), score=FLOOR)
    low = replace(DetectSettings(), min_z=1.0)
    return {
        "hsvaos": lambda a, rays, gsd: ours.detect(a, footprint=rays, gsd_m=gsd),
        "hsvaos, image alone, sampling unknown": lambda a, rays, gsd: ours.detect(a),
        "its colour network": lambda a, rays, gsd: colour.detect(a, footprint=rays, gsd_m=gsd),
        "peaks of local contrast, no weights": lambda a, rays, gsd: find_persons(
            np.nan_to_num(a), rays, gsd, low
        ),
    }


def f0_pictures(folder: str, gsd: float) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield integral images of F0 with their rays, and the people's boxes [px]."""
    flight = hsvaos.open_flight(folder, fov_deg=FOV_DEG)
    integrator = Integrator(flight.camera, np.stack(list(flight.images())), flight.poses)
    edges = (np.array([REACH_M, -REACH_M] * 2) - PEOPLE_M) / [gsd, -gsd, gsd, -gsd]
    side = int(2.0 * REACH_M / gsd)
    view = VirtualCamera.ortho(REACH_M, -REACH_M, gsd, side, side)
    for chosen in parts(len(flight)):
        seen = integrator.integrate(view, FocalPlane(GROUND_DOWN_M), frames=np.array(chosen))
        image, rays = np.array(seen[0]).reshape(side, side), np.array(seen[1])
        image[rays <= 0.0] = np.nan
        yield image, rays, edges[:, [1, 0, 3, 2]] - 0.5


def figures(name: str, by: dict[float, list[Matches]], score: float) -> tuple[str, ...]:
    """Return average precisions, and precision and recall at the default threshold."""
    curves = {iou: Matches.join(own).curve() for iou, own in by.items()}
    sure = np.flatnonzero(curves[0.25].scores >= score)
    known = not name.startswith("peaks") and sure.size > 0
    at = (curves[0.25].precision[sure[-1]], curves[0.25].recall[sure[-1]]) if known else ()
    aps = (cell(curves[iou].ap_coco101) for iou in IOUS)
    return (*aps, *(map(cell, at) if known else ("-", "-")))


def none_yet(ways: dict[str, Find]) -> dict[str, dict[float, list[Matches]]]:
    """Return room for the matches of each way of finding people."""
    return {name: {iou: [] for iou in IOUS} for name in ways}


def main() -> int:
    quiet_start()
    score, ways, rows = Detector().score, contenders(), []
    for gsd in SAMPLINGS_M:
        matches = none_yet(ways)
        for image, rays, truth in f0_pictures(sys.argv[1], gsd):
            for name, find in ways.items():
                found = find(image, rays, gsd)
                for iou, own in matches[name].items():
                    own.append(match_boxes(found.boxes_xyxy, found.scores, truth, iou))
        rows += [(f"{gsd:g}", name, *figures(name, by, score)) for name, by in matches.items()]
    head = ("m a pixel", "method", "AP .10", "AP .25", "AP .50", "precision", "recall")
    text = [
        "# Real thermal photos\n",
        "Made by `python bench/thermal.py F0 FIELD`. Precision and recall are those at the default "
        "threshold, IoU .25. Nothing was trained on these pictures, but they were looked at while "
        "the network for grey images was made, and the sizes at which it looks were chosen by "
        "them.\n",
        "## Forest\n",
        f"JKU's thermal flight F0, 382 photos of 512 x 512 over a forest with three people, in "
        f"{len(list(parts(382)))} integral images: all photos, stretches of 60, and every sixth "
        "one. Boxes were drawn by eye; people hardly to be seen in some stretches count too.\n",
        markdown_table(head, rows),
    ]
    if len(sys.argv) > 2:
        text += ["\n## Open field\n", *of_field(Path(sys.argv[2]), ways, score)]
    PAGE.write_text("\n".join(text).rstrip() + "\n", encoding="utf-8")
    print(PAGE.read_text(encoding="utf-8"))
    return 0


def of_field(folder: Path, ways: dict[str, Find], score: float) -> list[str]:
    """Return what JKU's own integral pictures of an open field give, for the page."""
    alone = {name: find for name, find in ways.items() if name != "hsvaos"}
    matches, count = none_yet(alone), 0
    for picture, boxes, spared in field_pictures(folder):
        rays = np.ones(picture.shape, np.float32)
        for name, find in alone.items():
            found = find(picture.astype(np.float32), 100.0 * rays, FIELD_GSD_M)
            for iou, own in matches[name].items():
                part = match_boxes(found.boxes_xyxy, found.scores, boxes, iou, ignore=spared)
                own.append(part)
        count += 1
    rows = [(name, *figures(name, by, score)) for name, by in matches.items()]
    head = ("method", "AP .10", "AP .25", "AP .50", "precision", "recall")
    return [
        f"{count} integral pictures as JKU published them (see `bench/thermal_field.py`): one "
        f"person, who is in {len(PERSON_PX)} of them. Their sampling is not told; where a method "
        f"must know one it is told {FIELD_GSD_M:g} m.\n",
        markdown_table(head, rows),
    ]


if __name__ == "__main__":
    sys.exit(main())
