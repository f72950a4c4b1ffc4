"""The command `hsvaos live`: a flight played as if it were flown now."""

from __future__ import annotations

import threading
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hsvaos.cli_options import (
    Device,
    FlightPath,
    FocusDown,
    Format,
    Fov,
    FrameMask,
    GroundDown,
    Json,
    Poses,
    Scale,
    SettingsFile,
    Sigmas,
    Terrain,
    focus_of,
    settings_of,
)

if TYPE_CHECKING:
    from hsvaos.console import Console
    from hsvaos.flight import Origin
    from hsvaos.live.integrator import LiveIntegrator
    from hsvaos.live.play import Player

_TELL_EVERY_S = 2.0


class LiveMask(StrEnum):
    """Names of the masks that can be made as photos come in."""

    hue = "hue"
    rarity = "rarity"
    none = "none"


class LiveView(StrEnum):
    """Names of the views."""

    moving = "moving"
    fixed = "fixed"


def live(
    flight: FlightPath,
    fov: Fov = None,
    poses: Poses = None,
    format: Format = None,
    ground_down: GroundDown = None,
    frame_mask: FrameMask = None,
    window: Annotated[int, typer.Option(min=1, help="Photos of the window.")] = 30,
    size: Annotated[int, typer.Option(min=16, help="Longest side of the picture.")] = 512,
    mask: Annotated[
        LiveMask | None, typer.Option(help="How pixels are weighed. (default: hue; none for grey)")
    ] = None,
    sigmas: Sigmas = None,
    focus_down: FocusDown = None,
    terrain: Terrain = None,
    view: Annotated[
        LiveView, typer.Option(help="A view that follows the photos, or rests over the middle.")
    ] = LiveView.moving,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Photos a second, whatever their times.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Times as fast as it was flown.")] = 1.0,
    minutes: Annotated[
        float | None, typer.Option(metavar="M", help="Play over and over for so long.")
    ] = None,
    log_poses: Annotated[
        bool, typer.Option("--log-poses", help="Poses from the sensor log, as it comes in.")
    ] = False,
    detect_every: Annotated[
        int, typer.Option(metavar="K", min=0, help="Look for people in every K-th picture.")
    ] = 0,
    search: Annotated[
        bool,
        typer.Option(
            "--search",
            help="Search the window's photos with all that run looks at, which takes seconds.",
        ),
    ] = False,
    finds: Annotated[
        Path | None,
        typer.Option(metavar="FILE.geojson", help="Save who was found by --search."),
    ] = None,
    scale: Scale = None,
    settings: SettingsFile = None,
    device: Device = "cpu",
    no_show: Annotated[
        bool, typer.Option("--no-show", help="Serve no page with the picture.")
    ] = False,
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 lets others in.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port; the next free one if it is taken.")
    ] = 8080,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE.png", help="Save the last picture.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Integrate a flight as it is flown: the newest photos, with latencies, in a browser."""
    from hsvaos.console import Console
    from hsvaos.flight import FlightError
    from hsvaos.formats.open import open_flight
    from hsvaos.live.play import Pace, Player
    from hsvaos.live.setup import Options, integrator_for
    from hsvaos.report.atomic import check_writable

    if out is not None:
        if out.suffix.lower() not in (".png", ".jpg"):
            raise FlightError(f"-o {out}: expected a file that ends .png or .jpg")
        check_writable(out.parent, (out.name,))
    if finds is not None:
        if not search or finds.suffix.lower() not in (".geojson", ".json"):
            raise FlightError(f"--finds {finds}: expected --search, and a file that ends .geojson")
        check_writable(finds.parent, (finds.name,))
    chosen = settings_of(
        settings,
        focus=focus_of(focus_down, terrain, False),
        mask={"method": mask, "sigmas": sigmas, "scope": None if settings else "flight"},
        photos={"scale": scale},
    )
    every = max(1, detect_every) if search else detect_every
    asked = Options(window, size, view is LiveView.moving, every, search, log_poses)
    pace = Pace(rate, speed, minutes)
    opened = open_flight(flight, None, poses, format, fov, ground_down, frame_mask)
    console = Console(quiet=as_json)
    console.notes(opened.notes)
    if search:
        console.say("making ready to search")
    integrator, sensors, opened, notes = integrator_for(opened, chosen, asked, mask is None, device)
    console.notes(notes)
    with integrator:
        player = Player(opened, integrator, pace, sensors, chosen.photos.scale)
        page = None if no_show else _page(opened.name, integrator, host, port, console)
        try:
            _play(player, integrator, console)
        finally:
            if page is not None:
                page.close()
        _finish(player, integrator, out, finds, opened.origin, console)


def _page(name: str, live: LiveIntegrator, host: str, port: int, console: Console) -> Any:
    from hsvaos.viewer.command import LOCAL
    from hsvaos.viewer.live_page import live_page

    page = live_page(name, live, host, port)
    if port not in (0, page.port):
        console.say(f"port {port} is taken: using {page.port}")
    if host != LOCAL:
        console.say(f"everybody who reaches {host}:{page.port} can look at this flight")
    console.say(f"look at {page.url} (Ctrl-C ends)")
    return page


def _play(player: Player, live: LiveIntegrator, console: Console) -> None:
    """Play in a thread, and tell how it goes, until the end or Ctrl-C."""
    from hsvaos.live.tell import line

    stop, over = threading.Event(), threading.Event()
    fault: list[Exception] = []

    def play() -> None:
        try:
            player.play(stop)
            live.drain()
        except Exception as error:  # told by the main thread
            fault.append(error)
        finally:
            over.set()

    thread = threading.Thread(target=play, name="hsvaos-play", daemon=True)
    thread.start()
    try:
        while not over.wait(_TELL_EVERY_S):
            console.say(line(live))
    except KeyboardInterrupt:  # how a flight is ended
        console.say("stopped")
    finally:
        stop.set()
        thread.join()
    if fault:
        raise fault[0]


def _finish(
    player: Player,
    live: LiveIntegrator,
    out: Path | None,
    finds: Path | None,
    origin: Origin | None,
    console: Console,
) -> None:
    """Save the last picture and who was found, and print the summary."""
    import json

    from hsvaos.live.memory import resident_mb
    from hsvaos.live.tell import persons_table, summary
    from hsvaos.report import figures
    from hsvaos.report.atomic import write_bytes
    from hsvaos.report.draw import draw_boxes
    from hsvaos.report.finds import person_record, persons_geojson

    stats, result = live.stats(), live.latest()
    if live.navigator is not None:
        console.notes(f"nav: {note}" for note in live.navigator.notes)
    if player.faults:
        console.notes([f"{len(player.faults)} photos left out: {player.faults[0]}"])
    saved = None
    if out is not None and result is not None:
        picture = figures.stretch(result.image, result.footprint)
        if result.finds is not None:
            picture = draw_boxes(picture, result.finds.seen_from(result.view))
        saved = str(write_bytes(out, figures.encode(picture, out.suffix.lower())))
    persons = live.persons(origin)
    if finds is not None:
        write_bytes(finds, persons_geojson(persons, origin).encode("utf-8"))
    if console.quiet:
        outcome = asdict(stats) | {
            "window": len(live.window),
            "left_out": len(player.faults),
            "behind_s": round(player.behind_s, 3),
            "resident_mb": resident_mb(),
            "out": saved,
            "persons": [person_record(person) for person in persons],
        }
        typer.echo(json.dumps(outcome))
        return
    console.show(*summary(live, player))
    if persons:
        console.show(persons_table(persons))
    if finds is not None:
        console.show(f"found {len(persons)}: {finds}")
    if saved is not None:
        console.show(f"look at {saved}")
    if result is None:
        console.notes(["no picture was made"])
