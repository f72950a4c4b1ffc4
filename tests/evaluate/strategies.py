"""Random boxes, and an oracle: pycocotools."""

from __future__ import annotations

import contextlib
import io
from typing import NamedTuple

import numpy as np
from hypothesis import strategies as st
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval


class View(NamedTuple):
    boxes: np.ndarray
    scores: np.ndarray
    truth: np.ndarray
    ignore: np.ndarray
    regions: np.ndarray


def _boxes(rng: np.random.Generator, count: int) -> np.ndarray:
    corner = rng.uniform(0.0, 60.0, (count, 2))
    return np.concatenate([corner, corner + rng.uniform(4.0, 30.0, (count, 2))], axis=1)


@st.composite
def views(draw: st.DrawFn, most: int = 6) -> list[View]:
    """Some views with finds near the truth, finds anywhere, and things to ignore."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    made = []
    for _ in range(draw(st.integers(1, most))):
        truth = _boxes(rng, int(rng.integers(0, 6)))
        near = np.repeat(truth, rng.integers(0, 3, len(truth)), axis=0)
        near = near + rng.normal(0.0, draw(st.sampled_from([0.0, 1.0, 4.0])), near.shape)
        near[:, 2:] = np.maximum(near[:, 2:], near[:, :2] + 1.0)
        boxes = np.concatenate([near, _boxes(rng, int(rng.integers(0, 6)))])
        # scores of any range, with ties
        scores = np.round(rng.normal(5.0, 3.0, len(boxes)), draw(st.sampled_from([0, 2])))
        kind = rng.choice(3, len(truth), p=(0.6, 0.2, 0.2))
        made.append(View(boxes, scores, truth, kind == 1, kind == 2))
    return made


def coco_ap(made: list[View], iou: float, most: int = 100) -> float | None:
    """Return the average precision that pycocotools finds; None where it says there is no truth."""
    images, annotations, finds = [], [], []
    for number, view in enumerate(made, start=1):
        images.append({"id": number, "width": 100, "height": 100})
        for box, ignore, region in zip(view.truth, view.ignore, view.regions, strict=True):
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": number,
                    "category_id": 1,
                    "bbox": [*box[:2], *(box[2:] - box[:2])],
                    # what is out of the range of areas is ignored without being a crowd
                    "area": 2e9 if ignore else 100.0,
                    "iscrowd": int(region),
                }
            )
        finds += [
            {
                "image_id": number,
                "category_id": 1,
                "bbox": [*box[:2], *(box[2:] - box[:2])],
                "score": float(score),
            }
            for box, score in zip(view.boxes, view.scores, strict=True)
        ]
    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO()
        truth.dataset = {
            "info": {},
            "images": images,
            "annotations": annotations,
            "categories": [{"id": 1, "name": "person"}],
        }
        truth.createIndex()
        if not finds or not annotations:
            return None
        judge = COCOeval(truth, truth.loadRes(finds), "bbox")
        judge.params.iouThrs = np.array([iou])
        judge.params.maxDets = [most]
        judge.params.areaRng = [[0.0, 1e9]]
        judge.params.areaRngLbl = ["all"]
        judge.evaluate()
        judge.accumulate()
    precision = judge.eval["precision"][0, :, 0, 0, 0]
    return None if (precision < 0.0).any() else float(precision.mean())
