"""Real thermal photos: JKU's flight F0, three people under trees, and who finds them.

    python bench/thermal_f0.py F0        F0: a folder with all 382 photos and their poses.json

Writes bench/THERMAL.md. The flight is JKU's (https://github.com/JKU-ICG/AOS, for research and
education) and no part of this project; nothing was trained on it. Where people lie was read by eye
from the integral image of all photos, 18 units below the origin of the poses. In parts of the
flight some of them are hardly to be seen; they count all the same.
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

PAGE = Path(__file__).with_name("THERMAL.md")
FOV_DEG = 50.815436217896945
GROUND_DOWN_M = 18.0
REACH_M = 22.0
PEOPLE_M = np.array(
    [[-8.45, -4.05, -10.0, -1.85], [-13.2, 0.95, -14.6, 3.65], [-14.85, -7.65, -16.7, -6.5]]
)
"""Northern, western, southern and eastern edge of each."""

SAMPLINGS_M = (0.05, 0.09)
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


def main() -> int:
    quiet_start()
    flight = hsvaos.open_flight(sys.argv[1], fov_deg=FOV_DEG)
    images = np.stack(list(flight.images()))
    integrator = Integrator(flight.camera, images, flight.poses)
    score, ways, rows = Detector().score, contenders(), []
    for gsd in SAMPLINGS_M:
        edges = (np.array([REACH_M, -REACH_M] * 2) - PEOPLE_M) / [gsd, -gsd, gsd, -gsd]
        truth = edges[:, [1, 0, 3, 2]] - 0.5
        side = int(2.0 * REACH_M / gsd)
        view = VirtualCamera.ortho(REACH_M, -REACH_M, gsd, side, side)
        matches: dict[str, dict[float, list[Matches]]] = {
            name: {iou: [] for iou in IOUS} for name in ways
        }
        for chosen in parts(len(flight)):
            seen = integrator.integrate(view, FocalPlane(GROUND_DOWN_M), frames=np.array(chosen))
            image, rays = np.array(seen[0]).reshape(side, side), np.array(seen[1])
            image[rays <= 0.0] = np.nan
            for name, find in ways.items():
                found = find(image, rays, gsd)
                for iou, own in matches[name].items():
                    own.append(match_boxes(found.boxes_xyxy, found.scores, truth, iou))
        for name, by in matches.items():
            curves = {iou: Matches.join(own).curve() for iou, own in by.items()}
            sure = np.flatnonzero(curves[0.25].scores >= score)
            known = not name.startswith("peaks") and sure.size > 0
            at = (curves[0.25].precision[sure[-1]], curves[0.25].recall[sure[-1]]) if known else ()
            figures = (cell(curves[iou].ap_coco101) for iou in IOUS)
            rows.append((f"{gsd:g}", name, *figures, *(map(cell, at) if known else ("-", "-"))))
    head = ("m a pixel", "method", "AP .10", "AP .25", "AP .50", "precision", "recall")
    text = [
        "# Real thermal photos\n",
        "Made by `python bench/thermal_f0.py F0`: JKU's thermal flight F0, 382 photos of 512 x 512 "
        f"over a forest with three people, in {len(list(parts(len(flight))))} integral images: all "
        "photos, stretches of 60, and every sixth one. Nothing was trained on it, but it was "
        "looked at while the network for grey images was made. Boxes were drawn by eye; people "
        "hardly to be seen in some stretches count too. Precision and recall at the default "
        "threshold, IoU .25.\n",
        markdown_table(head, rows),
    ]
    PAGE.write_text("\n".join(text).rstrip() + "\n", encoding="utf-8")
    print(PAGE.read_text(encoding="utf-8"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
