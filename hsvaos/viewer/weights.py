"""What weighs the pixels of a flight, in stages: each made when first asked for, then kept."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.detect.fragments import FragmentNet, PhotoEvidence
from hsvaos.fragment_input import FragmentInput
from hsvaos.hue_statistics import HueStatistics, hue_statistics
from hsvaos.kernels.hue_mask import hue_histograms
from hsvaos.kernels.integrate import Integrator
from hsvaos.masking import (
    by_hand,
    cut_hues,
    find_anomalies,
    levelled,
    weigh_rarity,
)
from hsvaos.photos import Photos, Progress
from hsvaos.rarity_model import RarityModel
from hsvaos.rendering import (
    EvidenceIntegrators,
    Integrators,
    evidence_integrators,
    hue_integrator,
)
from hsvaos.settings import MaskSettings, Settings

KINDS = ("plain", "hue", "rarity", "rarity_map", "anomaly", "anomaly_map")

_PREVIEW_PX = 900_000
"""Pixels of all photos together that a preview masks."""

_BYTES_A_PIXEL = 8
"""A brightened photo, its mask, and both packed by the integrator."""

_CACHE_BYTES = 2_000_000_000
_MOST_KEPT = 3
"""Cuts of each kind that are kept: for tabs with settings of their own, and the way back."""

_OF_HUE = ("sigmas", "statistics", "scope", "hue_from_deg", "hue_to_deg")
_OF_KEEPING = ("keep_colours", "keep_distance")
_OF_BRIGHTENING = ("brighten", "target_value", "gamma", "max_gain")
_OF_RARITY = (
    "rarity_threshold",
    "grey_rarity_threshold",
    "rarity_exponent",
    "rarity_smoothing_bins",
)
_FIELDS = {
    "plain": (),
    "hue": (*_OF_HUE, *_OF_KEEPING, *_OF_BRIGHTENING),
    "rarity": (*_OF_RARITY, *_OF_KEEPING),
    "rarity_map": (*_OF_RARITY, *_OF_KEEPING),
    "anomaly": ("anomaly_quantile", *_OF_KEEPING),
    "anomaly_map": ("anomaly_quantile", *_OF_KEEPING),
}
"""Settings that each kind of weights depends on; a change of any other redoes nothing."""


class Abandoned(Exception):  # noqa: N818 - not an error: a newer request made this one pointless
    """Raised inside work that nobody waits for any more."""


Wanted = Callable[[], bool]
"""Tells work that takes long whether somebody still waits for it."""


class WeightCache:
    """Weights and integrators of a flight by kind and settings. Safe to use from several threads.

    Args:
        photos: The photos.
        settings: Whether they are levelled.
    """

    def __init__(self, photos: Photos, settings: Settings) -> None:
        self.photos = photos
        self._settings = settings
        self._locks = {kind: threading.Lock() for kind in KINDS}
        self._base = threading.Lock()
        self._gains: NDArray[np.float64] | None = None
        self._has_gains = False
        self._histograms: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
        self._whole: dict[str, OrderedDict[Any, Integrator]] = {k: OrderedDict() for k in KINDS}
        self._part: dict[str, tuple[Any, Integrator]] = {}
        self._small: tuple[tuple[int, ...], Photos] | None = None
        self._layers: dict[str, tuple[Any, tuple[Any, Any]]] = {}
        self._looking = threading.Lock()
        self._evidence: tuple[Any, list[PhotoEvidence]] | None = None
        self._fragments: tuple[Any, EvidenceIntegrators, NDArray[np.uint8]] | None = None
        pixels = int(np.prod(photos.images.shape[:3]))
        self._kept = max(1, min(_MOST_KEPT, _CACHE_BYTES // (_BYTES_A_PIXEL * pixels)))

    @property
    def gains(self) -> NDArray[np.float64] | None:
        """Factors that level the photos, shape (N, 3), or None."""
        with self._base:
            if not self._has_gains:
                self._gains = levelled(self.photos, self._settings)
                self._has_gains = True
        return self._gains

    def histograms(self, statistics: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return hue histograms (N, B) and mean chroma (N,) of the photos."""
        gains = self.gains
        with self._base:
            if statistics not in self._histograms:
                self._histograms[statistics] = hue_histograms(
                    self.photos.images,
                    statistics=statistics,
                    valid=self.photos.valid,
                    gains=gains,
                )
            return self._histograms[statistics]

    def hue_stats(self, mask: MaskSettings, frames: list[int] | None = None) -> list[HueStatistics]:
        """Return the statistics that the hue cut of each photo follows; empty for grey photos.

        Args:
            mask: The settings.
            frames: Numbers of the photos; None for all.
        """
        if not self.photos.is_colour:
            return []
        histograms, chroma = self.histograms(mask.statistics)
        chosen = list(range(len(chroma))) if frames is None else frames
        if mask.scope == "flight":
            histograms, chroma = histograms.sum(axis=0)[None], chroma.mean(keepdims=True)
        else:
            histograms, chroma = histograms[chosen], chroma[chosen]
        stats = [
            hue_statistics(row, float(mean), statistics=mask.statistics, sigmas=mask.sigmas)
            for row, mean in zip(histograms, chroma, strict=True)
        ]
        return by_hand(mask, stats * (len(chosen) // len(stats)))

    def kind_of(self, method: str) -> str:
        """Return the kind of weights of a mask method; grey photos have no hue to cut."""
        if method == "none" or (method == "hue" and not self.photos.is_colour):
            return "plain"
        return method

    def integrator(
        self, kind: str, mask: MaskSettings, wanted: Wanted = lambda: True
    ) -> Integrator:
        """Return the integrator of all photos.

        Args:
            kind: One of `KINDS`.
            mask: The settings.
            wanted: Asked between steps.

        Raises:
            Abandoned: If it is no longer wanted.
        """
        key = _key(kind, mask)
        with self._locks[kind]:
            kept = self._whole[kind]
            if key not in kept:
                while len(kept) >= self._kept:  # before the new one, which needs the memory
                    kept.popitem(last=False)
                kept[key] = self._make_whole(kind, mask, wanted)
            kept.move_to_end(key)
            return kept[key]

    def has(self, kind: str, mask: MaskSettings) -> bool:
        """Whether the integrator of all photos is there already."""
        return _key(kind, mask) in self._whole[kind]

    def preview(self, kind: str, mask: MaskSettings, frames: tuple[int, ...]) -> Integrator:
        """Return an integrator of some shrunk photos, made within a few milliseconds.

        Args:
            kind: One of `KINDS`.
            mask: The settings.
            frames: Numbers of the photos.
        """
        key = (_key(kind, mask), frames)
        with self._locks[kind]:
            if kind not in self._part or self._part[kind][0] != key:
                part = self._shrunk(frames)
                chosen = list(frames)
                stats = self.hue_stats(mask, chosen) if kind == "hue" else []
                gains = None if self.gains is None else self.gains[chosen]
                self._part[kind] = (key, _integrator(kind, part, mask, stats, gains))
            return self._part[kind][1]

    def integrators(self, mask: MaskSettings, wanted: Wanted = lambda: True) -> Integrators:
        """Return the integrators that `hsvaos.rendering.Renderer` asks for, without fragments."""
        hue = self.integrator("hue", mask, wanted) if self.photos.is_colour else None
        odd = None
        if "anomaly" in (mask.method, self._settings.detect.method):
            odd = self.integrator("anomaly_map", mask, wanted)
        return Integrators(
            plain=self.integrator("plain", mask, wanted),
            chosen=self.integrator(self.kind_of(mask.method), mask, wanted),
            rarity=self.integrator("rarity", mask, wanted),
            hue=hue,
            rarity_map=self.integrator("rarity_map", mask, wanted),
            anomaly_map=odd,
        )

    def looked(self, mask: MaskSettings, gsd_m: float | None) -> EvidenceIntegrators | None:
        """Return what `fragments` would, or None where it would take long."""
        made = self._fragments
        return made[1] if made is not None and made[0] == _looked_with(mask, gsd_m) else None

    def fragments(
        self,
        mask: MaskSettings,
        gsd_m: float | None,
        wanted: Wanted = lambda: True,
        progress: Progress | None = None,
    ) -> EvidenceIntegrators:
        """Return the integrators of what the fragment network sees in each photo.

        The first time takes seconds; what is abandoned is gone on with where it was.

        Args:
            mask: The settings.
            gsd_m: Ground sampling distance of the photos [m/px], see `FragmentNet.evidence`.
            wanted: Asked between photos.
            progress: Told how many photos are done.

        Raises:
            Abandoned: If it is no longer wanted.
        """
        return self._looked(mask, gsd_m, wanted, progress)[1]

    def ground(
        self,
        mask: MaskSettings,
        gsd_m: float | None,
        wanted: Wanted = lambda: True,
        progress: Progress | None = None,
    ) -> NDArray[np.uint8]:
        """Return how likely each pixel of each photo shows the ground, shape (N, h, w), 255 = sure.

        Takes as long as `fragments`, and only once for both; see there.
        """
        return self._looked(mask, gsd_m, wanted, progress)[2]

    def _looked(
        self, mask: MaskSettings, gsd_m: float | None, wanted: Wanted, progress: Progress | None
    ) -> tuple[Any, EvidenceIntegrators, NDArray[np.uint8]]:
        key = _looked_with(mask, gsd_m)
        with self._looking:
            if self._fragments is not None and self._fragments[0] == key:
                return self._fragments
            if self._evidence is None or self._evidence[0] != key:
                self._evidence = (key, [])
            seen, count = self._evidence[1], len(self.photos.flight)
            _, model = self._layer("rarity", mask, wanted)
            inputs = FragmentInput(self.photos.images, model, self.gains)
            net = FragmentNet()
            for index in range(len(seen), count):
                if not wanted():
                    raise Abandoned
                seen.append(net.of_photo(inputs(index), gsd_m))
                if progress is not None:
                    progress("looking for pieces of people", index + 1, count)
            people, ground = (np.stack(part) for part in zip(*seen, strict=True))
            evidence = PhotoEvidence(people, ground)
            made = evidence_integrators(self.photos, evidence, self.gains)
            self._fragments = (key, made, ground)
            self._evidence = None
            return self._fragments

    def _make_whole(self, kind: str, mask: MaskSettings, wanted: Wanted) -> Integrator:
        if not wanted():
            raise Abandoned
        stats = self.hue_stats(mask) if kind == "hue" else []
        layer = None
        if kind not in ("plain", "hue"):
            layer, _ = self._layer(kind.removesuffix("_map"), mask, wanted)
        return _integrator(kind, self.photos, mask, stats, self.gains, layer)

    def _layer(self, kind: str, mask: MaskSettings, wanted: Wanted) -> tuple[Any, Any]:
        """Weights by rarity or RX, of which there are two integrators: by them, and of them.

        Beside them the model that rarity follows; None for RX.
        """
        if not wanted():
            raise Abandoned
        key = _key(kind, mask)
        with self._base:
            if kind in self._layers and self._layers[kind][0] == key:
                return self._layers[kind][1]
        weights = _weigh(kind, self.photos, mask, self.gains)
        with self._base:
            self._layers[kind] = (key, weights)
        return weights

    def _shrunk(self, frames: tuple[int, ...]) -> Photos:
        """Some photos, shrunk so that masking them takes no longer than drawing."""
        if self._small is not None and self._small[0] == frames:
            return self._small[1]
        photos = self.photos
        height, width = photos.images.shape[1:3]
        scale = min(1.0, (_PREVIEW_PX / (len(frames) * height * width)) ** 0.5)
        size = (max(1, round(width * scale)), max(1, round(height * scale)))

        def small(image: NDArray[Any]) -> NDArray[Any]:
            return cv2.resize(image, size, interpolation=cv2.INTER_AREA)

        stack = np.stack([small(photos.images[frame].numpy()) for frame in frames])
        images: Any = wp.array(stack, dtype=photos.images.dtype, device=photos.images.device)
        valid = photos.valid
        if valid is not None:
            valid = np.stack([small(photos.valid_of(frame)) for frame in frames])
        flight = photos.flight.subset(frames)
        flight = flight.replace(camera=flight.camera.scaled(*size))
        self._small = (frames, Photos(flight, images, valid, ()))
        return self._small[1]


def _key(kind: str, mask: MaskSettings) -> Any:
    return tuple(getattr(mask, name) for name in _FIELDS[kind])


def _weigh(
    kind: str, photos: Photos, mask: MaskSettings, gains: NDArray[np.float64] | None
) -> tuple[Any, RarityModel | None]:
    if kind == "rarity":
        return weigh_rarity(photos, mask, gains)
    return find_anomalies(photos, mask, gains), None


def _integrator(
    kind: str,
    photos: Photos,
    mask: MaskSettings,
    stats: list[HueStatistics],
    gains: NDArray[np.float64] | None,
    layer: Any = None,
) -> Integrator:
    """Return the integrator of one kind; the same choices as `rendering.make_integrators`."""
    camera, poses = photos.flight.camera, photos.flight.poses
    if kind == "plain":
        return Integrator(camera, photos.images, poses, photos.valid)
    if kind == "hue":
        return hue_integrator(photos, *cut_hues(photos, mask, stats, gains), gains)
    if layer is None:
        layer, _ = _weigh(kind.removesuffix("_map"), photos, mask, gains)
    if kind.endswith("_map"):
        return Integrator(camera, layer, poses, photos.valid)
    return Integrator(camera, photos.images, poses, layer, gains=gains)


def _looked_with(mask: MaskSettings, gsd_m: float | None) -> tuple[Any, ...]:
    """What the evidence of the photos depends on."""
    return mask.rarity_smoothing_bins, gsd_m
