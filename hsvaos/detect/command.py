"""The command `hsvaos detect`: integral images in, people out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hsvaos.detect.detections import Detections
    from hsvaos.detect.yolo import Detector
    from hsvaos.formats.integral import StoredView

_MOST_ROWS = 40


def detect(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...", help="Pictures, or integral.npz of a run.", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Write detections.json and pictures."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(metavar="FILE", help="ONNX network instead of the built-in one.")
    ] = None,
    layout: Annotated[
        str, typer.Option(metavar="L", help="Layout of the network, where it does not tell.")
    ] = "auto",
    score: Annotated[
        float | None, typer.Option(metavar="S", help="Least score, 0 to 1.", show_default=False)
    ] = None,
    gsd: Annotated[
        float | None, typer.Option(metavar="M", help="Metres a pixel, if known.")
    ] = None,
    person_class: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name or number of the class to look for.")
    ] = None,
    provider: Annotated[
        str | None, typer.Option(help="cuda, tensorrt or cpu; by default the first that is here.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the outcome as JSON, no progress.")
    ] = False,
) -> None:
    """Find people in integral images with a network."""
    import cv2

    from hsvaos.console import Console
    from hsvaos.detect.yolo import Detector
    from hsvaos.formats.integral import read_view
    from hsvaos.report.atomic import check_writable, write_bytes
    from hsvaos.report.finds import views_json

    if out is not None:
        check_writable(out, ("detections.json",))
    number = person_class is not None and person_class.isdigit()
    wanted = int(person_class) if number and person_class is not None else person_class
    detector = Detector(model, layout, score=score, person_class=wanted, provider=provider)
    console = Console(quiet=as_json)
    console.notes(detector.notes)
    paths = list(dict.fromkeys(images))
    views: list[tuple[str, Detections]] = []
    files: list[str] = []
    errors: list[str] = []
    pictures = _picture_names(paths)
    with console.progress() as progress:
        for path, name in console.counted(
            zip(paths, _frame_names(paths), strict=True), "looking for people", len(paths), progress
        ):
            try:
                view = read_view(path)
                found = _look(detector, view, path, gsd)
                if out is not None:
                    _draw(view, found, out / pictures[path])
                    files.append(pictures[path])
            except (ValueError, TypeError, OSError, MemoryError, cv2.error) as error:
                errors.append(" ".join(str(error).split()) or type(error).__name__)
                continue
            views.append((name, found))
    if out is not None and views:
        write_bytes(out / "detections.json", views_json(views).encode("utf-8"))
        files.append("detections.json")
    if as_json:
        told = {"layout": detector.layout, "provider": detector.provider, "score": detector.score}
        outcome = json.loads(views_json(views)) | told
        outcome |= {"out": None if out is None else str(out), "files": files}
        typer.echo(json.dumps(outcome | {"notes": list(detector.notes), "errors": errors}))
    else:
        _print(views, detector, model, out)
    for line in errors:
        typer.echo(f"error: {line}", err=True)
    if errors:
        raise typer.Exit(2)


def _look(detector: Detector, view: StoredView, path: Path, gsd_m: float | None) -> Detections:
    """Find the people in what a file holds; mistakes name the file."""
    try:
        return detector.detect(
            view.image,
            footprint=view.rays,
            rarity=view.rarity,
            gsd_m=view.gsd_m if gsd_m is None else gsd_m,
        )
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None


def _draw(view: StoredView, found: Detections, path: Path) -> None:
    import numpy as np

    from hsvaos.report.atomic import write_bytes
    from hsvaos.report.draw import draw_boxes
    from hsvaos.report.figures import encode, photo_picture, stretch

    seen = view.seen
    if seen.all():
        shown = photo_picture(view.image)
    else:
        shown = stretch(np.nan_to_num(view.image, nan=0.0), seen.astype(np.float32))
    write_bytes(path, encode(draw_boxes(shown, found)))


def _frame_names(paths: Sequence[Path]) -> list[str]:
    """File names, or whole paths where names occur more than once."""
    counts = Counter(path.name for path in paths)
    return [path.name if counts[path.name] == 1 else str(path) for path in paths]


def _picture_names(paths: Sequence[Path]) -> dict[Path, str]:
    """A name of its own for the picture of each file, never that of a file looked at."""
    taken = {path.name for path in paths}
    names = {}
    for path in paths:
        name, number = f"{path.stem}_detections.png", 2
        while name in taken:
            name, number = f"{path.stem}_detections_{number}.png", number + 1
        taken.add(name)
        names[path] = name
    return names


def _print(
    views: Sequence[tuple[str, Detections]],
    detector: Detector,
    model: Path | None,
    out: Path | None,
) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    terminal = Console()

    def say(text: str) -> None:
        terminal.print(text, highlight=False, markup=False, soft_wrap=True)

    count = sum(len(found) for _, found in views)
    table = Table(title=f"{count} finds in {len(views)} images", title_justify="left")
    table.add_column("image", overflow="fold")
    for name in ("score", "left", "top", "right", "bottom"):
        table.add_column(name, justify="right")
    rows: list[list[str]] = []
    for name, found in views:
        boxes = zip(found.boxes_xyxy.tolist(), found.scores.tolist(), strict=True)
        rows += [[name, f"{score:.2f}", *(f"{side:.1f}" for side in box)] for box, score in boxes]
        rows += [[name, "none"]] if len(found) == 0 else []
    for row in rows[:_MOST_ROWS]:
        table.add_row(escape(row[0]), *row[1:])
    if views:
        terminal.print(table)
    if len(rows) > _MOST_ROWS:
        say(f"... and {len(rows) - _MOST_ROWS} rows more, see --json or -o")
    name = "the built-in network" if model is None else str(model)
    say(
        f"looked with {name}, layout {detector.layout}, score {detector.score:g} or more, on "
        f"{detector.provider}"
    )
    if out is not None and views:
        say(f"look at {out}")
