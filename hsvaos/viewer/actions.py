"""What the buttons of a tab do: focus, eyedropper, finds, and what is saved."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hsvaos.geodesy import geodetic_from_ned
from hsvaos.viewer.charts import focus_chart, hue_chart
from hsvaos.viewer.controls import NUDGE_M
from hsvaos.viewer.focus import FocusCurve, focus_curve, sweep_pictures
from hsvaos.viewer.pace import Quality
from hsvaos.viewer.picture import png
from hsvaos.viewer.request import Request
from hsvaos.viewer.saving import film, settings_toml
from hsvaos.viewer.session import Find

if TYPE_CHECKING:
    from hsvaos.viewer.tab import Tab

Wanted = Callable[[], bool]

_KEYS: tuple[tuple[str, str, str | None, float], ...] = (
    ("Raise the focal surface a little", "pageup", None, -NUDGE_M),
    ("Lower the focal surface a little", "pagedown", None, NUDGE_M),
    ("Raise the focal surface", "pageup", "shift", -10.0 * NUDGE_M),
    ("Lower the focal surface", "pagedown", "shift", 10.0 * NUDGE_M),
)


class Actions:
    """The buttons and keys of one tab.

    Args:
        tab: The tab.
    """

    def __init__(self, tab: Tab) -> None:
        self.tab = tab
        self._dropper: Any = None
        self._curve: FocusCurve | None = None
        self._shown: tuple[Any, Any] = (None, None)
        c = tab.controls
        c.nudge.on_click(lambda event: self.nudge(float(event.target.value)))
        c.autofocus.on_click(lambda _: self.autofocus())
        c.dropper.on_click(lambda _: self.toggle_dropper())
        c.drop_kept.on_click(lambda _: self.keep(()))
        c.save_png.on_click(lambda _: self.save_png())
        c.save_toml.on_click(lambda _: self.save_toml())
        c.save_film.on_click(lambda _: self.save_film())
        self._add_keys()

    def _add_keys(self) -> None:
        gui: Any = self.tab.client.gui
        for label, key, modifier, step in _KEYS:
            command = gui.add_command(label, hotkey=key, modifier=modifier)
            command.on_trigger(lambda _, step=step: self.nudge(step))
        others: tuple[tuple[str, str, Callable[[], None]], ...] = (
            ("Autofocus", "F", self.autofocus),
            ("Next photo", "N", lambda: self.tab.step_photo(1)),
            ("Photo before", "P", lambda: self.tab.step_photo(-1)),
        )
        for label, key, act in others:
            gui.add_command(label, hotkey=key).on_trigger(lambda _, act=act: act())

    def nudge(self, step_m: float) -> None:
        """Move the focal surface a little [m], within its slider."""
        depth = self.tab.controls.depth
        with self.tab.lock:
            depth.value = min(max(depth.value + step_m, depth.min), depth.max)
        self.tab.update()

    def autofocus(self) -> None:
        """Measure the focus curve and go to its clearest peak."""
        tab, c = self.tab, self.tab.controls
        request = tab.last
        if request is None:
            return
        span = (float(c.depth.min), float(c.depth.max))

        def job(wanted: Wanted) -> None:
            curve = focus_curve(
                tab.session, request, span, wanted=wanted, progress=self._progress("focus")
            )

            def put() -> None:
                self._curve = curve
                c.depth.value = round(curve.best_m, 2)
                self._draw_curve()
                if curve.prominence == 0.0:
                    c.status.content = "**no depth stands out: the focus curve has no inner peak**"

            tab.tell(put)
            tab.update()

        tab.live.background(tab, "focus", job, tab.failed)

    def begin(self) -> None:
        """Go to the relief at once where the settings ask for it."""
        session, c = self.tab.session, self.tab.controls
        if session.settings.focus.relief is not True or session.start.terrain:
            return
        if c.terrain is not None:
            self.follow_terrain()
        else:
            c.status.content = (
                "**the settings ask for the relief of the ground, which is found in RGB photos "
                "only: this is the plane**"
            )

    def follow_terrain(self) -> None:
        """Go to the terrain or back to the plane, as the box says; find the relief if need be."""
        tab, c = self.tab, self.tab.controls
        if not c.terrain.value or tab.session.terrain is not None:
            self._go_to_terrain()
            return
        mask = c.mask(tab.session.settings.mask, tab.kept)

        def job(wanted: Wanted) -> None:
            note = tab.session.find_relief(mask, wanted, self._tell_progress)

            def put() -> None:
                c.finds.content = note
                if tab.session.terrain is None:
                    c.terrain.value = False
                    c.status.content = f"**{note}**"

            tab.tell(put)
            self._go_to_terrain()

        def failed(error: Exception) -> None:
            c.terrain.value = False  # the box says what is shown
            tab.failed(error)

        tab.live.background(tab, "relief", job, failed)

    def _go_to_terrain(self) -> None:
        tab, c = self.tab, self.tab.controls
        on = bool(c.terrain.value) and tab.session.terrain is not None
        tab.tell(lambda: c.go_to_terrain(tab.session, on))
        tab.update()

    def _draw_curve(self) -> None:
        c = self.tab.controls
        chart = focus_chart(self._curve, c.depth.value)
        c.curve.data = chart["data"]
        c.curve.visible = self._curve is not None

    def show_hues(self, request: Request) -> None:
        """Bring the charts up to date with what is shown."""
        tab, c = self.tab, self.tab.controls
        key = (request.mask, request.focus)
        if key == self._shown:
            return
        if self._curve is not None:
            tab.tell(self._draw_curve)
        if c.hues is not None and request.mask != self._shown[0]:
            chart = hue_chart(tab.session, request.mask, c.cuts.min)

            def put() -> None:
                c.hues.data = chart["data"]

            tab.tell(put)
            tab.follow_cut(request)
        self._shown = key

    def toggle_dropper(self) -> None:
        """Start or end picking a colour to keep by a click on the picture."""
        tab = self.tab
        with tab.lock:
            scene = tab.client.scene
            if self._dropper is not None:
                scene.remove_click_callback(self._dropper)
                self._dropper = None
            else:
                self._dropper = scene.on_click()(lambda event: self.pick(event.screen_pos))
            tab.controls.dropper.label = "Click on a colour ..." if self._dropper else "Eyedropper"

    def pick(self, screen: tuple[float, float]) -> None:
        """Keep the colour at a place on the screen, 0..1 from the left and the top."""
        tab = self.tab
        if self._dropper is not None:
            self.toggle_dropper()
        place = tab.pixel(screen)
        if place is None:
            return

        def job(_: Wanted) -> None:
            colour = tab.session.colour_at(*place)
            if colour is None:
                tab.failed(ValueError("no photo sees that place: there is no colour to keep"))
            elif colour not in tab.kept:
                self.keep((*tab.kept, colour))

        tab.live.background(tab, "pick", job, tab.failed)

    def keep(self, colours: tuple[str, ...]) -> None:
        """Set the colours that no mask takes away."""
        with self.tab.lock:
            self.tab.kept = colours
        self.show_kept()
        self.tab.update()

    def show_kept(self) -> None:
        """Show the colours to keep on the panel."""
        swatches = "".join(
            f'<span title="{colour}" style="display:inline-block;width:1.6em;height:1.6em;'
            f'margin:2px;border:1px solid #888;background:{colour}"></span>'
            for colour in self.tab.kept
        )

        def put() -> None:
            shown = f"<small>Kept colours:</small> {swatches}" if swatches else ""
            self.tab.controls.kept.content = shown

        self.tab.tell(put)

    def show_finds(self, request: Request | None, wanted: Wanted) -> None:
        """Look for finds and show them."""
        if request is None:
            return
        finds = self.tab.session.finds(request, wanted, self._tell_progress)
        text = self._finds_text(finds)

        def put() -> None:
            self.tab.scene.put_finds(finds)
            self.tab.controls.finds.content = text

        if wanted():
            self.tab.tell(put)

    def look(self, request: Request, wanted: Wanted) -> None:
        """Look into all photos, and draw the ground anew that could not be shown before."""
        self.tab.session.look(request.mask, wanted, self._tell_progress)
        if wanted():
            self.tab.update(anew=True)

    def _tell_progress(self, stage: str, done: int, count: int) -> None:
        def put() -> None:
            self.tab.controls.finds.content = f"{stage.capitalize()}: {done} of {count}."

        self.tab.tell(put)

    def _finds_text(self, finds: tuple[Find, ...]) -> str:
        session = self.tab.session
        if session.no_parallax is not None:
            return session.no_parallax
        if not finds:
            return "No finds from the nearest photo's view."
        lines = [f"{len(finds)} finds from the nearest photo's view, strongest first:", ""]
        origin = session.flight.origin
        for find in sorted(finds, key=lambda find: -find.score)[:12]:
            where = f"north {find.place[0]:.1f} m, east {find.place[1]:.1f} m"
            if origin is not None:
                lat, lon, _ = geodetic_from_ned(find.place, origin)
                where += f" ({float(lat):.6f}, {float(lon):.6f})"
            lines.append(f"- {find.score:.2g}: {where}")
        return "\n".join(lines)

    def save_png(self) -> None:
        """Send the picture as shown, in full, as a PNG file."""
        tab = self.tab
        request = tab.last
        if request is None:
            return

        def job(wanted: Wanted) -> None:
            picture = tab.session.render(request, Quality(), wanted)
            self._download("hsvaos.png", png(picture.rgb))

        tab.live.background(tab, "png", job, tab.failed)

    def save_toml(self) -> None:
        """Send the settings as a TOML file."""
        tab = self.tab
        if tab.last is not None:
            text = settings_toml(tab.session, tab.last)
            self._download("settings.toml", text.encode("utf-8"))

    def save_film(self) -> None:
        """Send a film through the depths."""
        tab, c = self.tab, self.tab.controls
        request, kind = tab.last, str(c.film_kind.value)
        if request is None:
            return
        first, last = (float(v) for v in c.film_span.value)
        downs = np.linspace(first, last, int(c.film_steps.value))

        def job(wanted: Wanted) -> None:
            progress = self._progress("film")
            pictures = sweep_pictures(tab.session, request, downs, wanted, progress)
            self._download(f"hsvaos.{kind}", film(pictures, kind))

        tab.live.background(tab, "film", job, tab.failed)

    def _download(self, name: str, content: bytes) -> None:
        tab = self.tab
        tab.tell(lambda: tab.client.send_file_download(name, content, save_immediately=True))

    def _progress(self, what: str) -> Callable[[int, int], None]:
        def step(done: int, total: int) -> None:
            if done % 5 == 0 or done == total:

                def put() -> None:
                    self.tab.controls.status.content = f"{what}: {done} of {total}"

                self.tab.tell(put)

        return step
