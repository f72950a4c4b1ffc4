"""The command `hsvaos view`: a flight in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

LOCAL = "127.0.0.1"


def view(
    flight: Annotated[Path, typer.Argument(metavar="FLIGHT", help="Folder of a flight.")],
    fov: Annotated[
        float | None, typer.Option("--fov", metavar="DEG", help="Horizontal field of view.")
    ] = None,
    poses: Annotated[
        Path | None, typer.Option(metavar="FILE", help="poses.csv or poses.json to use instead.")
    ] = None,
    format: Annotated[
        str | None, typer.Option(help="native, jku, dji or photos; guessed if absent.")
    ] = None,
    ground_down: Annotated[
        float | None, typer.Option(metavar="M", help="Down of the ground, to start from.")
    ] = None,
    frame_mask: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Image of valid pixels; black is ignored.")
    ] = None,
    terrain: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Focal terrain: GeoTIFF, .obj or .npz.")
    ] = None,
    scale: Annotated[
        float | None, typer.Option(help="Shrink photos by this factor while decoding. [default: 1]")
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option("--settings", metavar="FILE.toml", help="Settings to start from."),
    ] = None,
    device: Annotated[str, typer.Option(help="cpu, cuda:0, ...")] = "cpu",
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 lets others in.")
    ] = LOCAL,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port; the next free one if it is taken.")
    ] = 8080,
    plain: Annotated[
        bool, typer.Option("--plain", help="A plain page with a picture, for want of WebGL.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--open", help="Open it in this machine's browser.")
    ] = False,
) -> None:
    """Look through the canopy in a browser: drag the focal surface through the forest."""
    import threading
    import webbrowser

    from hsvaos.console import Console
    from hsvaos.formats.open import open_flight
    from hsvaos.settings import Settings
    from hsvaos.viewer.app import App
    from hsvaos.viewer.plain import PlainApp
    from hsvaos.viewer.session import Session

    chosen = Settings() if settings is None else Settings.from_file(settings)
    chosen = chosen.with_values(photos={"scale": scale})
    if terrain is not None:
        chosen = chosen.with_focus({"terrain": str(terrain), "down_m": None, "autofocus": False})
    console = Console()
    opened = open_flight(flight, None, poses, format, fov, ground_down, frame_mask)
    with console.progress() as progress:
        session = Session.open(opened, chosen, device, progress)
    app = PlainApp(session, host, port) if plain else App(session, host, port)
    try:
        console.notes(session.notes)
        if port not in (0, app.port):
            typer.echo(f"port {port} is taken: using {app.port}")
        if host != LOCAL:
            typer.echo(f"everybody who reaches {host}:{app.port} can look at this flight")
        typer.echo(f"look at {app.url} (Ctrl-C ends)")
        if show:
            webbrowser.open(app.url)
        threading.Event().wait()
    except KeyboardInterrupt:  # how a server is ended
        typer.echo("stopped")
    finally:
        app.close()
