"""Options that several commands share, and the settings they make."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer


class Mask(StrEnum):
    """Names of the masks."""

    hue = "hue"
    rarity = "rarity"
    anomaly = "anomaly"
    none = "none"


class DetectorName(StrEnum):
    """Names of the ways to look for people."""

    network = "network"
    rarity = "rarity"
    anomaly = "anomaly"


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
MaskOption = Annotated[Mask | None, typer.Option(help="How pixels are weighed. (default: hue)")]
Sigmas = Annotated[float | None, typer.Option(help="Half width of the hue cut. (default: 2)")]
FocusDown = Annotated[
    float | None, typer.Option(metavar="M", help="Down of a horizontal focal plane.")
]
Terrain = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Focal terrain: GeoTIFF, .obj or .npz.")
]
Autofocus = Annotated[
    bool, typer.Option("--autofocus", help="Search the plane where rare things are sharp.")
]
Relief = Annotated[
    bool | None,
    typer.Option(
        "--relief/--no-relief",
        help="Find how high the ground is about the focal plane. (default: where the network looks "
        "and no --focus-down or --terrain is given)",
    ),
]
Aperture = Annotated[
    float | None, typer.Option(metavar="M", help="Radius of the synthetic aperture.")
]
Scale = Annotated[
    float | None, typer.Option(help="Shrink photos by this factor while decoding. (default: 1)")
]
DetectOption = Annotated[
    DetectorName | None,
    typer.Option(
        "--detect",
        help="Who looks for people: the network, or peaks of rarity or anomaly without weights. "
        "(default: network)",
    ),
]
Score = Annotated[
    float | None,
    typer.Option(metavar="S", help="Score or local z from which a find counts."),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option("--settings", metavar="FILE.toml", help="Settings; options here win over it."),
]
Device = Annotated[str, typer.Option(help="cpu, cuda:0, ...")]
Json = Annotated[bool, typer.Option("--json", help="Print the outcome as JSON, no progress.")]


def settings_of(path: Path | None, **tables: dict[str, Any]) -> Any:
    """Return settings of a file, or the defaults, with the options given on the command line.

    Args:
        path: The file, or None.
        tables: Options by table and key; None where an option was not given. `mask` and `detect`
            may be members of their enumerations.
    """
    from hsvaos.settings import Settings

    settings = Settings() if path is None else Settings.from_file(path)
    focus = tables.get("focus", {})
    if any(value is not None for value in focus.values()):  # one kind of focus replaces another
        focus = {"down_m": None, "terrain": None, "autofocus": False} | {
            name: value for name, value in focus.items() if value is not None
        }
        settings = settings.with_focus(focus)
    plain = {
        name: {k: v.value if isinstance(v, StrEnum) else v for k, v in table.items()}
        for name, table in tables.items()
        if name != "focus"
    }
    return settings.with_values(**plain)


def focus_of(down_m: float | None, terrain: Path | None, autofocus: bool) -> dict[str, Any]:
    """Return the table [focus] of the options that choose the focal surface.

    Args:
        down_m: Down of a focal plane [m].
        terrain: File of a terrain.
        autofocus: Whether to search.
    """
    return {
        "down_m": down_m,
        "terrain": None if terrain is None else str(terrain),
        "autofocus": autofocus or None,
    }
