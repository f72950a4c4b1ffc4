"""The command `hsvaos view`: a flight in the browser."""

from __future__ import annotations

from typing import Annotated

import typer

from hsvaos.cli_options import (
    DetectOption,
    Device,
    FlightPath,
    Format,
    Fov,
    FrameMask,
    GroundDown,
    MaskOption,
    Poses,
    Scale,
    SettingsFile,
    Terrain,
    focus_of,
    settings_of,
)

LOCAL = "127.0.0.1"


def view(
    flight: FlightPath,
    fov: Fov = None,
    poses: Poses = None,
    format: Format = None,
    ground_down: GroundDown = None,
    frame_mask: FrameMask = None,
    mask: MaskOption = None,
    terrain: Terrain = None,
    detect: DetectOption = None,
    scale: Scale = None,
    settings: SettingsFile = None,
    device: Device = "cpu",
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
    from hsvaos.viewer.app import App
    from hsvaos.viewer.plain import PlainApp
    from hsvaos.viewer.session import Session

    chosen = settings_of(
        settings,
        focus=focus_of(None, terrain, False),
        mask={"method": mask},
        photos={"scale": scale},
        detect={"method": detect},
    )
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
