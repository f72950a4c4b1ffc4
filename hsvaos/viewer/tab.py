"""One browser tab: listens to its panel and camera, asks for pictures and shows them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hsvaos.flight import FlightError
from hsvaos.viewer.actions import Actions
from hsvaos.viewer.controls import LAYER_NAMES, PLACES, HueAxis, build
from hsvaos.viewer.geometry import Ground, browser_view, fitted, vertical_fov
from hsvaos.viewer.live import Live
from hsvaos.viewer.picture import photo_picture
from hsvaos.viewer.render import Picture
from hsvaos.viewer.request import Request
from hsvaos.viewer.scene import Scene, shrunk

if TYPE_CHECKING:
    import viser

_PHOTO_PX = 480
_FINDS_AFTER_S = 0.3
_FRUSTA_AWAY = 2.5
"""Lengths of a frustum from the nearest photo within which the photos are hidden."""


class Tab:
    """The state of one tab. Its methods may be called from any thread.

    Args:
        client: The tab.
        live: Where pictures come from.
        ground: The ground that the flight sees, or None.
    """

    def __init__(self, client: viser.ClientHandle, live: Live, ground: Ground | None) -> None:
        self.client, self.live, self.session, self.ground = client, live, live.session, ground
        self.lock = threading.RLock()
        self.gone = False
        self.kept = self.session.settings.mask.keep_colours
        self.last: Request | None = None
        self._last_key: Any = None
        self._surface_key: Any = None
        self._hue_key: Any = None
        size = 10.0 if ground is None else ground.size_m
        self.controls = build(client, self.session, size)
        self.scene = Scene(client, self.session, ground, self.visit)
        self.actions = Actions(self)
        self._wire()
        self.go_to(self.session.flight.centre_index)
        self.show_parts()
        self.actions.show_kept()
        self.update()
        self.actions.begin()

    def _wire(self) -> None:
        c = self.controls
        plain = [c.depth, c.pitch, c.roll, c.contrast, c.brightness, c.size, c.method]
        plain += [c.brighten, c.keep_distance, c.radius, c.all_photos, c.follow, c.north, c.east]
        plain += [c.span, c.every, c.layer, c.place, c.by_hand]
        for handle in plain:
            if handle is not None:
                handle.on_update(lambda _: self.update())
        for handle in (c.layer, c.show_photos, c.show_finds, c.show_outline, c.show_grid):
            handle.on_update(lambda _: self.show_parts())
        if c.terrain is not None:
            c.terrain.on_update(lambda _: self.actions.follow_terrain())
        c.sigmas.on_update(lambda event: self._sigmas_moved(event.client is not None))
        if c.cuts is not None:
            c.cuts.on_update(lambda event: self._cut_moved(event.client is not None))
        c.photo.on_update(self._photo_chosen)
        c.go.on_click(lambda event: self._go(event.target.value))
        self.client.camera.on_update(lambda _: self._camera_moved())

    def request(self) -> Request:
        """Return what the panel and the camera of the tab ask for.

        Raises:
            ValueError: If a value makes no sense.
            FlightError: If there is nothing to see.
        """
        c = self.controls
        focus, layer = c.focus(), LAYER_NAMES[c.layer.value]
        longest = int(c.size.value)
        if c.place.value == PLACES[1] and layer != "compare":
            if self.ground is None:
                raise FlightError("no photo looks down at the ground: there is no picture of it")
            view = self.ground.view(self.session.surface(focus), longest)
        else:
            camera = self.client.camera
            size = fitted((camera.image_width, camera.image_height), longest)
            view = browser_view(camera.wxyz, camera.position, camera.fov, size)
        mask = c.mask(self.session.settings.mask, self.kept)
        return Request(view, focus, c.aperture(), mask, c.look(), layer, moving=True)

    def update(self, *, anew: bool = False) -> None:
        """Ask for a new picture, if anything has changed.

        Args:
            anew: Ask even if nothing has.
        """
        with self.lock:  # whoever comes last reads the newest values, and asks last
            if self.gone:
                return
            try:
                request = self.request()
            except (ValueError, TypeError) as error:
                self.failed(error)
                return
            view = request.view
            place: tuple[Any, ...] = (view.world_from_camera.tobytes(), view.camera, view.size)
            key = (*place, view.gsd_m, request.focus, request.aperture, request.mask)
            key = (*key, request.look, request.layer)
            if key == self._last_key and not anew:
                return
            self._last_key = key
            self.last = request
            self.live.forget(self, "finds")
            self.live.show(self, request, self._deliver, self.failed)

    def _deliver(self, picture: Picture) -> None:
        def put() -> None:
            self.scene.put_picture(picture)
            self.controls.status.content = picture.summary(self.session)

        self.tell(put)
        if picture.quality.full:
            self.live.background(self, "finds", self._settle(picture), self.failed, _FINDS_AFTER_S)

    def _settle(self, picture: Picture) -> Callable[[Callable[[], bool]], None]:
        """What is brought up to date once the picture stands still."""
        request = picture.request

        def job(wanted: Callable[[], bool]) -> None:
            nearest = self.session.nearest(request.view)
            key = (request.focus, nearest)
            if key != self._surface_key:
                surface = self.session.surface(request.focus)
                self.tell(lambda: self.scene.put_outline(surface, nearest))
                self._surface_key = key
            self.actions.show_hues(request)
            if picture.stand_in:
                self.actions.look(request, wanted)
            if self.controls.show_finds.value:
                self.actions.show_finds(request, wanted)

        return job

    def failed(self, error: Exception) -> None:
        """Show what went wrong; the picture before it stays."""
        text = " ".join(str(error).split()) or type(error).__name__

        def put() -> None:
            self.controls.status.content = f"**{text}**"

        self.tell(put)

    def tell(self, put: Callable[[], None]) -> None:
        """Send something to the tab, all of it at once; nothing where it was closed."""
        with self.lock:
            if self.gone:
                return
            with self.client.atomic():
                put()

    def visit(self, index: int) -> None:
        """Go to a photo and see it alone."""
        self.go_to(index)
        self.controls.layer.value = next(n for n, layer in LAYER_NAMES.items() if layer == "photo")

    def go_to(self, index: int) -> None:
        """Look from where a photo was taken, as its camera did."""
        pose = self.session.flight.poses[index]
        place, rotation = pose[:3, 3], pose[:3, :3]
        reach = max(self.session.ground_m - float(place[2]), 1.0)
        picture = photo_picture(self.session.photos.images[index].numpy())
        name = self.session.flight.frames[index].name

        def put() -> None:
            camera = self.client.camera
            camera.fov = vertical_fov(self.session.flight.camera)
            camera.up_direction = -rotation[:, 1]
            camera.position = place
            camera.look_at = place + reach * rotation[:, 2]
            self.controls.place.value = PLACES[0]
            self.controls.photo.value = index
            self.controls.photo_image.image = shrunk(picture, _PHOTO_PX)
            self.controls.photo_image.label = name
            self.scene.choose_photo(index)

        self.tell(put)
        self.update()

    def _photo_chosen(self, event: Any) -> None:
        if event.client is not None:  # by hand, and not by `go_to` itself
            self.go_to(self.controls.photo.value)

    def step_photo(self, step: int) -> None:
        """Go to the next photo, or the one before."""
        self.go_to((self.controls.photo.value + step) % len(self.session.flight))

    def _go(self, where: str) -> None:
        if where == "Photo":
            self.go_to(self.controls.photo.value)
            return
        if self.ground is None:
            self.failed(FlightError("no photo looks down at the ground: there is no overview"))
            return
        place, target = self.ground.overview()

        def put() -> None:
            camera = self.client.camera
            camera.up_direction = (0.0, 0.0, -1.0)
            camera.position = place
            camera.look_at = target
            self.controls.place.value = PLACES[1]

        self.tell(put)
        self.update()

    def _camera_moved(self) -> None:
        self._show_groups()
        self.update()

    def _at_a_photo(self) -> bool:
        """Whether the browser looks from among the photos, which would stand in its way."""
        away = np.linalg.norm(self.session.places - self.client.camera.position, axis=1)
        return bool(away.min() < _FRUSTA_AWAY * self.scene.frustum_m)

    def _show_groups(self) -> None:
        c = self.controls
        scene = LAYER_NAMES[c.layer.value] != "compare"  # three pictures, one scene: no match
        groups = {
            "photos": scene and c.show_photos.value and not self._at_a_photo(),
            "finds": scene and c.show_finds.value,
            "outline": scene and c.show_outline.value,
            "grid": scene and c.show_grid.value,
        }
        self.tell(lambda: self.scene.show(groups))

    def show_parts(self) -> None:
        """Show those parts of the scene that are switched on."""
        c = self.controls
        self._show_groups()
        if c.show_finds.value and self.last is not None:
            job = lambda wanted: self.actions.show_finds(self.last, wanted)  # noqa: E731
            self.live.background(self, "finds", job, self.failed, _FINDS_AFTER_S)

    def _sigmas_moved(self, by_user: bool) -> None:
        c = self.controls
        with self.lock:
            if by_user and c.by_hand is not None and c.by_hand.value:
                c.by_hand.value = False
        self.update()

    def _cut_moved(self, by_user: bool) -> None:
        if not by_user:
            return
        with self.lock:
            if not self.controls.by_hand.value:
                self.controls.by_hand.value = True
        self.update()

    def follow_cut(self, request: Request) -> None:
        """Let the two cuts of the panel show where the statistics put them."""
        c = self.controls
        if c.cuts is None or c.by_hand.value:
            return
        mask = replace(request.mask, hue_from_deg=None, hue_to_deg=None)
        cuts = HueAxis.of(self.session, mask).on(c.cuts.min)

        def put() -> None:
            c.cuts.value = cuts

        self.tell(put)

    def pixel(self, screen: tuple[float, float]) -> tuple[Request, float, float] | None:
        """Return what lies under a place on the screen: a request without its side by side.

        Args:
            screen: 0..1 from the left and from the top.

        Returns:
            request from the browser's camera, column and row; None before the first picture.
        """
        with self.lock:
            if self.last is None:
                return None
            request, camera = self.last, self.client.camera
            size = fitted((camera.image_width, camera.image_height), int(self.controls.size.value))
            view = browser_view(camera.wxyz, camera.position, camera.fov, size)
        u, v = screen[0] * size[0] - 0.5, screen[1] * size[1] - 0.5
        if request.layer != "compare":
            return replace(request, view=view), u, v
        width = size[0] // 3
        panel = min(int(screen[0] * 3.0), 2)
        layer = ("photo", "plain", "masked")[panel]
        left = (size[0] - width) // 2
        return replace(request, view=view, layer=layer), u - panel * width + left, v

    def close(self) -> None:
        """Drop the work of a tab that was closed."""
        self.gone = True  # without the lock: a picture may just be on its way
        self.live.forget(self)
