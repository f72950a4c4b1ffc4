"""What a focal sweep leaves on disk: a picture a plane, the focus curve, a page with a slider."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from hsvaos.report.atomic import check_writable, write_bytes
from hsvaos.report.figures import encode, stretch, stretch_limits

if TYPE_CHECKING:
    from collections.abc import Callable

    from hsvaos.sweeping import FocalSweep

_PAGE = Path(__file__).with_name("sweep.html")
_WIDTH, _HEIGHT = 600.0, 120.0


def write_sweep(
    sweep: FocalSweep, folder: str | Path, progress: Callable[[str, int, int], None] | None = None
) -> list[str]:
    """Write the pictures of a sweep, `focus.csv`, `sweep.json` and `sweep.html`.

    Args:
        sweep: The sweep.
        folder: Where to; made if missing. Pictures of an earlier sweep are removed.
        progress: Told of every picture.

    Returns:
        Names of the files, the page last.

    Raises:
        FlightError: If the folder cannot be written to.
        OSError: If a file cannot be written.
    """
    folder = check_writable(folder)
    names = [f"plane_{i:04d}.png" for i in range(len(sweep.downs_m))]
    limits = _common_limits(sweep)
    for i, name in enumerate(names):
        picture = stretch(sweep.images[i], sweep.footprints[i], limits)
        write_bytes(folder / name, encode(picture))
        if progress is not None:
            progress("writing pictures", i + 1, len(names))
    for old in folder.glob("plane_[0-9][0-9][0-9][0-9].png"):
        if old.name not in names:
            old.unlink()
    texts = {
        "focus.csv": _table(sweep),
        "sweep.json": json.dumps(sweep.to_dict(), indent=1),
        "sweep.html": _page(sweep, names),
    }
    for name, text in texts.items():
        write_bytes(folder / name, text.encode("utf-8"))
    return [*names, *texts]


def _common_limits(sweep: FocalSweep) -> tuple[float, float]:
    """One stretch for all planes, so that only focus changes as the slider moves."""
    limits = [
        stretch_limits(image, cover > 0.0)
        for image, cover in zip(sweep.images, sweep.footprints, strict=True)
        if (cover > 0.0).any()
    ]
    low, high = np.median(np.array(limits), axis=0)
    return float(low), float(high)


def _table(sweep: FocalSweep) -> str:
    names = list(sweep.curves)
    lines = [",".join(["down_m", *names])]
    for i, down in enumerate(sweep.downs_m):
        lines.append(",".join([f"{down:.4f}", *(f"{sweep.curves[n][i]:.6g}" for n in names)]))
    return "\n".join(lines) + "\n"


def _page(sweep: FocalSweep, names: list[str]) -> str:
    start = int(np.argmin(np.abs(sweep.downs_m - sweep.focus_m)))
    data = {"downs": [round(float(d), 3) for d in sweep.downs_m], "files": names, "start": start}
    return Template(_PAGE.read_text(encoding="utf-8")).substitute(
        frame=escape(sweep.frame),
        summary=escape(sweep.summary()),
        notes="".join(f"<li>{escape(note)}</li>" for note in sweep.notes),
        curve=_curve(sweep.curves["kurtosis"]),
        rarity=_curve(sweep.curves["rarity_kurtosis"]),
        last=len(names) - 1,
        start=start,
        data=json.dumps(data).replace("<", "\\u003c"),
    )


def _curve(curve: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """The focus curve as points of an SVG polyline, on a logarithmic scale."""
    heights = np.log(np.maximum(curve, max(float(curve.max()), 1e-12) * 1e-4))
    span = float(np.ptp(heights)) or 1.0
    x = np.linspace(0.0, _WIDTH, len(curve))
    y = _HEIGHT - (heights - heights.min()) / span * _HEIGHT
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
