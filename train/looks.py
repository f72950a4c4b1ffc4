"""What the second look learns from: boxes of the first network on flights that it never saw.

For every map one input as the detector makes it, at one sampling distance, and what the first
network found there, right and wrong. Stored channels last, so that a patch is read in a few rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.levels import level_planes
from hsvaos.detect.network import Network
from hsvaos.detect.network_input import AIM_GSD_M, TRAINED_GSD_M, network_input
from hsvaos.detect.overlap import overlaps
from hsvaos.detect.second_look import FLOOR, MOST, SAME, facts_of, patch
from hsvaos.detect.suppress import suppress, usable
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
from train.net import MULTIPLE
from train.samples import LEAST_RAYS, at_sampling

_LEAST, _SAME, _MOST = 0.03, 0.5, 250
"""Score and overlap of candidates, and how many, that are learnt from: more than get a look in
use."""

_BATCH = 64

_STORED = ("rays", "boxes", "scores", "people", "reach", "classes")

_RIGHT, _WRONG = 0.2, 0.05
"""Overlap with a person from which a candidate is one; below the second it is none."""


@dataclass(frozen=True, eq=False)
class Look:
    """A map as the detector sees it, and its candidates.

    Args:
        layers: Shape (H, W, 34), float16, see `hsvaos.detect.second_look.SECOND_CHANNELS`.
        rays: Shape (H, W), float16, rays of each pixel.
        boxes: Shape (N, 4), candidates, corners, pixel centres at integers [px].
        scores: Shape (N,), of the first network.
        people: Shape (K, 4), boxes of everybody [px].
        reach: Shape (K,), unoccluded rays a point.
        classes: Shape (K,), names of occlusion classes.
        taught: Shape (N,), an earlier second look's scores, see `train.teacher`; None: not asked.
    """

    layers: NDArray[np.float16]
    rays: NDArray[np.float16]
    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    people: NDArray[np.float32]
    reach: NDArray[np.float32]
    classes: NDArray[np.str_]
    taught: NDArray[np.float32] | None = None

    @cached_property
    def shares(self) -> NDArray[np.float32]:
        """Shape (N, K), overlap of candidates and people."""
        return np.asarray(overlaps(self.boxes, self.people), dtype=np.float32)

    @cached_property
    def whose(self) -> NDArray[np.int64]:
        """Shape (N,), whom a candidate shows, -1 if nobody, -2 if that is not to be taught."""
        if not len(self.people):
            return np.full(len(self.boxes), -1)
        best = self.shares.argmax(axis=1)
        share = self.shares.max(axis=1)
        found = np.where(share >= _RIGHT, best, np.where(share < _WRONG, -1, -2))
        middle = 0.5 * (self.boxes[:, None, :2] + self.boxes[:, None, 2:])
        within = ((middle > self.people[:, :2]) & (middle < self.people[:, 2:])).all(axis=2)
        found[(found == -1) & within.any(axis=1)] = -2
        faint = self.reach < LEAST_RAYS
        found[(found >= 0) & faint[best]] = -2
        return found


def input_of(path: Path, wanted_gsd_m: float | None) -> tuple[NDArray[np.float32], ...]:
    """Return a map as the detector would look at it.

    Args:
        path: Of a map.
        wanted_gsd_m: Ground sampling distance [m/px]; None: as the detector chooses it.

    Returns:
        Input (25, H, W), of the second look what comes to it (9, H, W), rays (H, W), boxes of
        people (K, 4), and unoccluded rays (K,).
    """
    with np.load(path) as data:
        layers = data["layers"].astype(np.float32)
        people, reach, gsd = data["boxes"], data["rays"], float(data["gsd"])
        pieces = bool(data["fragments"])
    if wanted_gsd_m is None and not TRAINED_GSD_M[0] <= gsd <= TRAINED_GSD_M[1]:
        wanted_gsd_m = AIM_GSD_M
    if wanted_gsd_m is not None:
        layers, people = at_sampling(layers, people, gsd, wanted_gsd_m)
    image = np.moveaxis(layers[PLANES["rarity"]], 0, 2)
    fragments = agreed_in(layers, FRAGMENT_COLOUR, FRAGMENT_COHERENCE)
    ground = agreed_in(layers, GROUND, GROUND_RAYS)
    whole = network_input(
        image,
        layers[RAYS],
        layers[RARITY_MAP],
        np.moveaxis(layers[PLANES["plain"]], 0, 2),
        agreed_in(layers, COHERENT, COHERENCE),
        layers[FRAGMENTS] if pieces else None,
        fragments if pieces else None,
        ground if pieces else None,
    )
    levels = level_planes(image, layers[RAYS], fragments, ground)
    return whole, levels, layers[RAYS], people.astype(np.float32), reach.astype(np.float32)


def candidates(
    first: Network, whole: NDArray[np.float32], least: float, same: float, most: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return boxes and scores of the first network, down to weak ones.

    Args:
        first: The person network.
        whole: Shape (25, H, W), its input.
        least: Score from which a box is a candidate.
        same: Overlap from which two boxes are one candidate.
        most: Candidates.
    """
    height, width = (-(-side // MULTIPLE) * MULTIPLE for side in whole.shape[1:])
    padded = np.zeros((1, len(whole), height, width), dtype=np.float32)
    padded[0, :, : whole.shape[1], : whole.shape[2]] = whole
    found = first.run({first.picture.name: padded})
    boxes, scores = found["boxes"][0], found["scores"][0]
    good = usable(boxes, scores, least)
    weak = suppress(boxes[good], scores[good], same, most)
    return weak.boxes_xyxy, weak.scores


def make_look(path: Path, target: Path, first: Network, *, as_found: bool = False) -> None:
    """Write a map's input and candidates: NAME.layers.npy and NAME.npz.

    Args:
        path: Of the map.
        target: Folder.
        first: The person network.
        as_found: Whether the map is judged by: at the sampling that the detector chooses, with as
            many candidates. Else at one that is drawn.
    """
    whole, levels, rays, people, reach = input_of(path, None if as_found else _drawn_gsd(path))
    how = (FLOOR, SAME, MOST) if as_found else (_LEAST, _SAME, _MOST)
    boxes, scores = candidates(first, whole, *how)
    layers = np.moveaxis(np.concatenate([whole, levels]), 0, 2)
    np.save(target / f"{path.stem}.layers.npy", layers.astype(np.float16))
    part = target / f"{path.stem}.part.npz"
    found = {"boxes": boxes, "scores": scores, "people": people, "reach": reach}
    with np.load(path) as data:
        np.savez(part, rays=rays.astype(np.float16), classes=data["classes"], **found)
    part.replace(target / f"{path.stem}.npz")


def _drawn_gsd(path: Path) -> float:
    rng = np.random.default_rng([*path.stem.encode(), 305])
    with np.load(path) as data:
        gsd = float(data["gsd"])
    low, high = TRAINED_GSD_M
    wanted = float(np.clip(max(gsd, AIM_GSD_M) * rng.uniform(0.95, 1.1), low, high))
    if rng.uniform() < 0.25:
        wanted = float(np.exp(rng.uniform(np.log(max(low, 0.9 * gsd)), np.log(high))))
    return wanted


def patches_of(
    look: Look, channels: Sequence[int] | None = None
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield patches (B, C + 1, side, side) and facts (B, 3) of a look's candidates, in order.

    Args:
        look: The look.
        channels: Which of its layers; all by default.
    """
    layers = look.layers if channels is None else look.layers[..., channels]
    planes = np.ascontiguousarray(np.moveaxis(layers, 2, 0))
    for first in range(0, len(look.boxes), _BATCH):
        some = slice(first, first + _BATCH)
        boxes = look.boxes[some]
        views = np.stack([patch((planes,), box) for box in boxes])
        yield views, facts_of(boxes, look.scores[some])


def read_look(path: Path) -> Look:
    """Return what `make_look` wrote; the layers stay on disk until they are used.

    Args:
        path: Of the .npz.
    """
    layers = np.load(path.with_suffix(".layers.npy"), mmap_mode="r")
    taught = taught_path(path)
    with np.load(path) as data:
        return Look(
            layers,
            *(data[name] for name in _STORED),
            np.load(taught) if taught.exists() else None,
        )


def taught_path(path: Path) -> Path:
    """Return where an earlier second look's scores of a look's candidates lie, if they do.

    Args:
        path: Of the look.
    """
    return path.with_suffix(".taught.npy")
