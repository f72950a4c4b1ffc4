"""Pieces of people in single photos: what every ray says of the ground point it comes from.

Weights by colour alone ask whether a pixel can be a leaf. A small network looks at the photo
around the pixel too: a patch of cloth between leaves has a shade, an edge and a size that litter,
snow and crowns do not have. What it says is the evidence of one ray, no verdict: most pieces are a
few pixels large. Averaged over rays like any photo, evidence adds up where people lie, and blurs
away with the crowns everywhere else.

The network also says of every pixel whether it shows the ground (or who lies on it) or a crown, a
trunk or a bush. Photos weighed by that show the ground as if nothing stood on it, where enough
rays reach it: no colour need be cut for that.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.network import Network

FRAGMENT_CHANNELS = ("red", "green", "blue", "chroma surprise", "colour surprise")
"""Channels of the network's input, in order."""

PACKAGED_FRAGMENTS = Path(__file__).with_name("fragments.onnx")
"""Our own weights."""

_OUTPUTS = "evidence", "ground"
_MULTIPLE = 16
"""Sides of the input must be multiples of this."""

_GSD_M = (0.03, 0.055)
"""Ground sampling distances of photos [m/px] that the network takes as they are."""

_AIM_GSD_M = 0.04

ONE = np.float32(65535.0)
"""Evidence of 1, as `FragmentNet` gives it."""


class PhotoInputs(Protocol):
    """The inputs of a flight's photos, as `hsvaos.fragment_input.FragmentInput` makes them."""

    def __len__(self) -> int: ...

    def __call__(self, index: int) -> NDArray[np.float32]:
        """Return the input of a photo, shape (5, H, W), float32."""
        ...


class PhotoEvidence(NamedTuple):
    """What the network says of photos.

    Attributes:
        people: Shape (N, h, w) or (h, w), uint16, 65535 = 1: log(1 + 7.4 odds) / 10 of a piece of a
            person.
        ground: The same shape, uint8, 255 = 1: the squared probability that the ground is seen, or
            who lies on it.
    """

    people: NDArray[np.uint16]
    ground: NDArray[np.uint8]


class FragmentNet:
    """Tells how much each pixel of a photo looks like a piece of a person, or like the ground.

    Args:
        model: ONNX file; by default our own weights.
        provider: "cuda", "tensorrt" or "cpu"; by default the first one that is here.
        threads: CPU threads that the network uses; by default one a core.

    Raises:
        ValueError: If the network cannot be read, or is none of fragments.
    """

    def __init__(
        self,
        model: str | Path | None = None,
        provider: str | None = None,
        threads: int | None = None,
    ) -> None:
        self._network = Network(PACKAGED_FRAGMENTS if model is None else model, provider, threads)
        named = self._network.metadata.get("channels", "")
        if named != ",".join(FRAGMENT_CHANNELS):
            raise ValueError(
                f"{self._network.name}: expected a network of fragments, with the channels "
                f"{', '.join(FRAGMENT_CHANNELS)} in its metadata, got {named or 'none'}"
            )
        given = [port.name for port in self._network.outputs]
        if not set(_OUTPUTS) <= set(given):
            raise ValueError(
                f"{self._network.name}: expected the outputs {' and '.join(_OUTPUTS)}, got "
                f"{', '.join(given)}"
            )

    def evidence(
        self,
        photos: PhotoInputs,
        gsd_m: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> PhotoEvidence:
        """Return what is said of every pixel of every photo.

        Args:
            photos: The inputs of a flight.
            gsd_m: Ground sampling distance of the photos [m/px]: far from that of training they are
                resampled, and the evidence is smaller or larger than they. By default they are
                taken as they are.
            progress: Told how many photos are done.
        """
        none = (len(photos), 0, 0)
        found = PhotoEvidence(np.zeros(none, np.uint16), np.zeros(none, np.uint8))
        for index in range(len(photos)):
            one = self.of_photo(photos(index), gsd_m)
            if index == 0:
                shape = len(photos), *one.people.shape
                found = PhotoEvidence(np.empty(shape, np.uint16), np.empty(shape, np.uint8))
            found.people[index], found.ground[index] = one
            if progress is not None:
                progress(index + 1, len(photos))
        return found

    def of_photo(self, planes: NDArray[np.float32], gsd_m: float | None = None) -> PhotoEvidence:
        """Return what is said of one photo; see `evidence`.

        Args:
            planes: Shape (5, H, W), from `fragment_input.FragmentInput`.
            gsd_m: Ground sampling distance of the photo [m/px], or None.
        """
        people, ground = self.of_planes(resampled(planes, gsd_m))
        return PhotoEvidence(
            np.rint(people * ONE).astype(np.uint16),
            np.rint(ground * np.float32(255.0)).astype(np.uint8),
        )

    def of_planes(
        self, planes: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return evidence and ground of one photo, shape (H, W) each, 0 to 1.

        Args:
            planes: Shape (5, H, W), from `fragment_input.FragmentInput`.
        """
        height, width = planes.shape[1:]
        beyond = (0, 0), (0, -height % _MULTIPLE), (0, -width % _MULTIPLE)
        whole = np.pad(planes, beyond, mode="edge")[None]
        found = self._network.run({self._network.picture.name: whole})
        people, ground = (found[name][0, 0, :height, :width] for name in _OUTPUTS)
        return people, ground


def resampled(planes: NDArray[np.float32], gsd_m: float | None) -> NDArray[np.float32]:
    """Return an input at a sampling distance that the network knows.

    Args:
        planes: Shape (5, H, W).
        gsd_m: Ground sampling distance [m/px]; None to leave it.
    """
    if gsd_m is None or _GSD_M[0] <= gsd_m <= _GSD_M[1]:
        return planes
    factor = gsd_m / _AIM_GSD_M
    height, width = (max(1, round(side * factor)) for side in planes.shape[1:])
    how = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return np.stack([cv2.resize(plane, (width, height), interpolation=how) for plane in planes])
