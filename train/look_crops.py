"""Crops of looks, for the person network to be trained further on.

The looks of `train.second` hold many more flights than `train.samples` draws from, with people
placed as in a search, as the network's input stands ready there. Mostly it is given as `hsvaos run`
makes it, sometimes with less known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.network_input import CHANNELS
from train.classes import ByClass
from train.fit import BATCH, collate
from train.look_batches import LookBatches, nobodies
from train.looks import Look
from train.samples import CROP_PX, LEAST_RAYS, Sample, jittered, people_in, seen_at, turned

_KINDS = ("person", "nobody", "anywhere")
_SHARES = (0.65, 0.23, 0.12)
"""Of crops around a person, around a candidate that is nobody, and anywhere."""

_RESIZED = 0.3
_SIDES = (232, 284)
"""How often a crop is resized, and the sides of what is brought to `CROP_PX` then."""

_HURRIED, _GROUNDLESS = 0.2, 0.04
"""How often all is known but what single photos show, or all but the ground without trees."""

_PHOTOS, _GROUND = CHANNELS.index("fragments"), CHANNELS.index("ground light")


class LookCrops(LookBatches):
    """Endless batches of crops of looks; people drawn by occlusion class."""

    def batches(self, looks: Sequence[Look], rng: np.random.Generator) -> Iterator[Any]:
        """Yield batches as `train.fit.collate` makes them, without end."""
        right = ByClass(
            (k, i, str(one.classes[i]))
            for k, one in enumerate(looks)
            for i in np.flatnonzero(one.reach >= LEAST_RAYS).tolist()
        )
        wrong = nobodies(looks)
        sure = np.cumsum([looks[k].scores[i] for k, i in wrong])
        while True:
            samples = []
            for kind in rng.choice(_KINDS, BATCH, p=_SHARES):
                if kind == "person" and right.found:
                    k, i = right.drawn(1, rng)[0]
                    middle = _middle(looks[k].people[i])
                elif kind == "nobody" and wrong:
                    # what nearly passes for a person teaches most
                    k, i = wrong[np.searchsorted(sure, rng.uniform(0.0, sure[-1]))]
                    middle = _middle(looks[k].boxes[i])
                else:
                    k = int(rng.integers(len(looks)))
                    middle = rng.uniform(0.0, 1.0, 2) * looks[k].rays.shape[::-1]
                samples.append(crop_at(looks[k], middle, rng))
            yield collate(samples)


def _middle(box: NDArray[np.float32]) -> NDArray[np.float64]:
    return 0.5 * (box[:2] + box[2:]).astype(np.float64)


def crop_at(look: Look, middle: NDArray[np.float64], rng: np.random.Generator) -> Sample:
    """Return a varied crop that holds a place.

    Args:
        look: Of which map.
        middle: Shape (2,), x and y of the place [px]; anywhere in the middle four fifths.
        rng: Draws the variations.
    """
    side = CROP_PX
    if rng.uniform() < _RESIZED:
        side = int(rng.integers(*_SIDES))
    height, width = look.rays.shape
    corner = np.rint(middle - rng.uniform(0.1, 0.9, 2) * side)
    x, y = np.clip(corner, 0, np.maximum([width - side, height - side], 0)).astype(int)
    part = np.zeros((side, side, len(CHANNELS)), dtype=np.float32)
    cut = look.layers[y : y + side, x : x + side, : len(CHANNELS)]
    part[: cut.shape[0], : cut.shape[1]] = cut
    boxes = look.people.astype(np.float64)
    wanted = (look.reach >= LEAST_RAYS) & seen_at(look.rays, 0.5 * (boxes[:, :2] + boxes[:, 2:]))
    boxes -= [x, y, x, y]
    planes = np.moveaxis(part, 2, 0)
    if side != CROP_PX:
        planes = np.stack([cv2.resize(plane, (CROP_PX, CROP_PX)) for plane in planes])
        boxes = (boxes + 0.5) * (CROP_PX / side) - 0.5
    planes, boxes = turned(planes, boxes, rng)
    _forget(planes, rng)
    return Sample(jittered(planes, rng), *people_in(boxes, wanted, CROP_PX))


def _forget(planes: NDArray[np.float32], rng: np.random.Generator) -> None:
    """Leave out, sometimes, what is not known of every integral image; in place."""
    draw = rng.uniform()
    if draw < _HURRIED:
        planes[_PHOTOS:] = 0.0
    elif draw < _HURRIED + _GROUNDLESS:
        planes[_GROUND:] = 0.0
