"""A flight held ready to be looked at: pictures, depths and finds, without any user interface."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.locate import ViewFinds
from hsvaos.finding import Finder, make_finder
from hsvaos.flight import Flight, FlightError
from hsvaos.focusing import choose_surface, shifted, tilted_plane, without_parallax
from hsvaos.kernels.arrays import SCALE
from hsvaos.kernels.device import resolve_device
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.rays import focal_points
from hsvaos.photos import Photos, Progress, load_photos, with_poses
from hsvaos.relief.find import find_relief
from hsvaos.rendering import EvidenceIntegrators, Renderer
from hsvaos.settings import FocusSettings, MaskSettings, Settings
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain
from hsvaos.viewer.pace import Quality
from hsvaos.viewer.render import Picture, integral, render
from hsvaos.viewer.request import Focus, Request, window
from hsvaos.viewer.weights import Abandoned, Wanted, WeightCache
from hsvaos.viewing import photo_sampling


@dataclass(frozen=True, eq=False)
class Find:
    """A find on the focal surface.

    Args:
        place: Shape (3,), world NED [m].
        corners: Shape (4, 3), the corners of its box on the focal surface, world NED [m].
        score: As the detector gives it.
    """

    place: NDArray[np.float64]
    corners: NDArray[np.float64]
    score: float


class Session:
    """Photos and masks of one flight on a device. Its methods may be called from any thread.

    Args:
        photos: The photos, with the flight they are of.
        settings: Where to start from; levelling of the photos stays as it is here.
        progress: Told of a search for focus.
        notes: What the user should know of the flight.

    Raises:
        FlightError: If the flight cannot be used.
        ValueError: If a setting makes no sense.
    """

    def __init__(
        self,
        photos: Photos,
        settings: Settings | None = None,
        progress: Progress | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        self.settings = Settings() if settings is None else settings
        self.photos = photos
        self.device = photos.images.device
        self.flight = photos.flight
        self.weights = WeightCache(photos, self.settings)
        sharp: list[Integrator] = []
        if _searches(self.flight, self.settings.focus):
            mask = self.settings.mask
            sharp = [self.weights.integrator(kind, mask) for kind in ("plain", "rarity_map")]
        surface, focus_notes = choose_surface(self.flight, self.settings.focus, sharp, progress)
        self.terrain: FocalTerrain | None = None
        if isinstance(surface, FocalTerrain):
            offset = self.settings.focus.offset_m
            self.terrain = shifted(surface, -offset)
            self.start = Focus(offset, terrain=True)
        else:
            tilt = self.settings.focus
            self.start = Focus(float(surface.point[2]), tilt.pitch_deg, tilt.roll_deg)
        self._gsd_m = photo_sampling(self.flight, surface)
        self.no_parallax = without_parallax(self.flight, surface)
        still = () if self.no_parallax is None else (self.no_parallax,)
        self.notes = (*notes, *photos.notes, *focus_notes, *still)
        self._relief: tuple[FocalTerrain | None, str] | None = None
        self._finding_relief = threading.Lock()
        self._finds: tuple[Any, tuple[Find, ...]] | None = None
        self._finding = threading.Lock()
        self._finder: Finder | None = None

    @classmethod
    def open(
        cls,
        flight: Flight,
        settings: Settings | None = None,
        device: Any = "cpu",
        progress: Progress | None = None,
    ) -> Session:
        """Decode the photos of a flight, once: it may vanish from the disk after that.

        Args:
            flight: Photos with poses, or with a sensor log.
            settings: Where to start from; the scale of the photos stays as it is here.
            device: "cpu", "cuda:0", ...
            progress: Told of decoding, of poses and of a search for focus.

        Raises:
            FlightError: If the flight cannot be used.
            ValueError: If a setting or the device makes no sense.
        """
        chosen = Settings() if settings is None else settings
        found = with_poses(flight, progress)
        photos = load_photos(found, chosen.photos.scale, resolve_device(device), progress)
        return cls(photos, chosen, progress, found.notes)

    @property
    def places(self) -> NDArray[np.float64]:
        """Shape (N, 3), where the photos were taken, world NED [m]."""
        return self.flight.poses[:, :3, 3]

    @property
    def ground_m(self) -> float:
        """Down of the middle of the surface that the session starts with [m]."""
        if self.start.terrain and self.terrain is not None:
            return float(np.nanmedian(self.terrain.down_m))
        return self.start.down_m

    @property
    def depths(self) -> tuple[float, float]:
        """Downs between which it makes sense to drag a focal plane [m]: crowns to below ground."""
        lowest, ground = float(self.places[:, 2].max()), self.ground_m
        height = max(ground - lowest, 1.0)
        return ground - 0.9 * height, ground + 0.35 * height

    def depth_range(self, on_terrain: bool) -> tuple[float, float]:
        """Return the depths between which sliders go [m].

        Args:
            on_terrain: Whether depths count from the terrain; else they are those of a plane.
        """
        first, last = self.depths
        half = 0.5 * (last - first)
        return (-half, half) if on_terrain else (first, last)

    @property
    def may_find_relief(self) -> bool:
        """Whether the relief of the ground can be looked for: colour photos, and no terrain yet."""
        return self.photos.is_colour and not self.start.terrain and self.no_parallax is None

    def find_relief(
        self,
        mask: MaskSettings,
        wanted: Wanted = lambda: True,
        progress: Progress | None = None,
    ) -> str:
        """Find the relief of the ground about the plane that the session starts with.

        It becomes the terrain of the session. The first time all photos are looked into for it,
        which takes seconds; later calls return at once.

        Args:
            mask: The settings.
            wanted: Asked between photos.
            progress: Told of photos and planes.

        Returns:
            A line about it; `terrain` stays None where it is not known.

        Raises:
            Abandoned: If it is no longer wanted.
            FlightError: If it cannot be looked for, see `may_find_relief`.
        """
        if not self.may_find_relief:
            what = "grey photos" if not self.photos.is_colour else "a terrain"
            raise FlightError(
                f"{self.flight.source}: the relief of the ground is found in RGB photos, about a "
                f"focal plane, got {self.no_parallax or what}"
            )
        with self._finding_relief:
            if self._relief is None:
                ground = self.weights.ground(mask, self._gsd_m, wanted, progress)
                plane, gains = self._plane(self.start), self.weights.gains
                self._relief = find_relief(self.photos, ground, gains, plane, progress)
                self.terrain = self._relief[0]
            return self._relief[1]

    @property
    def relief_note(self) -> str | None:
        """The line about the relief of the ground; None before `find_relief` was done."""
        return None if self._relief is None else self._relief[1]

    def surface(self, focus: Focus) -> FocalSurface:
        """Return the focal surface of a request.

        Raises:
            FlightError: If a terrain is asked for and there is none.
        """
        if focus.terrain:
            if self.terrain is None:
                raise FlightError(f"{self.flight.source}: there is no terrain: give --terrain FILE")
            return shifted(self.terrain, focus.down_m)
        return self._plane(focus)

    def _plane(self, focus: Focus) -> FocalPlane:
        tilt = FocusSettings(pitch_deg=focus.pitch_deg, roll_deg=focus.roll_deg)
        return tilted_plane(self.flight, focus.down_m, tilt)

    def nearest(self, view: VirtualCamera) -> int:
        """Return the number of the photo that was taken nearest to a view's middle."""
        middle = view.world_from_camera[:3, 3].copy()
        if view.is_ortho:
            half = 0.5 * view.gsd_m * np.array([view.width - 1, view.height - 1])
            middle += view.world_from_camera[:3, :2] @ half
            return int(np.argmin(np.linalg.norm((self.places - middle)[:, :2], axis=1)))
        return int(np.argmin(np.linalg.norm(self.places - middle, axis=1)))

    def frames(self, request: Request) -> list[int]:
        """Return the numbers of the photos that count in a request."""
        return request.aperture.frames(self.places[:, :2], request.view.world_from_camera[:2, 3])

    def render(
        self,
        request: Request,
        quality: Quality | None = None,
        wanted: Wanted = lambda: True,
    ) -> Picture:
        """Render a picture.

        Args:
            request: What to show.
            quality: What to leave out; nothing by default. Where masks are not ready yet, pictures
                of less than full quality take them from some shrunk photos.
            wanted: Asked between steps.

        Raises:
            Abandoned: If it is no longer wanted.
            FlightError: If the request cannot be shown; the message says why.
        """
        return render(self, request, quality or Quality(), wanted)

    def colour_at(self, request: Request, u: float, v: float) -> str | None:
        """Return the colour under the eyedropper, for the settings' colours to keep.

        Args:
            request: The picture that was clicked on; of side by side pictures, the masked one.
            u: Column of the pixel, pixel centres at integers.
            v: Row of the pixel.

        Returns:
            "#rrggbb", the mean over 3 x 3 pixels; None for grey photos and where no photo sees.
        """
        if not self.photos.is_colour:
            return None
        view = window(request.view, round(u) - 1, round(v) - 1, 3, 3)
        frames = self.frames(request)
        kind, gains = self.weights.kind_of(request.mask.method), np.ones(3)
        if request.layer in ("plain", "photo"):
            kind = "plain"
        if request.layer == "photo":
            frames = [self.nearest(request.view)]
            if self.weights.gains is not None:
                gains = self.weights.gains[frames[0]]
        integrator = self.weights.integrator(kind, request.mask)
        image, footprint = integral(integrator, view, self.surface(request.focus), frames)
        seen = footprint > 0.0
        if not seen.any():
            return None
        white = SCALE[self.photos.images.dtype]
        mean = np.clip(image[seen].mean(axis=0) * gains / white, 0.0, 1.0)
        return "#" + bytes(np.rint(255.0 * mean).astype(np.uint8)).hex()

    def look(
        self,
        mask: MaskSettings,
        wanted: Wanted = lambda: True,
        progress: Progress | None = None,
    ) -> EvidenceIntegrators:
        """Return what a network sees in the photos, which takes seconds the first time.

        Args:
            mask: The settings.
            wanted: Asked between photos.
            progress: Told how many photos were looked into.

        Raises:
            Abandoned: If it is no longer wanted.
            ValueError: If the photos are grey.
        """
        return self.weights.fragments(mask, self._gsd_m, wanted, progress)

    def ground(self, mask: MaskSettings) -> Integrator | None:
        """Return the photos weighed by what is ground in them; None until they were looked into.

        Args:
            mask: The settings.
        """
        made = self.weights.looked(mask, self._gsd_m)
        return None if made is None else made.ground

    def finds(
        self,
        request: Request,
        wanted: Wanted = lambda: True,
        progress: Progress | None = None,
    ) -> tuple[Find, ...]:
        """Return what `hsvaos run` finds from the nearest photo's view on this focal surface.

        Args:
            request: View, focal surface and mask; its aperture does not count here.
            wanted: Asked between steps.
            progress: Told how many photos were looked into, which takes seconds the first time.

        Raises:
            Abandoned: If it is no longer wanted.
            FlightError: If the view sees nothing.
        """
        if self.no_parallax is not None:
            return ()
        index = self.nearest(request.view)
        key = (index, request.focus, request.mask)
        with self._finding:
            if self._finds is not None and self._finds[0] == key:
                return self._finds[1]
            surface = self.surface(request.focus)
            settings = replace(self.settings, mask=request.mask)
            by = self.weights.integrators(request.mask, wanted)
            if not wanted():
                raise Abandoned
            name = self.flight.frames[index].name
            if self._finder is None:
                colour = self.photos.is_colour
                self._finder = make_finder(settings.detect, len(self.flight), colour)
            finder = self._finder
            if finder is not None and finder.looks_at_photos:
                by = by.with_evidence(self.look(request.mask, wanted, progress))
            renderer = Renderer(by, settings, surface, finder)
            _, finds = renderer.render(name, self.flight.view(index))
            found = _on_surface(finds, surface)
            self._finds = (key, found)
        return found


def _searches(flight: Flight, focus: FocusSettings) -> bool:
    """Whether `choose_surface` will have to look for the focus."""
    known = focus.down_m is not None or focus.terrain is not None
    known = known or flight.terrain is not None or flight.ground_down_m is not None
    return focus.autofocus or not known


def _on_surface(finds: ViewFinds, surface: FocalSurface) -> tuple[Find, ...]:
    """Finds with the corners of their boxes on the focal surface; those in the air are left out."""
    view = finds.view
    hits = focal_points(view, surface).numpy().reshape(view.height, view.width, 4)
    found = []
    boxes = finds.found.boxes_xyxy.astype(np.float64)
    for box, score, place in zip(boxes, finds.found.scores, finds.places, strict=True):
        columns = np.clip(np.rint(box[[0, 2, 2, 0]]), 0, view.width - 1).astype(int)
        rows = np.clip(np.rint(box[[1, 1, 3, 3]]), 0, view.height - 1).astype(int)
        corners = hits[rows, columns].astype(np.float64)
        if np.isfinite(place).all() and (corners[:, 3] > 0.0).all():
            world = corners[:, :3] + view.world_from_camera[:3, 3]
            found.append(Find(place, world, float(score)))
    return tuple(found)
