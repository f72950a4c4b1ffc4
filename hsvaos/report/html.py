"""The HTML page of a run: one file that works offline, on a phone and in the dark."""

from __future__ import annotations

import base64
import platform
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from string import Template

import numpy as np

import hsvaos
from hsvaos.report import svg
from hsvaos.report.figures import Rgba, colour_map, encode
from hsvaos.report.finds_table import MAX_ROWS, finds_marks, finds_table
from hsvaos.report.ground import covered_outline, surface_down
from hsvaos.report.panels import Panel, best_key, make_panels
from hsvaos.result import Result
from hsvaos.surface import FocalPlane

_PACKAGES = ("warp-lang", "numpy", "opencv-python-headless", "onnxruntime", "rasterio", "pyproj")


def report_html(result: Result, notes: Sequence[str] = ()) -> str:
    """Return the page, complete in itself: pictures, style and script are inside.

    Args:
        result: The run.
        notes: Further lines for the user, such as why a file was not written.
    """
    panels = make_panels(result)
    # The flight's notes may be among the result's already: each is told once.
    told = dict.fromkeys([*result.notes, *result.flight.notes, *notes])
    here = files("hsvaos.report")
    return Template((here / "page.html").read_text("utf-8")).substitute(
        name=escape(result.flight.name),
        css=(here / "page.css").read_text("utf-8"),
        js=(here / "page.js").read_text("utf-8"),
        verdict=_verdict(result),
        facts=_facts(result),
        notes=_notes(told),
        compare=_compare(panels, best_key(panels, result)),
        finds=finds_table(result, panels, best_key(panels, result)),
        map=_map(result),
        marks=finds_marks(result),
        panels="".join(_figure(panel) for panel in panels),
        hue=_hue(result),
        details=_details(result),
    )


def data_uri(picture: Rgba, quality: int = 84) -> str:
    """Return a picture as a `data:` address (WebP, which keeps transparency)."""
    content = base64.b64encode(encode(picture, ".webp", quality)).decode("ascii")
    return f"data:image/webp;base64,{content}"


def _verdict(result: Result) -> str:
    count = len(result.persons)
    if not result.detected:
        return "<strong>Finds were not looked for</strong> in this run: look at the pictures."
    if count == 0:
        return (
            "<strong>Nothing stood out.</strong> That does not prove that nobody is there: look at "
            "the pictures, and at what was not seen."
        )
    places = "One place" if count == 1 else f"{count} places"
    return (
        f"<strong>{places} to look at.</strong> The strongest comes first. A find is a hint, "
        "not a proof: check it in the pictures."
    )


def _facts(result: Result) -> str:
    view, flight = result.main.view, result.flight
    if view.is_ortho:
        seen = f"map, {view.gsd_m * 100:.3g} cm a pixel"
    else:
        seen = f"from the place of {result.main.frame}"
    if isinstance(result.surface, FocalPlane):
        level = np.allclose(np.abs(result.surface.normal), (0, 0, 1), atol=1e-6)
        ground = (
            f"{'level' if level else 'tilted'} plane, down {surface_down(result.surface):.1f} m"
        )
    else:
        ground = f"terrain, down {result.surface.highest_m:.1f} to {result.surface.lowest_m:.1f} m"
    facts = {
        "Photos": str(len(flight)),
        "Picture": f"{view.width} × {view.height}, {seen}",
        "Ground": ground,
        "Mask": result.mask,
    }
    return "".join(f"<div><dt>{k}</dt><dd>{escape(v)}</dd></div>" for k, v in facts.items())


def _notes(notes: Iterable[str]) -> str:
    lines = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return f'<section class="notes"><h2>Please note</h2><ul>{lines}</ul></section>' if lines else ""


def _figure(panel: Panel) -> str:
    height, width = panel.picture.shape[:2]
    overlay = '<svg class="marks"><use href="#marks"/></svg>' if panel.in_view else ""
    legend = ""
    if panel.legend is not None:
        name, first, last = panel.legend
        legend = (
            f'<div class="legend"><span>{escape(first)}</span><i style="background:'
            f'{_gradient(name)}"></i><span>{escape(last)}</span></div>'
        )
    title = escape(panel.title)
    return (
        f'<figure data-key="{panel.key}"{" data-view" if panel.in_view else ""}>'
        f'<button class="frame" type="button" aria-label="Enlarge: {title}">'
        f'<img src="{data_uri(panel.picture)}" width="{width}" height="{height}" alt="{title}">'
        f"{overlay}</button>{legend}"
        f"<figcaption><b>{title}</b> {escape(panel.caption)}</figcaption></figure>"
    )


def _gradient(name: str) -> str:
    ramp = np.linspace(0.0, 1.0, 12, dtype=np.float32)[None]
    colours = colour_map(ramp, ramp >= 0, 0.0, 1.0, name)[0, :, :3]
    stops = ",".join("#{:02x}{:02x}{:02x}".format(*c) for c in colours.tolist())
    return f"linear-gradient(90deg,{stops})"


def _compare(panels: list[Panel], best: str) -> str:
    """Return the before/after slider; its pictures are those of the panels, set by the script."""
    in_view = [panel for panel in panels if panel.in_view]
    if "photo" not in [panel.key for panel in in_view]:
        return ""
    height, width = in_view[0].picture.shape[:2]
    options = "".join(
        f'<option value="{p.key}"{" selected" if p.key == best else ""}>{escape(p.title)}</option>'
        for p in in_view
        if p.key != "photo"
    )
    return (
        '<section class="compare" hidden><h2>Before and after</h2>'
        f'<div class="stack" style="aspect-ratio:{width}/{height};--ratio:{width / height:.4f}">'
        '<img class="under" alt="After"><img class="over" alt="Before: the single photo">'
        '<svg class="marks"><use href="#marks"/></svg><div class="knob"></div>'
        '<input type="range" min="0" max="100" value="50" step="0.1" '
        'aria-label="Move between the single photo and the picture below it"></div>'
        '<div class="controls"><span>Left: single photo</span>'
        f'<label>Right: <select aria-label="Picture on the right">{options}</select></label>'
        '<button type="button" class="blink" aria-pressed="false">Blink</button></div></section>'
    )


def _map(result: Result) -> str:
    if not result.flight.has_poses:
        return ""
    names = [frame.name for frame in result.flight.frames]
    centre = names.index(result.photo_frame) if result.photo_frame in names else None
    seen = result.main.footprint if result.main.rays is None else result.main.rays
    drawing = svg.site_map(
        result.flight.poses[:, :2, 3],
        centre,
        covered_outline(result.main.view, seen, result.surface),
        result.persons[:MAX_ROWS],
    )
    return (
        f'<section class="site"><h2>Map</h2>{drawing}<p class="key">'
        '<i class="k-shot"></i>photo <i class="k-shown"></i>photo shown here '
        '<i class="k-area"></i>ground in the pictures <i class="k-find"></i>find</p></section>'
    )


def _hue(result: Result) -> str:
    if result.hue_histogram is None:
        return ""
    stats = result.mask_stats
    informative = stats.get("hue_informative", True)
    mean, sigma = stats.get("hue_mean_deg"), stats.get("hue_sigma_deg")
    if not informative or mean is None or sigma is None:
        mean_deg, half, text = None, None, "The hues say nothing here: there is no common one."
    else:
        mean_deg, half = float(mean), float(sigma) * float(stats.get("sigmas", 2.0))
        text = f"Mean {mean_deg:.0f}°, cuts {half:.0f}° to either side: the grey range was removed."
        if result.mask != "hue":
            text = f"Mean {mean_deg:.0f}°; a hue mask would cut {half:.0f}° to either side."
    if "kept_share" in stats:
        text += f" The mask keeps {100 * float(stats['kept_share']):.0f} % of the pixels."
    drawing = svg.hue_histogram(result.hue_histogram, mean_deg, half)
    return f'<section><h2>Hues of this flight</h2>{drawing}<p class="small">{text}</p></section>'


def _details(result: Result) -> str:
    total = sum(result.timings_s.values())
    times = _rows([*result.timings_s.items(), ("all", total)], "{:.2f} s")
    numbers = [("hsvaos", hsvaos.__version__), ("Python", platform.python_version())]
    for name in _PACKAGES:
        try:
            numbers.append((name, version(name)))
        except PackageNotFoundError:
            numbers.append((name, "not installed"))
    return (
        f"<details><summary>Settings</summary><pre>{escape(result.settings.to_toml())}</pre>"
        f"</details><details><summary>Time taken</summary><table>{times}</table></details>"
        f"<details><summary>Versions</summary><table>{_rows(numbers, '{}')}</table></details>"
    )


def _rows(pairs: Iterable[tuple[str, object]], form: str) -> str:
    return "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(form.format(value))}</td></tr>"
        for name, value in pairs
    )
