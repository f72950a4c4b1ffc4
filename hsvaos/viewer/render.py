"""One picture: gathered in bands that can be abandoned, and painted."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.kernels.integrate import Integrator
from hsvaos.report.figures import of_ground
from hsvaos.surface import FocalSurface
from hsvaos.viewer.pace import Quality
from hsvaos.viewer.picture import (
    Rgb,
    footprint_picture,
    integral_picture,
    rarity_picture,
    side_by_side,
)
from hsvaos.viewer.request import Request, resized, window
from hsvaos.viewer.weights import Abandoned, Wanted

if TYPE_CHECKING:
    from hsvaos.viewer.session import Session

_BAND_RAYS = 4_000_000
"""Rays of a band of rows: between bands a picture that is no longer wanted gives up."""

PREVIEW_FRAMES = 16
"""Photos that a picture is made of while the masks of all are not ready."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A rendered picture.

    Args:
        rgb: Shape (H, W, 3), uint8.
        request: What was asked for.
        view: The virtual camera as rendered, with fewer pixels where the quality says so.
        quality: What was left out.
        frames: Photos that counted.
        rays: Rays that were gathered: pixels times photos.
        integrate_ms: Time to gather them [ms].
        ms: Time for all of it [ms].
        note: What the user should know; empty where all is well.
        stand_in: Whether it shows something else until all photos were looked into.
    """

    rgb: Rgb
    request: Request
    view: VirtualCamera
    quality: Quality
    frames: int
    rays: int
    integrate_ms: float
    ms: float
    note: str
    stand_in: bool = False

    def summary(self, session: Session) -> str:
        """Return the status line, as Markdown.

        Args:
            session: Where the picture comes from.
        """
        coarse = "" if self.quality.full else f", coarse ({self.quality.scale:.0%})"
        note = f"\n\n**{self.note}**" if self.note else ""
        return (
            f"{self.frames} of {len(session.flight)} photos, {self.ms:.0f} ms, "
            f"{session.device.alias}, {self.view.width} x {self.view.height} px{coarse}{note}"
        )


def render(session: Session, request: Request, quality: Quality, wanted: Wanted) -> Picture:
    """Render a picture; see `Session.render`."""
    start = perf_counter()
    job = _Job(session, request, quality, wanted)
    rgb = job.picture()
    ms = 1e3 * (perf_counter() - start)
    shown = (len(job.frames), job.rays, job.ms, ms, job.note, job.stand_in)
    return Picture(rgb, request, job.view, quality, *shown)


def integral(
    integrator: Integrator,
    view: VirtualCamera,
    surface: FocalSurface,
    frames: list[int] | None,
    wanted: Wanted = lambda: True,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Integrate a view in bands of rows, so that it can be abandoned between them.

    Returns:
        image, shape (H, W, C), and footprint, shape (H, W), float32.
    """
    count = len(integrator) if frames is None else len(frames)
    rows = max(16, _BAND_RAYS // max(1, view.width * count))
    if view.height <= rows or integrator.device.is_cuda:
        image, footprint = integrator.integrate(view, surface, frames=frames)
        return image.numpy(), footprint.numpy()
    images, footprints = [], []
    for top in range(0, view.height, rows):
        if not wanted():
            raise Abandoned
        part = window(view, 0, top, view.width, min(rows, view.height - top))
        image, footprint = integrator.integrate(part, surface, frames=frames)
        images.append(image.numpy())
        footprints.append(footprint.numpy())
    return np.concatenate(images), np.concatenate(footprints)


class _Job:
    """One picture being rendered."""

    def __init__(self, session: Session, request: Request, quality: Quality, wanted: Wanted):
        self.session, self.request, self.wanted = session, request, wanted
        self.quality = quality
        self.view = resized(request.view, quality.scale)
        self.surface = session.surface(request.focus)
        self.frames = session.frames(request)[:: quality.every]
        self.rays, self.ms, self.note, self.stand_in = 0, 0.0, "", False

    def picture(self) -> Rgb:
        layer = self.request.layer
        if not self.frames:
            self.note = "no photo lies within the aperture"
        if layer == "compare":
            width = max(1, self.view.width // 3)
            left = (self.view.width - width) // 2
            self.view = window(self.view, left, 0, width, self.view.height)
            return side_by_side([self._integral(k) for k in ("photo", "plain", "masked")])
        if layer == "rarity":
            image, footprint = self._gather("rarity_map", self.frames)
            return rarity_picture(image[..., 0], footprint)
        if layer == "ground":
            return self._ground()
        if layer == "footprint":
            _, footprint = self._gather(self._kind("masked"), self.frames)
            return footprint_picture(footprint)
        return self._integral(layer)

    def _integral(self, layer: str) -> Rgb:
        frames = [self.session.nearest(self.view)] if layer == "photo" else self.frames
        image, footprint = self._gather(self._kind(layer), frames)
        return integral_picture(image, footprint, self.request.look)

    def _ground(self) -> Rgb:
        integrator = self.session.ground(self.request.mask)
        if integrator is None:
            self.stand_in = self.session.photos.is_colour
            later = "all photos are being looked into: the trees vanish when that is done"
            self.note = later if self.stand_in else "grey photos do not tell ground from crowns"
            return self._integral("plain")
        if not self.frames:
            return self._integral("plain")
        image, footprint = self._timed(integrator, self.frames)
        return integral_picture(image, of_ground(footprint), self.request.look)

    def _kind(self, layer: str) -> str:
        if layer != "masked":
            return "plain"
        return self.session.weights.kind_of(self.request.mask.method)

    def _gather(self, kind: str, frames: list[int]) -> tuple[Any, Any]:
        if not self.wanted():
            raise Abandoned
        weights, mask = self.session.weights, self.request.mask
        chosen: list[int] | None = frames
        if self.quality.full or not frames or weights.has(kind, mask):
            integrator = weights.integrator(kind, mask, self.wanted)
        else:
            some = frames[:: max(1, -(-len(frames) // PREVIEW_FRAMES))]
            integrator, chosen = weights.preview(kind, mask, tuple(some)), None
        image, footprint = self._timed(integrator, chosen)
        if frames and not footprint.any():
            self.note = "no photo sees the focal surface there"
        return image, footprint

    def _timed(self, integrator: Integrator, chosen: list[int] | None) -> tuple[Any, Any]:
        start = perf_counter()
        image, footprint = integral(integrator, self.view, self.surface, chosen, self.wanted)
        self.ms += 1e3 * (perf_counter() - start)
        self.rays += self.view.width * self.view.height * (len(chosen or integrator))
        return image, footprint
