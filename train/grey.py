"""Make the network for lone grey images: python -m train.grey WORK [--steps 1200]

Draws everything it learns from (`grey_scene.py`), trains, chooses the threshold on scenes of other
seeds and writes WORK/person_grey.onnx and WORK/curve.csv. Goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from hsvaos.detect.grey_input import GREY_CHANNELS, grey_input
from hsvaos.detect.yolo import Detector
from hsvaos.evaluate.detection import Matches, match_boxes
from train.export import export
from train.fit import BATCH, collate, fit
from train.grey_scene import LENGTH_PX, PERSON_M, GreyScene, grey_scene
from train.judge import IOUS, figures_of, finds, least_score
from train.net import Exported, PersonNet
from train.samples import CROP_PX, Sample

GSD_M = (0.07, round(PERSON_M / LENGTH_PX[0], 3))
"""Sampling distances that need no resampling [m/px]: people of 12 to 25 pixels. The network knows
longer ones too, but thermal photos are blurred: finer pixels show no more, and take longer."""

AIM_GSD_M = 0.08

WIDTHS = (16, 32, 56, 72, 48)
TUNING_SEED = 700_000
TUNING_SCENES = 60
CROPS_A_SCENE = 6
PRECISION = 0.95
"""On the tuning scenes, which are harder than real thermal images have been so far."""


def new_net() -> PersonNet:
    """Return a network of new weights."""
    return PersonNet(len(GREY_CHANNELS), WIDTHS)


class GreyCrops(IterableDataset[Any]):
    """Endless batches of crops of drawn scenes.

    Args:
        seed: Of everything that is drawn.
    """

    def __init__(self, seed: int) -> None:
        super().__init__()
        self.seed = seed

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        rng = np.random.default_rng([self.seed, worker.id if worker else 0, 5])
        pool: list[Sample] = []
        while True:
            pool += crops_of(grey_scene(rng), rng)
            if len(pool) >= 6 * BATCH:
                chosen = rng.permutation(len(pool))[:BATCH]
                yield collate([pool[i] for i in chosen])
                pool = [s for i, s in enumerate(pool) if i not in set(chosen.tolist())]


def crops_of(scene: GreyScene, rng: np.random.Generator) -> list[Sample]:
    """Cut crops out of a scene; people near a crop's edge neither count nor are forbidden.

    Args:
        scene: The scene.
        rng: Draws where.
    """
    whole = grey_input(scene.image)
    middles = 0.5 * (scene.boxes[:, :2] + scene.boxes[:, 2:])
    room = np.array(whole.shape[:0:-1]) - CROP_PX
    samples = []
    for _ in range(CROPS_A_SCENE):
        corner = rng.uniform(0.0, 1.0, 2) * room
        if len(middles) and rng.uniform() < 0.6:
            corner = middles[rng.integers(len(middles))] - rng.uniform(0.1, 0.9, 2) * CROP_PX
        x, y = np.clip(corner, 0, room).astype(int)
        inside = ((middles > [x, y]) & (middles < [x + CROP_PX, y + CROP_PX])).all(axis=1)
        moved = scene.boxes - [x, y, x, y]
        near = (moved[:, 2:] > 0.0).all(axis=1) & (moved[:, :2] < CROP_PX).all(axis=1)
        part = whole[:, y : y + CROP_PX, x : x + CROP_PX]
        samples.append(Sample(part, moved[inside], moved[near & ~inside]))
    return samples


def matched(net: PersonNet, ious: tuple[float, ...]) -> dict[float, Matches]:
    """Return the finds of a network on the tuning scenes, matched with the truth, by IoU."""
    exported = Exported(net).eval()
    parts: dict[float, list[Matches]] = {iou: [] for iou in ious}
    for k in range(TUNING_SCENES):
        scene = grey_scene(np.random.default_rng(TUNING_SEED + k))
        boxes, scores = finds(exported, grey_input(scene.image))
        for iou, own in parts.items():
            own.append(match_boxes(boxes, scores, scene.boxes, iou))
    return {iou: Matches.join(own) for iou, own in parts.items()}


def judged(net: PersonNet) -> dict[str, float]:
    """Return the figures of a network on the tuning scenes."""
    return figures_of(matched(net, IOUS))


def shifted(net: PersonNet, own: float, common: float) -> PersonNet:
    """Shift the scores so that a threshold moves: two networks, one threshold.

    Args:
        net: The network; changed.
        own: Its threshold.
        common: Where it shall lie.
    """
    with torch.no_grad():
        assert net.score.bias is not None
        net.score.bias += float(np.log(common / (1.0 - common)) - np.log(own / (1.0 - own)))
    return net


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m train.grey", description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--steps", type=int, default=1200)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    cv2.setNumThreads(1)  # before workers are forked: torch needs the cores
    net = fit(
        GreyCrops,
        asked.work,
        steps=asked.steps,
        seed=asked.seed,
        workers=asked.workers,
        tune=judged,
        tune_every=1000,
        new_net=new_net,
    )
    figures, own = judged(net), least_score(matched(net, (0.25,))[0.25], PRECISION)
    common = Detector().score
    story = {
        "recipe": "python -m train.grey",
        "steps": asked.steps,
        "crops": asked.steps * BATCH,
        "seed": asked.seed,
        "own_threshold": round(own, 3),
        "tuning": figures,
    }
    path = asked.work / "person_grey.onnx"
    export(shifted(net, own, common), path, common, story, GREY_CHANNELS, GSD_M, AIM_GSD_M)
    print(f"{path}: threshold {own:.3f} moved to {common:.3f}, {figures}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
