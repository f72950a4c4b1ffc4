"""The command line: one short function a command, each onto the API."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hsvaos.detect.command import detect
from hsvaos.nav.command import nav
from hsvaos.simulate.command import simulate

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


app.command()(detect)
app.command()(nav)
app.command()(simulate)


class Mask(StrEnum):
    """Names of the masks."""

    hue = "hue"
    rarity = "rarity"
    anomaly = "anomaly"
    none = "none"


FlightPath = Annotated[Path, typer.Argument(metavar="FLIGHT", help="Folder of a flight.")]
Out = Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")]
Fov = Annotated[
    float | None, typer.Option("--fov", metavar="DEG", help="Horizontal field of view of photos.")
]
Poses = Annotated[
    Path | None, typer.Option(metavar="FILE", help="poses.csv or poses.json to use instead.")
]
GroundDown = Annotated[
    float | None,
    typer.Option(metavar="M", help="Down of the ground, where the flight does not say it well."),
]
FrameMask = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Image of valid pixels; black is ignored.")
]
Format = Annotated[str | None, typer.Option(help="native, jku, dji or photos; guessed if absent.")]
MaskOption = Annotated[Mask | None, typer.Option(help="How pixels are weighed. [default: hue]")]
Sigmas = Annotated[float | None, typer.Option(help="Half width of the hue cut. [default: 2]")]
FocusDown = Annotated[
    float | None, typer.Option(metavar="M", help="Down of a horizontal focal plane.")
]
Terrain = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Focal terrain: GeoTIFF, .obj or .npz.")
]
Autofocus = Annotated[
    bool, typer.Option("--autofocus", help="Search the plane where rare things are sharp.")
]
Aperture = Annotated[
    float | None, typer.Option(metavar="M", help="Radius of the synthetic aperture.")
]
Scale = Annotated[
    float | None, typer.Option(help="Shrink photos by this factor while decoding. [default: 1]")
]
SettingsFile = Annotated[
    Path | None,
    typer.Option("--settings", metavar="FILE.toml", help="Settings; options here win over it."),
]
Device = Annotated[str, typer.Option(help="cpu, cuda:0, ...")]
Json = Annotated[bool, typer.Option("--json", help="Print the outcome as JSON, no progress.")]


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from hsvaos import __version__

        typer.echo(f"hsvaos {__version__}")
        raise typer.Exit


@app.command()
def demo(out: Out = Path("hsvaos-demo"), device: Device = "cpu", as_json: Json = False) -> None:
    """Run the whole chain on the small flight in the package: log, photos, finds, report."""
    from hsvaos.console import Console
    from hsvaos.demo import demo_flight
    from hsvaos.report.atomic import check_writable

    check_writable(out)
    _run(demo_flight(), out, _settings(None), device, Console(quiet=as_json))


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
    view: Annotated[
        str | None,
        typer.Option(metavar="FRAME|all|ortho", help="Virtual camera. [default: centre frame]"),
    ] = None,
    gsd: Annotated[
        float | None, typer.Option(metavar="M", help="Metres a pixel of the ground grid.")
    ] = None,
    aperture: Aperture = None,
    scale: Scale = None,
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

    chosen = _settings(
        settings,
        focus={
            "down_m": focus_down,
            "terrain": None if terrain is None else str(terrain),
            "autofocus": autofocus or None,
        },
        mask={"method": None if mask is None else mask.value, "sigmas": sigmas},
        view={"frame": view, "gsd_m": gsd, "aperture_m": aperture},
        photos={"scale": scale},
        detect={"enabled": False if no_detect else None},
    )
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
        str | None, typer.Option(metavar="FRAME", help="Virtual camera. [default: centre frame]")
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

    chosen = _settings(
        settings,
        mask={"method": None if mask is None else mask.value, "sigmas": sigmas},
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
    score_threshold: Annotated[
        float | None,
        typer.Option(metavar="S", help="Score from which a find counts. [default: the detector's]"),
    ] = None,
    iou: Annotated[
        list[float] | None,
        typer.Option(help="Least overlap; repeatable. [default: 0.10, 0.25 and 0.50]"),
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

    chosen = _settings(
        settings,
        focus={
            "down_m": focus_down,
            "terrain": None if terrain is None else str(terrain),
            "autofocus": autofocus or None,
        },
        mask={"method": None if mask is None else mask.value, "sigmas": sigmas},
        view={"aperture_m": aperture},
        photos={"scale": scale},
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


def _settings(path: Path | None, **tables: dict[str, Any]) -> Any:
    """Settings of a file, or the defaults, with the options given on the command line."""
    from hsvaos.settings import Settings

    settings = Settings() if path is None else Settings.from_file(path)
    focus = tables.get("focus", {})
    if any(value is not None for value in focus.values()):  # one kind of focus replaces another
        focus = {"down_m": None, "terrain": None, "autofocus": False} | {
            name: value for name, value in focus.items() if value is not None
        }
        settings = settings.with_focus(focus)
    return settings.with_values(**{name: t for name, t in tables.items() if name != "focus"})


def _run(flight: Flight, out: Path, settings: Any, device: str, console: Any) -> None:
    from hsvaos.pipeline import run as run_pipeline
    from hsvaos.report.views import ViewWriter, remove_views
    from hsvaos.report.write import write_result

    with console.progress() as progress:
        remove_views(out)
        on_view = ViewWriter(out) if settings.view.frame == "all" else None
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
