"""The command line: one short function a command, each onto the API."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hsvaos.benchmark.command import bench
from hsvaos.cli_options import (
    Aperture,
    Autofocus,
    DetectOption,
    Device,
    FlightPath,
    FocusDown,
    Format,
    Fov,
    FrameMask,
    GroundDown,
    Json,
    MaskOption,
    Out,
    Poses,
    Relief,
    Scale,
    Score,
    SettingsFile,
    Sigmas,
    Terrain,
    focus_of,
    settings_of,
)
from hsvaos.detect import command as detection
from hsvaos.live.command import live
from hsvaos.nav.command import nav
from hsvaos.simulate.command import simulate
from hsvaos.viewer.command import view as view_command

if TYPE_CHECKING:
    from hsvaos.flight import Flight
    from hsvaos.result import Result

app = typer.Typer(
    name="hsvaos",
    help="Makes a forest vanish from drone photos and shows who lies underneath.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


app.command()(detection.detect)
app.command()(live)
app.command()(nav)
app.command()(simulate)
app.command("view")(view_command)
app.command()(bench)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from hsvaos import __version__

        typer.echo(f"hsvaos {__version__}")
        raise typer.Exit


@app.command()
def demo(
    out: Out = Path("hsvaos-demo"),
    detect: DetectOption = None,
    device: Device = "cpu",
    as_json: Json = False,
) -> None:
    """Run the whole chain on the small flight in the package: log, photos, finds, report."""
    from hsvaos.console import Console
    from hsvaos.demo import demo_flight
    from hsvaos.report.atomic import check_writable

    check_writable(out)
    chosen = settings_of(None, detect={"method": detect})
    _run(demo_flight(), out, chosen, device, Console(quiet=as_json))


@app.command()
def run(
    flight: FlightPath,
    out: Out,
    fov: Fov = None,
    poses: Poses = None,
    format: Format = None,
    ground_down: GroundDown = None,
    frame_mask: FrameMask = None,
    mask: MaskOption = None,
    sigmas: Sigmas = None,
    focus_down: FocusDown = None,
    terrain: Terrain = None,
    autofocus: Autofocus = False,
    relief: Relief = None,
    view: Annotated[
        str | None,
        typer.Option(
            metavar="FRAME|all|cover|ortho",
            help="Virtual camera; cover: as few frames as see all. (default: centre frame)",
        ),
    ] = None,
    gsd: Annotated[
        float | None, typer.Option(metavar="M", help="Metres a pixel of the ground grid.")
    ] = None,
    aperture: Aperture = None,
    scale: Scale = None,
    detect: DetectOption = None,
    score: Score = None,
    no_detect: Annotated[
        bool, typer.Option("--no-detect", help="Only make pictures, look for nobody.")
    ] = False,
    settings: SettingsFile = None,
    device: Device = "cpu",
    as_json: Json = False,
) -> None:
    """See through the canopy of a flight: pictures, finds and a report."""
    from hsvaos.console import Console
    from hsvaos.formats.open import open_flight
    from hsvaos.report.atomic import check_writable

    chosen = settings_of(
        settings,
        focus=focus_of(focus_down, terrain, autofocus),
        mask={"method": mask, "sigmas": sigmas},
        view={"frame": view, "gsd_m": gsd, "aperture_m": aperture},
        photos={"scale": scale},
        detect={"method": detect, "enabled": False if no_detect else None},
    ).with_values(focus={"relief": relief})
    if score is not None:
        chosen = chosen.with_score(score)
    check_writable(out)
    opened = open_flight(flight, None, poses, format, fov, ground_down, frame_mask)
    _run(opened, out, chosen, device, Console(quiet=as_json))


@app.command()
def sweep(
    flight: FlightPath,
    out: Out,
    first: Annotated[float, typer.Option("--from", metavar="M", help="Down of the first plane.")],
    last: Annotated[float, typer.Option("--to", metavar="M", help="Down of the last plane.")],
    steps: Annotated[int, typer.Option(min=2, max=10000, help="Number of planes.")] = 32,
    fov: Fov = None,
    poses: Poses = None,
    format: Format = None,
    frame_mask: FrameMask = None,
    mask: MaskOption = None,
    sigmas: Sigmas = None,
    view: Annotated[
        str | None, typer.Option(metavar="FRAME", help="Virtual camera. (default: centre frame)")
    ] = None,
    size: Annotated[int, typer.Option(min=16, help="Longest side of the pictures.")] = 1024,
    scale: Scale = None,
    settings: SettingsFile = None,
    device: Device = "cpu",
    as_json: Json = False,
) -> None:
    """Drag a focal plane through the forest: focal stack, focus curve and a page with a slider."""
    from hsvaos.console import Console
    from hsvaos.formats.open import open_flight
    from hsvaos.report.atomic import check_writable
    from hsvaos.report.sweep import write_sweep
    from hsvaos.sweeping import sweep_flight

    chosen = settings_of(
        settings,
        mask={"method": mask, "sigmas": sigmas},
        view={"frame": view},
        photos={"scale": scale},
    )
    check_writable(out)
    opened = open_flight(flight, None, poses, format, fov, None, frame_mask)
    console = Console(quiet=as_json)
    with console.progress() as progress:
        stack = sweep_flight(
            opened, first, last, steps, chosen, size_px=size, device=device, progress=progress
        )
        files = write_sweep(stack, out, progress)
    if as_json:
        typer.echo(json.dumps(stack.to_dict() | {"out": str(out), "files": files}))
        return
    console.notes(stack.notes)
    typer.echo(stack.summary())
    typer.echo(f"look at {out / 'sweep.html'}")


@app.command()
def evaluate(
    flights: Annotated[
        list[Path], typer.Argument(metavar="FLIGHT...", help="Folders with truth.json.")
    ],
    out: Out,
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE|nav",
            help="Poses or a trajectory to use instead, a file in each flight's folder; nav: "
            "those of the flight's sensor log.",
        ),
    ] = None,
    mask: MaskOption = None,
    sigmas: Sigmas = None,
    focus_down: FocusDown = None,
    terrain: Terrain = None,
    autofocus: Autofocus = False,
    aperture: Aperture = None,
    scale: Scale = None,
    detect: DetectOption = None,
    score_threshold: Score = None,
    iou: Annotated[
        list[float] | None,
        typer.Option(help="Least overlap; repeatable. (default: 0.10, 0.25 and 0.50)"),
    ] = None,
    radius: Annotated[
        float, typer.Option(metavar="M", help="Greatest distance of a person found to the true.")
    ] = 2.0,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Run flights again whose results are there already.")
    ] = False,
    settings: SettingsFile = None,
    device: Device = "cpu",
    as_json: Json = False,
) -> None:
    """Say how good the finds are on simulated flights: average precision, persons, false alarms."""
    from hsvaos.console import Console
    from hsvaos.evaluate.command import Work, evaluate_paths
    from hsvaos.evaluate.measures import Rules

    chosen = settings_of(
        settings,
        focus=focus_of(focus_down, terrain, autofocus),
        mask={"method": mask, "sigmas": sigmas},
        view={"aperture_m": aperture},
        photos={"scale": scale},
        detect={"method": detect},
    )
    rules = Rules(ious=tuple(iou) if iou else Rules().ious, score=score_threshold, radius_m=radius)
    work = Work(tuple(flights), out, chosen, rules, poses, device, fresh)
    outcome = evaluate_paths(work, Console(quiet=as_json))
    if as_json:
        typer.echo(json.dumps(outcome))


@app.command()
def info(
    flight: FlightPath,
    fov: Fov = None,
    poses: Poses = None,
    format: Format = None,
    as_json: Json = False,
) -> None:
    """Say what a flight holds, without decoding its photos."""
    from hsvaos.formats.open import open_flight
    from hsvaos.summary import flight_summary

    summary = flight_summary(open_flight(flight, None, poses, format, fov))
    if as_json:
        typer.echo(json.dumps(summary))
        return
    for name, value in summary.items():
        lines = value if isinstance(value, list) else [value]
        for i, line in enumerate(lines or ["none"]):
            typer.echo(f"{name if i == 0 else '':14s}{line}")


@app.command()
def convert(
    flight: FlightPath,
    out: Out,
    fov: Fov = None,
    poses: Poses = None,
    format: Format = None,
    ground_down: GroundDown = None,
    frame_mask: FrameMask = None,
) -> None:
    """Write a flight of any known format as a native flight folder."""
    from hsvaos.console import Console
    from hsvaos.formats.native_write import write_native
    from hsvaos.formats.open import open_flight

    opened = open_flight(flight, None, poses, format, fov, ground_down, frame_mask)
    write_native(opened, out)
    Console().notes(opened.notes)
    typer.echo(f"{len(opened)} photos written to {out}")


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say which versions and devices are here, and what each extra lacks."""
    from hsvaos.kernels.device import quiet_start
    from hsvaos.summary import doctor_summary

    quiet_start()
    summary = doctor_summary()
    if as_json:
        typer.echo(json.dumps(summary))
        return
    for section, entries in summary.items():
        typer.echo(section)
        for name, value in entries.items():
            typer.echo(f"  {name:24s}{value}")


def _run(flight: Flight, out: Path, settings: Any, device: str, console: Any) -> None:
    from hsvaos.pipeline import run as run_pipeline
    from hsvaos.report.views import ViewWriter, remove_views
    from hsvaos.report.write import write_result
    from hsvaos.viewing import SEVERAL

    with console.progress() as progress:
        remove_views(out)
        on_view = ViewWriter(out) if settings.view.frame in SEVERAL else None
        result = run_pipeline(flight, settings, device=device, progress=progress, on_view=on_view)
        progress("writing pictures and report", 0, 1)
        files = write_result(result, out)
        progress("writing pictures and report", 1, 1)
    if console.quiet:
        typer.echo(json.dumps(_outcome(result, out, sorted(files))))
        return
    console.result(result, out)


def _outcome(result: Result, out: Path, files: list[str]) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "out": str(out),
        "files": files,
        "frame": result.main.frame,
        "frames": len(result.flight),
        "persons": [asdict(person) for person in result.persons],
        "mask": result.mask_stats,
        "notes": list(result.notes),
        "timings_s": result.timings_s,
    }
