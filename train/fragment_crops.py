"""Training crops of single photos, and which of their pixels show a person or the ground."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

import hsvaos
from hsvaos.detect.fragments import FRAGMENT_CHANNELS
from hsvaos.fragment_input import FragmentInput
from hsvaos.masking import levelled
from hsvaos.photos import load_photos
from hsvaos.settings import Settings
from train.flights import ON_GROUND, ON_PERSON, labels_of
from train.rarity import training_rarity
from train.truth import flight_truth

SIDE_PX = 96
_SHAPE = len(FRAGMENT_CHANNELS), SIDE_PX, SIDE_PX
CROPS = 800
"""Of each flight."""

_AT_PEOPLE = 0.5
_MARGIN_PX = 10

_OFFSET = np.array([2.0, 2.0, 2.0, 1.5, 1.5], np.float32).reshape(5, 1, 1)
_STEPS = np.array([63.75, 63.75, 63.75, 50.0, 50.0], np.float32).reshape(5, 1, 1)
"""Inputs are kept as bytes: (value + offset) * steps."""


class FragmentCrops(NamedTuple):
    """Crops of one flight.

    Attributes:
        inputs: Shape (N, 5, 96, 96), uint8; see `as_input`.
        shown: Shape (N, 2, 96, 96), bool: pixels that show a person, and those that show the
            ground or a person.
    """

    inputs: NDArray[np.uint8]
    shown: NDArray[np.bool_]


def as_input(crops: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return kept crops as the network's input.

    Args:
        crops: Shape (..., 5, H, W).
    """
    return np.asarray(crops.astype(np.float32) / _STEPS - _OFFSET, dtype=np.float32)


def make_crops(folder: Path, target: Path) -> None:
    """Cut crops out of a flight's photos, half of them around visible pieces of people.

    Args:
        folder: The flight, simulated with labels.
        target: The .npz to write.
    """
    flight = hsvaos.open_flight(folder)
    photos = load_photos(flight, 1.0, "cpu", None)
    truth, rng = flight_truth(folder)
    gains = levelled(photos, Settings())
    model = training_rarity(photos, truth, rng, gains)
    inputs = FragmentInput(photos.images, model, gains)
    labels = labels_of(folder)
    count, height, width = photos.images.shape[:3]
    room = np.array([height - SIDE_PX, width - SIDE_PX])
    kept: list[NDArray[np.uint8]] = []
    shown: list[NDArray[np.bool_]] = []
    for index, frame in enumerate(flight.frames):
        label = cv2.imread(str(labels / f"{Path(frame.name).stem}.png"), cv2.IMREAD_UNCHANGED)
        both = np.stack([label == ON_PERSON, label >= ON_GROUND])
        photo = np.rint((inputs(index) + _OFFSET) * _STEPS)
        whole = np.clip(photo, 0.0, 255.0).astype(np.uint8)
        pieces = np.argwhere(both[0])
        for _ in range(CROPS // count + 1):
            corner = rng.integers(0, room + 1)
            if len(pieces) and rng.uniform() < _AT_PEOPLE:
                piece = pieces[rng.integers(len(pieces))]
                corner = piece - rng.integers(_MARGIN_PX, SIDE_PX - _MARGIN_PX, 2)
            y, x = np.clip(corner, 0, room) // 2 * 2
            kept.append(whole[:, y : y + SIDE_PX, x : x + SIDE_PX])
            shown.append(both[:, y : y + SIDE_PX, x : x + SIDE_PX])
    part = target.with_suffix(".part.npz")
    np.savez(part, inputs=np.stack(kept), shown=np.packbits(np.stack(shown), axis=-1))
    part.replace(target)


def read_crops(path: Path) -> FragmentCrops:
    """Return the crops of a flight.

    Args:
        path: Written by `make_crops`.
    """
    with np.load(path) as data:
        if "shown" not in data or data["inputs"].shape[1:] != _SHAPE:
            raise ValueError(f"{path}: expected crops {_SHAPE} and what they show, of this recipe")
        bits = np.unpackbits(data["shown"], axis=-1, count=SIDE_PX)
        inputs = data["inputs"]
    return FragmentCrops(inputs, bits.astype(bool))
