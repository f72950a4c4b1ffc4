"""The panel of one browser tab: its sliders, boxes and buttons, and the values they stand for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hsvaos.settings import MASKS, MOST_TILT_DEG, MaskSettings
from hsvaos.viewer.charts import focus_chart, hue_chart
from hsvaos.viewer.request import Aperture, Focus, Look
from hsvaos.viewer.session import Session

if TYPE_CHECKING:
    import viser

LAYER_NAMES = {
    "Integral, masked": "masked",
    "Integral, plain": "plain",
    "Ground without trees": "ground",
    "Nearest photo": "photo",
    "Photo | plain | masked": "compare",
    "Footprint": "footprint",
    "Rarity": "rarity",
}

PLACES = ("From the camera", "On the ground")

NUDGE_M = 0.1
"""Step of the keys and buttons that move the focal surface [m]; with shift ten times that."""


@dataclass
class Controls:
    """Handles of everything on the panel. Attributes are viser's handles."""

    status: Any
    depth: Any
    nudge: Any
    terrain: Any
    pitch: Any
    roll: Any
    autofocus: Any
    curve: Any
    layer: Any
    place: Any
    contrast: Any
    brightness: Any
    size: Any
    go: Any
    method: Any
    sigmas: Any
    brighten: Any
    by_hand: Any
    cuts: Any
    hues: Any
    dropper: Any
    kept: Any
    drop_kept: Any
    keep_distance: Any
    photo: Any
    photo_image: Any
    all_photos: Any
    radius: Any
    follow: Any
    north: Any
    east: Any
    span: Any
    every: Any
    show_photos: Any
    show_finds: Any
    show_outline: Any
    show_grid: Any
    finds: Any
    save_png: Any
    save_toml: Any
    film_kind: Any
    film_span: Any
    film_steps: Any
    save_film: Any
    on_terrain: bool = False
    """Whether depths count from the terrain: where it is asked for, and there."""

    def focus(self) -> Focus:
        """Return the focal surface that the panel stands for."""
        if self.on_terrain:
            return Focus(self.depth.value, terrain=True)
        return Focus(self.depth.value, self.pitch.value, self.roll.value)

    def go_to_terrain(self, session: Session, on: bool) -> None:
        """Let the depths of the panel count from the terrain, or from the ground's origin again.

        Args:
            session: The flight.
            on: Whether the terrain is followed from now on.
        """
        if on == self.on_terrain:
            return
        shift = -session.ground_m if on else session.ground_m
        first, last = _depth_range(session, on)
        self.on_terrain = on
        down = round(min(max(self.depth.value + shift, first), last), 2)
        for slider, value in ((self.depth, down), (self.film_span, (first, last))):
            slider.min, slider.max = min(first, slider.min), max(last, slider.max)
            slider.value = value  # within both ranges, old and new
            slider.min, slider.max = first, last

    def look(self) -> Look:
        """Return contrast and brightness."""
        return Look(self.contrast.value, self.brightness.value)

    def aperture(self) -> Aperture:
        """Return the photos that count."""
        centre = None if self.follow.value else (self.north.value, self.east.value)
        radius = None if self.all_photos.value else self.radius.value
        first, last, every = 0, None, 1
        if self.span is not None:
            first, last = self.span.value
            every = self.every.value
        return Aperture(radius, None if radius is None else centre, first, last, every)

    def mask(self, base: MaskSettings, kept: tuple[str, ...]) -> MaskSettings:
        """Return the settings of the mask.

        Args:
            base: What the panel has no control for.
            kept: Colours of the eyedropper.
        """
        cut: tuple[float | None, float | None] = (None, None)
        if self.cuts is not None and self.by_hand.value:
            first, last = self.cuts.value
            whole = last - first >= 360.0
            cut = (0.0, 360.0) if whole else (first % 360.0, last % 360.0)
        return replace(
            base,
            method=self.method.value,
            sigmas=self.sigmas.value,
            brighten=self.brighten.value,
            hue_from_deg=cut[0],
            hue_to_deg=cut[1],
            keep_colours=kept,
            keep_distance=self.keep_distance.value,
        )


def _depth_range(session: Session, on_terrain: bool) -> tuple[float, float]:
    first, last = session.depth_range(on_terrain)
    return round(first, 2), round(last, 2)


def build(client: viser.ClientHandle, session: Session, ground_m: float) -> Controls:
    """Put the panel into a browser tab.

    Args:
        client: The tab.
        session: The flight.
        ground_m: Length of the ground that the photos see [m].
    """
    gui, colour = client.gui, session.photos.is_colour
    h: dict[str, Any] = {"status": gui.add_markdown("starting ...")}
    tabs = gui.add_tab_group()
    with tabs.add_tab("Focus"):
        _focus(gui, session, h)
    with tabs.add_tab("Mask"):
        _mask(gui, session, colour, h)
    with tabs.add_tab("Photos"):
        _photos(gui, session, ground_m, h)
    with tabs.add_tab("Save"):
        _save(gui, session, h)
    return Controls(**h)


def _focus(gui: viser.GuiApi, session: Session, h: dict[str, Any]) -> None:
    start = session.start
    first, last = _depth_range(session, start.terrain)
    tilt, step, down = MOST_TILT_DEG, 0.05, round(start.down_m, 2)
    h["depth"] = gui.add_slider(
        "Depth [m]",
        min(first, down),
        max(last, down),
        step,
        down,
        hint="Down of the focal plane, or shift of the terrain. Keys: Page Up, Page Down.",
    )
    h["nudge"] = gui.add_button_group("Nudge [m]", ("-1", "-0.1", "+0.1", "+1"))
    h["terrain"], h["on_terrain"] = None, start.terrain
    if start.terrain:
        h["terrain"] = gui.add_checkbox("Follow the terrain", True)
    elif session.may_find_relief:
        h["terrain"] = gui.add_checkbox(
            "Follow the relief",
            session.settings.focus.relief is True,
            hint="How high the ground is above and below the focal plane, as hsvaos run finds it. "
            "All photos are looked into for it, which takes a while the first time.",
        )
    h["pitch"] = gui.add_slider(
        "Pitch [deg]", -tilt, tilt, 0.5, start.pitch_deg, hint="The plane rises to the north."
    )
    h["roll"] = gui.add_slider(
        "Roll [deg]", -tilt, tilt, 0.5, start.roll_deg, hint="The plane falls to the east."
    )
    h["autofocus"] = gui.add_button(
        "Autofocus", hint="Measure the focus curve, and go to its clearest peak. Key: F."
    )
    h["curve"] = gui.add_uplot(**focus_chart(None, start.down_m), height=150, visible=False)
    known = session.photos.is_colour
    shown = tuple(name for name, layer in LAYER_NAMES.items() if known or layer != "ground")
    h["layer"] = gui.add_dropdown("Show", shown, initial_value="Integral, masked")
    h["place"] = gui.add_dropdown("Picture", PLACES, initial_value=PLACES[0])
    h["contrast"] = gui.add_slider("Contrast", 0.2, 5.0, 0.05, 1.0)
    h["brightness"] = gui.add_slider("Brightness", 0.3, 3.0, 0.05, 1.0)
    h["size"] = gui.add_slider("Longest side [px]", 320, 1920, 20, 1280)
    h["go"] = gui.add_button_group("Go to", ("Photo", "Overview"))


def _mask(gui: viser.GuiApi, session: Session, colour: bool, h: dict[str, Any]) -> None:
    mask = session.settings.mask
    h["method"] = gui.add_dropdown("Mask", MASKS, initial_value=mask.method)
    h["sigmas"] = gui.add_slider(
        "Sigmas",
        0.1,
        max(6.0, mask.sigmas),
        0.05,
        mask.sigmas,
        disabled=not colour,
        hint="Half width of the hue cut.",
    )
    h["brighten"] = gui.add_checkbox("Brighten what is kept", mask.brighten, disabled=not colour)
    h["cuts"], h["by_hand"], h["hues"] = None, None, None
    if colour:
        axis = HueAxis.of(session, mask)
        h["hues"] = gui.add_uplot(**hue_chart(session, mask, axis.first), height=150)
        h["cuts"] = gui.add_multi_slider(
            "Cuts [deg]", axis.first, axis.first + 360.0, 1.0, axis.cuts, min_range=1.0
        )
        by_hand = mask.hue_from_deg is not None
        h["by_hand"] = gui.add_checkbox("Cut by hand", by_hand, hint="Moving a cut switches it on.")
    else:
        gui.add_markdown("Grey photos: there is no hue to cut.")
    h["dropper"] = gui.add_button(
        "Eyedropper", disabled=not colour, hint="Then click on a colour that no mask may take away."
    )
    h["kept"] = gui.add_html("")
    h["keep_distance"] = gui.add_slider(
        "Likeness kept", 1.0, 30.0, 0.5, min(max(mask.keep_distance, 1.0), 30.0)
    )
    h["drop_kept"] = gui.add_button("Keep no colours")


def _photos(gui: viser.GuiApi, session: Session, ground_m: float, h: dict[str, Any]) -> None:
    count = len(session.flight)
    start = session.flight.centre_index
    h["photo"] = gui.add_slider("Photo", 0, max(count - 1, 1), 1, start, disabled=count == 1)
    h["photo_image"] = gui.add_image(np.full((4, 4, 3), 80, np.uint8), label="", format="jpeg")
    north, east = (round(float(v), 1) for v in session.places[:, :2].mean(axis=0))
    spread = float(np.linalg.norm(np.ptp(session.places[:, :2], axis=0)))
    reach = max(1.0, round(spread, 1), round(ground_m, 1))
    with gui.add_folder("Aperture"):
        h["all_photos"] = gui.add_checkbox("No limit", session.settings.view.aperture_m is None)
        radius = session.settings.view.aperture_m or 0.5 * reach
        h["radius"] = gui.add_slider("Radius [m]", 0.1, max(reach, radius), 0.1, radius)
        h["follow"] = gui.add_checkbox("Centre below the view", True)
        for name, middle in (("north", north), ("east", east)):
            ends = (round(middle - reach, 1), round(middle + reach, 1))
            h[name] = gui.add_slider(f"{name.title()} [m]", *ends, 0.1, middle)
        h["span"], h["every"] = None, None
        if count > 1:
            ends = (0, count - 1)
            h["span"] = gui.add_multi_slider("Photos", 0, count - 1, 1, ends)
            h["every"] = gui.add_slider("Every", 1, max(2, count // 2), 1, 1)
    with gui.add_folder("In the scene"):
        h["show_photos"] = gui.add_checkbox("Photos", True)
        h["show_finds"] = gui.add_checkbox("Finds", session.settings.detect.enabled)
        h["show_outline"] = gui.add_checkbox("Ground seen", True)
        h["show_grid"] = gui.add_checkbox("Grid", False)
        h["finds"] = gui.add_markdown("")


def _save(gui: viser.GuiApi, session: Session, h: dict[str, Any]) -> None:
    span = _depth_range(session, session.start.terrain)
    h["save_png"] = gui.add_button("Picture (PNG)")
    h["save_toml"] = gui.add_button("Settings (TOML)", hint="For hsvaos run --settings FILE.")
    with gui.add_folder("Film through the depths"):
        h["film_span"] = gui.add_multi_slider("From, to [m]", *span, 0.1, span)
        h["film_steps"] = gui.add_slider("Pictures", 2, 200, 1, 40)
        h["film_kind"] = gui.add_dropdown("Kind", ("mp4", "gif"), initial_value="mp4")
        h["save_film"] = gui.add_button("Film")


@dataclass(frozen=True)
class HueAxis:
    """The axis of hues in a chart: one turn of the circle with the cut in its middle.

    Args:
        first: First hue of the axis [deg].
        cuts: The two cuts on it [deg].
    """

    first: float
    cuts: tuple[float, float]

    @classmethod
    def of(cls, session: Session, mask: MaskSettings) -> HueAxis:
        """Return the axis on which the cut of the flight's middle photo lies."""
        stats = sorted(session.weights.hue_stats(mask), key=lambda one: one.sigma_deg)
        middle = stats[len(stats) // 2]
        first = float(round(middle.mean_deg) - 180)
        half = min(middle.half_width_deg, 180.0)
        low, high = max(middle.mean_deg - half, first), min(middle.mean_deg + half, first + 360.0)
        return cls(first, (float(round(low)), float(round(high))))

    def on(self, first: float) -> tuple[float, float]:
        """Return the cuts on another axis, shifted by whole turns and held within it."""
        shift = 360.0 * round((first + 180.0 - 0.5 * sum(self.cuts)) / 360.0)
        low, high = (min(max(cut + shift, first), first + 360.0) for cut in self.cuts)
        return low, high
