"""People looked for in the window's photos with all that `hsvaos run` looks at.

The picture of a live flight is made from one mask; our network knows far more from how rare each
ray's colour is, from a look at every single photo and from the ground without trees. That takes
seconds, so it is done beside the integration, over the photos of the window as it was when the last
search ended. A photo is looked at once, however many searches it is part of.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.detect.fragments import FragmentNet, PhotoEvidence
from hsvaos.detect.locate import ViewFinds, merge_views
from hsvaos.finding import make_finder
from hsvaos.flight import Flight, FlightError, Frame, Origin
from hsvaos.fragment_input import FragmentInput
from hsvaos.live.finds import LiveFinds
from hsvaos.live.looking import LookThread
from hsvaos.live.result import LiveResult
from hsvaos.live.ring import Format
from hsvaos.masking import Masks, levelled, weigh_rarity
from hsvaos.photos import Photos
from hsvaos.relief.find import find_relief, wants_relief
from hsvaos.rendering import Integrators, Renderer, evidence_integrators, make_integrators
from hsvaos.settings import Settings
from hsvaos.surface import FocalPlane, FocalSurface
from hsvaos.viewing import photo_sampling

_MOST_SEARCHES = 1000
"""Searches of which finds are kept, to be merged into persons."""

_NEVER = -1

_ALIKE = 1.2
"""Factor between sampling distances of photos from which they are looked at anew."""


@dataclass(frozen=True, eq=False)
class _Asked:
    """What is to be searched: photos by slot, and what they are looked at from."""

    number: int
    slots: dict[int, int]  # of photos by number
    poses: dict[int, NDArray[np.float64]]
    view: VirtualCamera
    surface: FocalSurface


class SearchThread(LookThread):
    """Searches the newest photos; of those that come meanwhile it keeps as many again.

    Args:
        format: What the photos are.
        frames: Photos of the window.
        settings: Mask parameters of rarity, levelling, and how people are looked for.
        valid: Shape (H, W), uint8, 255 = use; None for all.
        device: "cpu", "cuda:0", ...

    Raises:
        ValueError: If the settings look for nobody, or the network cannot be used.
    """

    def __init__(
        self,
        format: Format,
        frames: int,
        settings: Settings,
        valid: NDArray[np.uint8] | None,
        device: Any,
    ) -> None:
        super().__init__()
        self._format, self._frames, self._valid = format, frames, valid
        self._settings = settings.with_values(mask={"method": "rarity"})
        finder = make_finder(settings.detect, frames, format.channels == 3, threads=1)
        if finder is None:
            raise ValueError("a search needs settings that look for people, got detect.enabled off")
        self._finder, self._device = finder, device
        self._net = None
        if finder.looks_at_photos:
            self._net = FragmentNet(provider="cpu" if device.is_cpu else None, threads=1)
        dtype = np.dtype(format.dtype)
        self._kept: NDArray[Any] = np.zeros((2 * frames, *format.shape), dtype)
        self._numbers = np.full(2 * frames, _NEVER)
        self._poses = np.tile(np.eye(4), (2 * frames, 1, 1))
        self._asked: _Asked | None = None
        self._images: Any = wp.zeros((frames, *format.shape), dtype=format.scalar, device=device)
        self._searched = np.full(frames, _NEVER)  # numbers of the photos that lie there
        self._said: PhotoEvidence | None = None
        self._gsd_m: float | None = None  # at which that was said
        self._finds: deque[ViewFinds] = deque(maxlen=_MOST_SEARCHES)

    def take(self, number: int, image: NDArray[Any], pose: NDArray[Any]) -> None:
        """See `LookThread`."""
        with self._changed:
            held = set() if self._asked is None else set(self._asked.slots.values())
            free = [slot for slot in range(len(self._numbers)) if slot not in held]
            slot = min(free, key=lambda one: self._numbers[one])
            np.copyto(self._kept[slot], image)
            self._numbers[slot], self._poses[slot] = number, pose

    def persons(self, origin: Origin | None = None) -> tuple[Person, ...]:
        """Return the finds of all searches, merged as `hsvaos run` merges those of views.

        Args:
            origin: Ties the local frame to the Earth, or None.
        """
        with self._changed:
            finds = list(self._finds)
        detect = self._settings.detect
        return merge_views(finds, detect.person_m, self._finder.least_score, origin)

    def warm_up(self, view: VirtualCamera, surface: FocalSurface) -> None:
        """Compile and load all kernels now, with noise for photos, and forget it.

        Args:
            view: A view of the size to come.
            surface: Focal plane or terrain of the kind to come.
        """
        rng = np.random.default_rng(0)
        image = rng.integers(0, 255, self._format.shape).astype(self._format.dtype)
        self.take(0, image, view.world_from_camera)
        with self._changed:
            asked = self._snapshot(0, view, surface)
        self._search(asked)
        self._numbers[:], self._searched[:], self._said = _NEVER, _NEVER, None

    def _hold(self, result: LiveResult, surface: FocalSurface, gsd_m: float) -> None:
        self._asked = self._snapshot(result.number, result.view, surface)

    def _snapshot(self, number: int, view: VirtualCamera, surface: FocalSurface) -> _Asked:
        there = np.flatnonzero((self._numbers != _NEVER) & (self._numbers <= number))
        newest = there[np.argsort(self._numbers[there])][-self._frames :]
        slots = {int(self._numbers[slot]): int(slot) for slot in newest}
        poses = {one: self._poses[slot].copy() for one, slot in slots.items()}
        return _Asked(number, slots, poses, view, surface)

    def _look(self, started_s: float) -> LiveFinds:
        asked = self._asked
        if asked is None:
            raise RuntimeError("nothing is held to be looked at")
        try:
            finds = self._search(asked)
        except FlightError:  # nothing but sky, or every pixel masked: nobody there
            nowhere = np.zeros((0, 3)), np.zeros((0, 2, 2))
            finds = ViewFinds(asked.view, Detections.none(), *nowhere)
        with self._changed:
            self._finds.append(finds)
            self._asked = None
        sure = finds.above(self._finder.scores.of_boxes)
        return LiveFinds(asked.number, sure.found, time.monotonic() - started_s, sure)

    def _search(self, asked: _Asked) -> ViewFinds:
        """Return all that counts for persons."""
        fresh = self._bring(asked.slots)
        count = len(asked.slots)
        numbers = self._searched[:count].tolist()
        frames = tuple(Frame(str(one), Path(), asked.poses[one]) for one in numbers)
        flight = Flight("live", self._format.camera, frames)
        photos = Photos(flight, self._images[:count], self._valid, ())
        by, surface = self._integrators(photos, asked.surface, fresh)
        renderer = Renderer(by, self._settings, surface, self._finder)
        return renderer.render("live", asked.view)[1]

    def _bring(self, slots: dict[int, int]) -> list[int]:
        """Put the photos wanted in place of those that are no longer; return the places of new."""
        there = set(self._searched.tolist())
        new = [number for number in slots if number not in there]
        free = [k for k, number in enumerate(self._searched.tolist()) if number not in slots]
        places = free[: len(new)]
        for place, number in zip(places, new, strict=True):
            self._images[place].assign(self._kept[slots[number]])
            self._searched[place] = number
        return places

    def _integrators(
        self, photos: Photos, surface: FocalSurface, fresh: list[int]
    ) -> tuple[Integrators, FocalSurface]:
        """Return the integrators of photos, and the surface with the relief that they show."""
        gains = levelled(photos, self._settings)
        rarity, model = weigh_rarity(photos, self._settings.mask, gains)
        masks = Masks.of_rarity(gains, rarity, model)
        by = make_integrators(photos, masks, "rarity")
        if self._net is None:
            return by, surface
        inputs = FragmentInput(photos.images, model, gains)
        count, gsd_m = len(photos.flight), photo_sampling(photos.flight, surface)
        if self._said is None or not _alike(gsd_m, self._gsd_m):  # all that was said is of no use
            self._gsd_m, self._said, fresh = gsd_m, None, list(range(count))
        for place in fresh:
            # at one sampling distance for all, or they would differ in size
            people, ground = self._net.of_photo(inputs(place), self._gsd_m)
            if self._said is None:
                shape = (self._frames, *people.shape)
                self._said = PhotoEvidence(np.zeros(shape, np.uint16), np.zeros(shape, np.uint8))
            self._said.people[place], self._said.ground[place] = people, ground
        if self._said is None:
            return by, surface
        said = PhotoEvidence(self._said.people[:count], self._said.ground[:count])
        if isinstance(surface, FocalPlane) and wants_relief(self._settings.focus):
            surface = find_relief(photos, said.ground, gains, surface)[0] or surface
        return by.with_evidence(evidence_integrators(photos, said, gains)), surface


def _alike(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is other
    return max(one, other) <= _ALIKE * min(one, other)
