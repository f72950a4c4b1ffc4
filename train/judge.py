"""Average precision of a network on the maps of flights it was not trained on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from hsvaos.detect.few_rays import doubted
from hsvaos.detect.network_input import CHANNELS
from hsvaos.evaluate.detection import Matches, match_boxes
from train.looks import Look, input_of
from train.net import MULTIPLE, Exported, PersonNet
from train.samples import LEAST_RAYS_SEEN

REACHED = 1.5
"""Unoccluded rays a point from which a person is to be found; others are ignored."""

IOUS = (0.10, 0.25, 0.50)

Judged = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
"""What a network is judged by: its input (25, H, W), rays (H, W), boxes of people (K, 4), and
unoccluded rays (K,)."""

_FLOOR = 0.02
NMS_IOU = 0.25
"""Overlap from which two boxes are one person."""


def finds(net: nn.Module, whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return boxes and scores of a network's input, without doubles.

    Args:
        net: The network as exported.
        whole: Shape (25, H, W), from `network_input`.
    """
    height, width = (-(-side // MULTIPLE) * MULTIPLE for side in whole.shape[1:])
    padded = np.zeros((1, len(whole), height, width), dtype=np.float32)
    padded[0, :, : whole.shape[1], : whole.shape[2]] = whole
    with torch.no_grad():
        boxes, scores = net(torch.from_numpy(padded))
    boxes, scores = boxes[0].numpy(), scores[0].numpy()
    chosen = np.flatnonzero(scores > _FLOOR)
    boxes, scores = boxes[chosen], scores[chosen]
    corners = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)
    kept = np.array(cv2.dnn.NMSBoxes(corners.tolist(), scores.tolist(), _FLOOR, NMS_IOU), dtype=int)
    return boxes[kept.reshape(-1)], scores[kept.reshape(-1)]


def from_maps(paths: Sequence[Path]) -> Iterator[Judged]:
    """Yield maps as a network is judged by them.

    Args:
        paths: Of maps.
    """
    for path in paths:
        whole, _, rays, people, reach = input_of(path, None)
        yield whole, rays, people, reach


def from_looks(looks: Sequence[Look]) -> Iterator[Judged]:
    """Yield looks as a network is judged by them; their candidates do not count.

    Args:
        looks: Of tuning flights.
    """
    for look in looks:
        whole = np.moveaxis(look.layers[..., : len(CHANNELS)], 2, 0)
        yield whole.astype(np.float32), look.rays.astype(np.float32), look.people, look.reach


def judge(every: Callable[[], Iterable[Judged]]) -> Callable[[PersonNet], dict[str, float]]:
    """Return what measures a network on maps.

    Args:
        every: Gives the maps.
    """
    return lambda net: figures_of(matched(net, every(), IOUS))


def figures_of(matches: dict[float, Matches]) -> dict[str, float]:
    """Return average precisions, and the recall at a precision of .95, as the curve lists them.

    Args:
        matches: By IoU threshold.
    """
    figures = {}
    for iou, own in matches.items():
        curve = own.curve()
        figures[f"ap{round(100 * iou)}"] = round(float(curve.ap_coco101 or 0.0), 4)
        if iou == 0.25:
            good = curve.precision >= 0.95
            figures["recall95"] = round(float(curve.recall[good].max(initial=0.0)), 4)
    return figures


def threshold(net: PersonNet, every: Iterable[Judged], precision: float = 0.95) -> float:
    """Return the least score from which the finds on maps have a precision at IoU .25.

    Args:
        net: The network.
        every: The maps.
        precision: To be reached.
    """
    return round(least_score(matched(net, every, (0.25,))[0.25], precision), 3)


def least_score(matches: Matches, precision: float) -> float:
    """Return the least score from which finds have a precision; .5 where none has.

    Args:
        matches: Of the finds.
        precision: To be reached.
    """
    curve = matches.curve()
    good = np.flatnonzero(curve.precision >= precision)
    return float(curve.scores[good[-1]]) if good.size else 0.5


def matched(
    net: PersonNet, every: Iterable[Judged], ious: tuple[float, ...]
) -> dict[float, Matches]:
    """Return the finds of a network on maps, matched with the truth, by IoU threshold.

    Args:
        net: The network.
        every: The maps.
        ious: Thresholds.
    """
    exported = Exported(net).eval()
    parts: dict[float, list[Matches]] = {iou: [] for iou in ious}
    for whole, rays, people, reach in every:
        boxes, scores = finds(exported, whole)
        for iou, own in matched_finds(boxes, scores, rays, people, reach, ious).items():
            parts[iou].append(own)
    return {iou: Matches.join(own) for iou, own in parts.items()}


def matched_finds(
    boxes: NDArray[np.float32],
    scores: NDArray[np.float32],
    rays: NDArray[np.float32],
    people: NDArray[np.float32],
    reach: NDArray[np.float32],
    ious: tuple[float, ...],
) -> dict[float, Matches]:
    """Return the finds of one map, doubted as the detector does, matched with the truth, by IoU.

    Args:
        boxes: Shape (N, 4), pixel centres at integers [px].
        scores: Shape (N,), 0..1.
        rays: Shape (H, W), rays of each pixel.
        people: Shape (K, 4) [px].
        reach: Shape (K,), unoccluded rays a point; those below `REACHED` do not count.
        ious: Thresholds.
    """
    scores = doubted(boxes + 0.5, scores, rays)
    corner = np.array([rays.shape[1] - 1, rays.shape[0] - 1])
    middle = np.clip(np.rint(0.5 * (boxes[:, :2] + boxes[:, 2:])), 0, corner).astype(int)
    seen = rays[middle[:, 1], middle[:, 0]] >= LEAST_RAYS_SEEN
    return {
        iou: match_boxes(boxes[seen], scores[seen], people, iou, ignore=reach < REACHED)
        for iou in ious
    }
