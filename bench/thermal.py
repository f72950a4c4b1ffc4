"""Real thermal photos: JKU's flight F0, three people under trees, an open field; who finds them.

    python bench/thermal.py F0 FIELD     F0: a folder with all 382 photos and their poses.json;
                                         FIELD: JKU's pictures of an open field

Writes bench/THERMAL.md. The flights are JKU's (https://github.com/JKU-ICG/AOS, for research and
education) and no part of this project; nothing was trained on them. Where F0's people lie was read
by eye from the integral image of all photos, 18 units below the origin of the poses. In parts of
the flight some of them are hardly to be seen; they count all the same.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import hsvaos
from hsvaos import Detector, FocalPlane, Integrator, VirtualCamera
from hsvaos.detect.anomaly import find_persons
from hsvaos.detect.detections import Detections
from hsvaos.detect.yolo import PACKAGED_PICTURE
from hsvaos.evaluate.detection import Matches, match_boxes
from hsvaos.evaluate.tables import cell, markdown_table
from hsvaos.kernels.device import quiet_start
from hsvaos.settings import DetectSettings

try:
    from thermal_field import FIRST, LAST, PERSON_PX, field_pictures  # run as a script
except ImportError:
    from bench.thermal_field import FIRST, LAST, PERSON_PX, field_pictures

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
Row = tuple[str, ...]
Picture = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Image, rays, boxes of people [px], and which of them need not be found."""


def parts(count: int) -> Iterator[list[int]]:
    """Yield the photos of each integral image: all, eight stretches of 60, every sixth one."""
    yield list(range(count))
    for first in range(0, count - 60, 40):
        yield list(range(first, first + 60))
    for first in range(6):
        yield list(range(first, count, 6))


def contenders() -> dict[str, Find]:
    """Return the ways of finding people, by name."""
    ours, colour = Detector(score=FLOOR), Detector(PACKAGED_PICTURE, score=FLOOR)
    low = replace(DetectSettings(), min_z=1.0)
    return {
        "hsvaos": lambda a, rays, gsd: ours.detect(a, footprint=rays, gsd_m=gsd),
        "hsvaos, image alone, sampling unknown": lambda a, rays, gsd: ours.detect(a),
        "its colour network": lambda a, rays, gsd: colour.detect(a, footprint=rays, gsd_m=gsd),
        "peaks of local contrast, no weights": lambda a, rays, gsd: find_persons(
            np.nan_to_num(a), rays, gsd, low
        ),
    }


def f0_pictures(flight: hsvaos.Flight, integrator: Integrator, gsd: float) -> Iterator[Picture]:
    """Yield the integral images of F0."""
    edges = (np.array([REACH_M, -REACH_M] * 2) - PEOPLE_M) / [gsd, -gsd, gsd, -gsd]
    side = int(2.0 * REACH_M / gsd)
    view = VirtualCamera.ortho(REACH_M, -REACH_M, gsd, side, side)
    for chosen in parts(len(flight)):
        seen = integrator.integrate(view, FocalPlane(GROUND_DOWN_M), frames=np.array(chosen))
        image, rays = np.array(seen[0]).reshape(side, side), np.array(seen[1])
        image[rays <= 0.0] = np.nan
        yield image, rays, edges[:, [1, 0, 3, 2]] - 0.5, np.zeros(len(edges), np.bool_)


def field(folder: Path) -> Iterator[Picture]:
    """Yield JKU's own integral pictures, which are of 30 photos each."""
    for picture, boxes, spared in field_pictures(folder):
        yield picture.astype(np.float32), np.full(picture.shape, 30.0, np.float32), boxes, spared


def rows_of(ways: dict[str, Find], pictures: Iterable[Picture], gsd: float) -> list[Row]:
    """Return a row of figures for each way of finding people in pictures of one sampling."""
    matches: dict[str, dict[float, list[Matches]]] = {
        name: {iou: [] for iou in IOUS} for name in ways
    }
    for image, rays, boxes, spared in pictures:
        for name, find in ways.items():
            found = find(image, rays, gsd)
            for iou, own in matches[name].items():
                one = match_boxes(found.boxes_xyxy, found.scores, boxes, iou, ignore=spared)
                own.append(one)
    return [(name, *figures(name, by)) for name, by in matches.items()]


def figures(name: str, by: dict[float, list[Matches]]) -> Row:
    """Return average precisions, and precision and recall at the default threshold."""
    curves = {iou: Matches.join(own).curve() for iou, own in by.items()}
    sure = np.flatnonzero(curves[0.25].scores >= Detector().score)
    known = not name.startswith("peaks") and sure.size > 0
    at = (curves[0.25].precision[sure[-1]], curves[0.25].recall[sure[-1]]) if known else ()
    aps = (cell(curves[iou].ap_coco101) for iou in IOUS)
    return (*aps, *(map(cell, at) if known else ("-", "-")))


def main() -> int:
    parser = argparse.ArgumentParser(description="Who finds people in JKU's thermal images.")
    parser.add_argument("f0", type=Path, help="a folder with all 382 photos and their poses.json")
    parser.add_argument("field", type=Path, help="the folder with 0_29.png to 0_78.png")
    asked = parser.parse_args()
    quiet_start()
    ways, forest = contenders(), []
    flight = hsvaos.open_flight(asked.f0, fov_deg=FOV_DEG)
    integrator = Integrator(flight.camera, np.stack(list(flight.images())), flight.poses)
    for gsd in SAMPLINGS_M:
        rows = rows_of(ways, f0_pictures(flight, integrator, gsd), gsd)
        forest += [(f"{gsd:g}", *row) for row in rows]
    del ways["hsvaos"]  # nobody tells the sampling of the others
    open_field = rows_of(ways, field(asked.field), FIELD_GSD_M)
    head = ("method", "AP .10", "AP .25", "AP .50", "precision", "recall")
    text = [
        "# Real thermal photos\n",
        "Made by `python bench/thermal.py F0 FIELD`. Precision and recall are those at the default "
        "threshold, IoU .25. Nothing was trained on these pictures, but they were looked at while "
        "the network for grey images was made, and the sizes at which it looks were chosen by "
        "them.\n",
        "## Forest\n",
        f"JKU's thermal flight F0, {len(flight)} photos of 512 x 512 over a forest with three "
        f"people, in {len(list(parts(len(flight))))} integral images: all photos, stretches of 60, "
        "and every sixth one. Boxes were drawn by eye; people hardly to be seen in some stretches "
        "count too.\n",
        markdown_table(("m a pixel", *head), forest),
        "## Open field\n",
        f"{LAST - FIRST + 1} integral pictures as JKU published them (see "
        f"`bench/thermal_field.py`): one person, who is in {len(PERSON_PX)} of them. Their "
        f"sampling is not told; where a method must know one it is told {FIELD_GSD_M:g} m.\n",
        markdown_table(head, open_field),
    ]
    PAGE.write_text("\n".join(text).rstrip() + "\n", encoding="utf-8")
    print(PAGE.read_text(encoding="utf-8"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
