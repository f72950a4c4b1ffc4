"""The command `hsvaos live`: a flight played as if it were flown now."""

from __future__ import annotations

import threading
from dataclasses import asdict, dataclass, replace
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
    from hsvaos.flight import Flight
    from hsvaos.live.integrator import LiveIntegrator
    from hsvaos.live.play import Player, Sensors
    from hsvaos.settings import Settings
    from hsvaos.surface import FocalSurface
    from hsvaos.viewer.stream import Shown

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


@dataclass(frozen=True)
class Options:
    """What was asked for.

    Args:
        window: Photos of the window.
        size: Longest side of the picture [px].
        moving: Whether the view follows the photos.
        rate_hz: Photos a second; None for their own times.
        speed: Factor on that.
        minutes: How long to play, over and over; None for once.
        detect_every: Pictures from one that is looked at to the next; 0 for none.
        from_log: Whether poses come from the sensor log even where there are some.
    """

    window: int
    size: int
    moving: bool
    rate_hz: float | None
    speed: float
    minutes: float | None
    detect_every: int
    from_log: bool


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
    from hsvaos.report.atomic import check_writable

    if out is not None:
        if out.suffix.lower() not in (".png", ".jpg"):
            raise FlightError(f"-o {out}: expected a file that ends .png or .jpg")
        check_writable(out.parent, (out.name,))
    chosen = settings_of(
        settings,
        focus=focus_of(focus_down, terrain, False),
        mask={"method": mask, "sigmas": sigmas, "scope": None if settings else "flight"},
        photos={"scale": scale},
    )
    asked = Options(
        window, size, view is LiveView.moving, rate, speed, minutes, detect_every, log_poses
    )
    pace = Pace(rate, speed, minutes)
    opened = open_flight(flight, None, poses, format, fov, ground_down, frame_mask)
    console = Console(quiet=as_json)
    console.notes(opened.notes)
    integrator, sensors, opened = _made(opened, chosen, asked, mask is not None, device, console)
    with integrator:
        player = Player(opened, integrator, pace, sensors, chosen.photos.scale)
        page = None if no_show else _page(opened.name, integrator, host, port, console)
        try:
            _play(player, integrator, console)
        finally:
            if page is not None:
                page.close()
        _finish(player, integrator, out, console)


def _made(
    flight: Flight,
    settings: Settings,
    asked: Options,
    mask_asked: bool,
    device: str,
    console: Console,
) -> tuple[LiveIntegrator, Sensors | None, Flight]:
    """Return the integrator, the sensor log that feeds it, and the flight with times of photos."""
    from hsvaos.flight import FlightError
    from hsvaos.formats.images import decode_photo
    from hsvaos.live.integrator import LiveIntegrator
    from hsvaos.live.play import Sensors, valid_pixels
    from hsvaos.nav.online import OnlineFilter
    from hsvaos.viewing import sized_view

    navigator = sensors = None
    if asked.from_log or not flight.has_poses:
        from hsvaos.formats.sensor_log import sensor_log_of
        from hsvaos.nav.checks import check_log

        log = check_log(sensor_log_of(flight))
        navigator = OnlineFilter(mounting=log.mounting, origin=log.origin)
        sensors = Sensors(log, navigator)
        times = dict(log.triggers)
        frames = [replace(f, t_s=times.get(f.name, f.t_s)) for f in flight.frames]
        flight = flight.replace(frames=tuple(f for f in frames if f.t_s == f.t_s))
        if not asked.moving:
            raise FlightError("--view fixed needs a flight with poses: leave --log-poses away")
    first = decode_photo(flight.frames[0].path).image
    method = settings.mask
    if first.ndim == 2 and not mask_asked and method.method == "hue":
        method = replace(method, method="none")
        console.notes(["the photos are grey: hue says nothing, the mask keeps everything"])
    camera = flight.camera
    scale = settings.photos.scale
    camera = camera.scaled(*(max(1, round(n * scale)) for n in (camera.width, camera.height)))
    detector = None
    if asked.detect_every:
        from hsvaos.detect.yolo import Detector

        detect = settings.detect
        detector = Detector(detect.model, detect.layout, score=detect.min_score, threads=1)
    integrator = LiveIntegrator(
        camera,
        _surface(flight, settings),
        frames=asked.window,
        size=asked.size,
        view=None if asked.moving else sized_view(flight, flight.centre_index, asked.size),
        mask=method,
        valid=valid_pixels(flight, scale),
        channels=3 if first.ndim == 3 else 1,
        dtype=first.dtype.name,
        navigator=navigator,
        detector=detector,
        detect_every=max(1, asked.detect_every),
        device=device,
    )
    return integrator, sensors, flight


def _surface(flight: Flight, settings: Settings) -> FocalSurface:
    from hsvaos.flight import FlightError
    from hsvaos.focusing import choose_surface
    from hsvaos.surface import FocalPlane

    focus = settings.focus
    known = (focus.down_m, focus.terrain, flight.terrain, flight.ground_down_m)
    if all(one is None for one in known) or focus.autofocus:
        raise FlightError(
            f"{flight.source}: a live flight cannot search for its focus: give --focus-down or "
            f"--terrain"
        )
    if flight.has_poses:
        return choose_surface(flight, focus, [])[0]
    down = flight.ground_down_m if focus.down_m is None else focus.down_m
    if down is None or focus.terrain is not None:
        raise FlightError(f"{flight.source}: without poses a live flight needs --focus-down")
    return FocalPlane(down)


def _page(name: str, live: LiveIntegrator, host: str, port: int, console: Console) -> Any:
    from hsvaos.viewer.command import LOCAL
    from hsvaos.viewer.stream import Stream

    page = Stream(name, live.newest, lambda: _shown(live), host, port)
    if port not in (0, page.port):
        console.say(f"port {port} is taken: using {page.port}")
    if host != LOCAL:
        console.say(f"everybody who reaches {host}:{page.port} can look at this flight")
    console.say(f"look at {page.url} (Ctrl-C ends)")
    return page


def _shown(live: LiveIntegrator) -> Shown | None:
    """Return the newest picture for the page, with the boxes found last."""
    import numpy as np

    from hsvaos.report.draw import draw_boxes
    from hsvaos.viewer.picture import integral_picture
    from hsvaos.viewer.request import Look
    from hsvaos.viewer.stream import Shown

    result = live.latest()
    if result is None:
        return None
    rgb = integral_picture(result.image, result.footprint, Look())
    if result.finds is not None and len(result.finds.detections):
        solid = np.full((*rgb.shape[:2], 1), 255, np.uint8)
        rgba = draw_boxes(np.concatenate([rgb, solid], axis=2), result.finds.detections)
        rgb = np.ascontiguousarray(rgba[..., :3])
    text = (
        f"photo {result.number}, {result.frames} in the window, "
        f"{1e3 * result.latency_s:.0f} ms after it came"
    )
    return Shown(rgb, {"text": text})


def _play(player: Player, live: LiveIntegrator, console: Console) -> None:
    """Play in a thread, and tell how it goes, until the end or Ctrl-C."""
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
            console.say(_line(live))
    except KeyboardInterrupt:  # how a flight is ended
        console.say("stopped")
    finally:
        stop.set()
        thread.join()
    if fault:
        raise fault[0]


def _line(live: LiveIntegrator) -> str:
    stats, recent = live.stats(), live.recent_latency()
    parts = [f"{stats.integrated} photos, {len(live.window)} in the window"]
    if recent["count"]:
        times = " ".join(f"{recent[f'p{q}_ms']:.0f}" for q in (50, 95, 99))
        parts.append(f"latency p50 p95 p99 {times} ms")
    parts.append(f"dropped {stats.dropped}")
    if stats.without_pose:
        parts.append(f"without pose {stats.without_pose}")
    if stats.detected:
        parts.append(f"looked at {stats.detected}")
    return ", ".join(parts)


def _finish(player: Player, live: LiveIntegrator, out: Path | None, console: Console) -> None:
    """Save the last picture and print the summary."""
    import json

    from hsvaos.live.memory import resident_mb
    from hsvaos.report import figures
    from hsvaos.report.atomic import write_bytes
    from hsvaos.report.draw import draw_boxes

    stats, result = live.stats(), live.latest()
    if live.navigator is not None:
        console.notes(f"nav: {note}" for note in live.navigator.notes)
    if player.faults:
        console.notes([f"{len(player.faults)} photos left out: {player.faults[0]}"])
    saved = None
    if out is not None and result is not None:
        picture = figures.stretch(result.image, result.footprint)
        if result.finds is not None:
            picture = draw_boxes(picture, result.finds.detections)
        saved = str(write_bytes(out, figures.encode(picture, out.suffix.lower())))
    if console.quiet:
        outcome = asdict(stats) | {
            "window": len(live.window),
            "left_out": len(player.faults),
            "behind_s": round(player.behind_s, 3),
            "resident_mb": resident_mb(),
            "out": saved,
        }
        typer.echo(json.dumps(outcome))
        return
    console.show(_summary(live, player))
    if saved is not None:
        console.show(f"look at {saved}")
    if result is None:
        console.notes(["no picture was made"])


def _summary(live: LiveIntegrator, player: Player) -> Any:
    from rich.table import Table

    from hsvaos.live.memory import resident_mb

    stats = live.stats()
    title = (
        f"{stats.arrived} photos came, {stats.integrated} integrated, {stats.dropped} dropped"
        + (f", {stats.without_pose} without pose" if stats.without_pose else "")
    )
    table = Table(title=title, title_justify="left")
    for name in ("", "count", "p50 ms", "p95 ms", "p99 ms", "max ms"):
        table.add_column(name, justify="right" if name else "left")
    rows = {"photo to picture": stats.latency, "of it work": stats.work}
    if stats.detected:
        rows["looking for people"] = stats.detection
    for name, times in rows.items():
        values = [times[key] for key in ("p50_ms", "p95_ms", "p99_ms", "max_ms")]
        table.add_row(name, str(times["count"]), *("" if v is None else f"{v:.1f}" for v in values))
    table.caption = (
        f"photos came up to {1e3 * player.behind_s:.0f} ms late to the queue; memory "
        f"{resident_mb():.0f} MB, {live.window.nbytes / 1e6:.0f} MB of it the window"
    )
    table.caption_justify = "left"
    return table
