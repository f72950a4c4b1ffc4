"""The pictures of a report, each with a caption for somebody who looks for a person."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.report import figures
from hsvaos.report.draw import draw_scale_and_north
from hsvaos.report.figures import Float, Rgba
from hsvaos.report.ground import photo_in_view
from hsvaos.report.terrain import height_picture
from hsvaos.result import Result
from hsvaos.surface import FocalTerrain

LONGEST_PX = 1280
"""Longest side of a picture embedded in the page: enough to zoom, small enough to send."""

_UNSEEN = "Hatched: nothing was seen there, which does not mean that nothing is there."

_INTEGRALS = {
    "plain": (
        "All photos, averaged (plain integral)",
        "All photos laid over each other, focused on the ground. Leaves and branches are at other "
        "heights and blur away; what lies on the ground stays sharp. " + _UNSEEN,
    ),
    "hue": (
        "Without the forest's colours (hue-masked integral)",
        "The same, after the common hue of the forest was taken out of every photo. What has "
        "another colour than the trees stands out. " + _UNSEEN,
    ),
    "rarity": (
        "Rare colours count more (rarity-weighted integral)",
        "The same, but every pixel counts by how rare its colour is in this flight: clothes are "
        "rare, leaves are not. " + _UNSEEN,
    ),
    "ground": (
        "The ground without trees (rays of the ground)",
        "The same, of those pixels only that a network takes for ground, or for somebody on it: "
        "crowns, trunks and bushes are left out. Hatched: next to no photo shows the ground there.",
    ),
    "anomaly": (
        "Unusual pixels only (anomaly-masked integral)",
        "The same, of those pixels only whose colour is unusual in its photo. " + _UNSEEN,
    ),
}

_MAPS = {
    "rarity_map": (
        "Rarity map",
        "Where the photos agree on an unusual colour on the ground. Look at the bright spots "
        "first: a person, but also a car, a tarp or a flower bed. " + _UNSEEN,
        "common",
        "rare",
    ),
    "fragment_map": (
        "Pieces of people",
        "Every single photo was looked into for pieces of people, patches of cloth between leaves. "
        "Bright is where several photos show what may be pieces of the same person. " + _UNSEEN,
        "none",
        "many",
    ),
}

_MASKS = {
    "hue": "The single photo after the common hue of the forest was taken out: only what is still "
    "in colour counts. Dark blue was removed.",
    "rarity": "The single photo, faded where its colour is common in this flight: what is still in "
    "colour counts most.",
    "anomaly": "The single photo, only what is unusual in it still in colour. Dark blue was "
    "removed.",
    "none": "No mask by colour was used. Dark blue, if any, is left out by the flight's own mask.",
}


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture of the page.

    Args:
        key: Short name, unique on the page.
        title: Headline.
        caption: What it shows, in plain words.
        picture: Shape (H, W, 4), uint8 RGBA, at most `LONGEST_PX` long.
        in_view: Whether it lies pixel on pixel over the main view.
        legend: (colour map, first label, last label), or None.
    """

    key: str
    title: str
    caption: str
    picture: Rgba
    in_view: bool
    legend: tuple[str, str, str] | None = None


def integrals(result: Result) -> dict[str, tuple[Float, Float]]:
    """Return every integral image of the main view by name, with its footprint."""
    known = dict(result.main.extra)
    chosen = "plain" if result.mask == "none" else result.mask
    known[chosen] = (result.main.integral, result.main.footprint)
    return {name: known[name] for name in _INTEGRALS if name in known}


def make_panels(result: Result) -> list[Panel]:
    """Return the pictures in the order of the chain, from the photo to the footprint."""
    photo = figures.photo_picture(result.photo)
    return [
        *_photo_panels(result, photo),
        *(_integral_panel(result, name, *pair) for name, pair in integrals(result).items()),
        *_map_panels(result),
    ]


def best_key(panels: list[Panel], result: Result) -> str:
    """Return the key of the picture to put beside the photo: that of the chosen mask."""
    chosen = "plain" if result.mask == "none" else result.mask
    keys = [panel.key for panel in panels]
    return chosen if chosen in keys else "photo"


def _photo_panels(result: Result, photo: Rgba) -> list[Panel]:
    name = result.photo_frame
    aligned = photo_in_view(result, photo, LONGEST_PX)
    caption = f"What the drone saw in one photo ({name})."
    panels = []
    if aligned is None or result.main.view.is_ortho:
        small = figures.fit(photo, LONGEST_PX)
        panels.append(Panel("raw", "Single photo", caption, small, False))
        caption = f"The same photo ({name}) laid on the ground, seen from straight above."
    if aligned is not None:
        aligned = _dressed(result, aligned)
        title = "Single photo, on the map" if panels else "Single photo"
        panels.append(Panel("photo", title, caption, aligned, True))
    small = figures.fit(photo, LONGEST_PX)
    masked = figures.masked_photo(small, _shrunk(result.photo_mask, small))
    text = _MASKS.get(result.mask, _MASKS["none"])
    if result.mask_stats.get("hue_informative") is False and result.mask == "hue":
        text = "Hue says nothing in these photos, so the mask keeps everything."
    panels.append(Panel("mask", "What the mask keeps", text, masked, False))
    if result.photo_rarity is not None:
        rarity = _shrunk(result.photo_rarity, small)
        whole = small[..., 3] > 0
        low, high = figures.shining_limits(rarity, whole)
        painted = figures.colour_map(rarity, whole, low, high, "inferno")
        text = "How rare each colour of the single photo is in the whole flight. Bright is rare."
        legend = ("inferno", "common", "rare")
        panels.append(
            Panel("photo-rarity", "Rare colours in the photo", text, painted, False, legend)
        )
    return panels


def _integral_panel(result: Result, name: str, image: Float, footprint: Float) -> Panel:
    title, caption = _INTEGRALS[name]
    if name == "hue" and result.mask_stats.get("hue_informative") is False:
        caption = "Hue says nothing in these photos: nothing was taken out. " + _UNSEEN
    seen = figures.covered(figures.of_ground(footprint) if name == "ground" else footprint)
    small, coverage = figures.shrink(image, seen, LONGEST_PX)
    picture = figures.faded(figures.stretch(small, coverage), coverage)
    return Panel(name, title, caption, _dressed(result, picture), True)


def _map_panels(result: Result) -> list[Panel]:
    main, panels = result.main, []
    seen = figures.covered(main.footprint if main.rays is None else main.rays)
    for name, (title, text, least, most) in _MAPS.items():
        values = getattr(main, name)
        if values is None:
            continue
        low, high = figures.shining_limits(values, seen)
        picture = _dressed(result, _painted(values, seen, low, high, "inferno"))
        legend = ("inferno", f"{least} (0)", f"{most} ({high:.2g})")
        panels.append(Panel(name.replace("_", "-"), title, text, picture, True, legend))
    low, high = figures.footprint_limits(main.footprint)
    picture = _painted(main.footprint, figures.covered(main.footprint), low, high, "viridis")
    text = (
        "How much of the picture's evidence lies on each spot, in photos. Where it is dark the "
        "pictures above rest on little: do not trust them there. " + _UNSEEN
    )
    picture = _dressed(result, picture)
    legend = ("viridis", "0 photos", f"{high:.3g} photos")
    panels.append(Panel("footprint", "Footprint", text, picture, True, legend))
    if isinstance(result.surface, FocalTerrain):
        picture, low, high = height_picture(result.surface)
        text = (
            "How high the ground is on which the pictures above are focused; a map, north up. "
            "Where next to no photo shows the ground its height is a guess from beside it."
        )
        legend = ("viridis", f"{low:.1f} m", f"{high:.1f} m")
        panels.append(Panel("terrain", "Height of the ground", text, picture, False, legend))
    return panels


def _painted(values: Float, valid: NDArray[np.bool_], low: float, high: float, name: str) -> Rgba:
    small, coverage = figures.shrink(values, valid, LONGEST_PX)
    picture = figures.colour_map(small[..., 0], coverage > 0, low, high, name)
    return figures.faded(picture, coverage)


def _dressed(result: Result, picture: Rgba) -> Rgba:
    """Add scale bar and north arrow where the view is a ground grid."""
    view = result.main.view
    if not view.is_ortho:
        return picture
    return draw_scale_and_north(picture, view.gsd_m * view.width / picture.shape[1])


def _shrunk(weights: NDArray[np.uint8], like: Rgba) -> Rgba:
    """Bring weights, shape (H, W), to the size of a picture."""
    height, width = like.shape[:2]
    return np.asarray(cv2.resize(weights, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
