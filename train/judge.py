"""Average precision of a network on the maps of flights it was not trained on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn

from hsvaos.detect.few_rays import doubted
from hsvaos.detect.network_input import AIM_GSD_M, TRAINED_GSD_M, network_input
from hsvaos.evaluate.detection import Matches, match_boxes
from train.maps import (
    COHERENCE,
    COHERENT,
    FRAGMENT_COHERENCE,
    FRAGMENT_COLOUR,
    FRAGMENTS,
    GROUND,
    GROUND_RAYS,
    PLANES,
    RARITY_MAP,
    RAYS,
    agreed_in,
)
from train.net import MULTIPLE, Exported, PersonNet
from train.samples import LEAST_RAYS_SEEN, at_sampling

REACHED = 1.5
"""Unoccluded rays a point from which a person is to be found; others are ignored."""

IOUS = (0.10, 0.25, 0.50)

_FLOOR = 0.02
_NMS = 0.25


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
    kept = np.array(cv2.dnn.NMSBoxes(corners.tolist(), scores.tolist(), _FLOOR, _NMS), dtype=int)
    return boxes[kept.reshape(-1)], scores[kept.reshape(-1)]


def judge(paths: list[Path]) -> Callable[[PersonNet], dict[str, float]]:
    """Return what measures a network on maps.

    Args:
        paths: Of maps.
    """
    return lambda net: figures_of(matched(net, paths, IOUS))


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


def threshold(net: PersonNet, paths: list[Path], precision: float = 0.95) -> float:
    """Return the least score from which the finds on maps have a precision at IoU .25.

    Args:
        net: The network.
        paths: Of maps.
        precision: To be reached.
    """
    return round(least_score(matched(net, paths, (0.25,))[0.25], precision), 3)


def least_score(matches: Matches, precision: float) -> float:
    """Return the least score from which finds have a precision; .5 where none has.

    Args:
        matches: Of the finds.
        precision: To be reached.
    """
    curve = matches.curve()
    good = np.flatnonzero(curve.precision >= precision)
    return float(curve.scores[good[-1]]) if good.size else 0.5


def matched(net: PersonNet, paths: list[Path], ious: tuple[float, ...]) -> dict[float, Matches]:
    """Return the finds of a network on maps, matched with the truth, by IoU threshold.

    Args:
        net: The network.
        paths: Of maps.
        ious: Thresholds.
    """
    exported = Exported(net).eval()
    parts: dict[float, list[Matches]] = {iou: [] for iou in ious}
    for path in paths:
        with np.load(path) as data:
            layers = data["layers"].astype(np.float32)
            truth, rays, gsd = data["boxes"], data["rays"], float(data["gsd"])
            pieces = bool(data["fragments"])
        if not TRAINED_GSD_M[0] <= gsd <= TRAINED_GSD_M[1]:  # as the detector does
            layers, truth = at_sampling(layers, truth, gsd, AIM_GSD_M)
        whole = network_input(
            np.moveaxis(layers[PLANES["rarity"]], 0, 2),
            layers[RAYS],
            layers[RARITY_MAP],
            np.moveaxis(layers[PLANES["plain"]], 0, 2),
            agreed_in(layers, COHERENT, COHERENCE),
            layers[FRAGMENTS] if pieces else None,
            agreed_in(layers, FRAGMENT_COLOUR, FRAGMENT_COHERENCE) if pieces else None,
            agreed_in(layers, GROUND, GROUND_RAYS) if pieces else None,
        )
        boxes, scores = finds(exported, whole)
        scores = doubted(boxes + 0.5, scores, layers[RAYS])  # as the detector does
        corner = np.array([whole.shape[2] - 1, whole.shape[1] - 1])
        middle = np.clip(np.rint(0.5 * (boxes[:, :2] + boxes[:, 2:])), 0, corner).astype(int)
        seen = layers[RAYS][middle[:, 1], middle[:, 0]] >= LEAST_RAYS_SEEN
        for iou, own in parts.items():
            own.append(match_boxes(boxes[seen], scores[seen], truth, iou, ignore=rays < REACHED))
    return {iou: Matches.join(own) for iou, own in parts.items()}
