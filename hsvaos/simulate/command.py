"""The command `hsvaos simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from hsvaos.simulate.settings import SimulationSettings

_FOREST, _CAMERA, _FLIGHT, _PEOPLE = "Forest", "Camera", "Flight and sensors", "People"


def _span(text: str) -> tuple[float, float]:
    parts = text.split("-")
    try:
        start, stop = (float(p) for p in parts)
    except ValueError:
        raise ValueError(f"an outage must be FROM-TO in seconds, got {text!r}") from None
    return start, stop


def _lens(text: str) -> tuple[float, float, float, float, float]:
    try:
        k1, k2, p1, p2, k3 = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"distortion must be 5 numbers k1,k2,p1,p2,k3, got {text!r}") from None
    return k1, k2, p1, p2, k3


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(part.strip() for part in text.split(",") if part.strip())


def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", help="New folder for the flight.")],
    season: Annotated[
        str, typer.Option(help="summer, fall or snow.", rich_help_panel=_FOREST)
    ] = "summer",
    density: Annotated[
        float, typer.Option(help="Stems a hectare.", rich_help_panel=_FOREST)
    ] = 450.0,
    people: Annotated[int, typer.Option(help="How many people.", rich_help_panel=_PEOPLE)] = 4,
    seed: Annotated[int, typer.Option(help="Of everything.")] = 0,
    closure: Annotated[
        float | None,
        typer.Option(
            help="Find the density that gives this canopy closure (0-1).", rich_help_panel=_FOREST
        ),
    ] = None,
    visible: Annotated[
        float | None,
        typer.Option(
            help="Find the leaf density at which the photos see this share of the ground (0-1).",
            rich_help_panel=_FOREST,
        ),
    ] = None,
    leaf_density: Annotated[
        float, typer.Option(help="Factor on the leaves of a tree.", rich_help_panel=_FOREST)
    ] = 1.0,
    glades: Annotated[
        float, typer.Option(help="Share of the area without trees.", rich_help_panel=_FOREST)
    ] = 0.08,
    relief_m: Annotated[
        float,
        typer.Option(help="Standard deviation of the ground, metres.", rich_help_panel=_FOREST),
    ] = 0.25,
    sun_elevation: Annotated[float, typer.Option(help="Degrees.", rich_help_panel=_FOREST)] = 48.0,
    sun_azimuth: Annotated[
        float, typer.Option(help="Degrees from north.", rich_help_panel=_FOREST)
    ] = 150.0,
    cloud: Annotated[
        float, typer.Option(help="0 clear sky, 1 overcast.", rich_help_panel=_FOREST)
    ] = 0.0,
    detail: Annotated[
        str, typer.Option(help="light or heavy trees.", rich_help_panel=_FOREST)
    ] = "light",
    classes: Annotated[
        str | None,
        typer.Option(
            help="Occlusion classes in turn: full,half,bush,open. Without it they take turns "
            "through what the forest can give.",
            rich_help_panel=_PEOPLE,
        ),
    ] = None,
    clothes: Annotated[
        str | None,
        typer.Option(help="Colours of tops in turn, such as red,olive.", rich_help_panel=_PEOPLE),
    ] = None,
    fresh_poses: Annotated[
        bool,
        typer.Option(
            help="Let new bodies fall (extra sim) instead of using the pose library.",
            rich_help_panel=_PEOPLE,
        ),
    ] = False,
    photos: Annotated[int, typer.Option(help="How many photos.", rich_help_panel=_FLIGHT)] = 117,
    height_m: Annotated[
        float, typer.Option(help="Flight height above ground.", rich_help_panel=_FLIGHT)
    ] = 20.0,
    speed_m_s: Annotated[
        float, typer.Option(help="Metres a second.", rich_help_panel=_FLIGHT)
    ] = 5.0,
    wind_m_s: Annotated[
        float, typer.Option(help="Mean wind in m/s.", rich_help_panel=_FLIGHT)
    ] = 1.8,
    gusts_m_s: Annotated[
        float, typer.Option(help="Gusts, standard deviation in m/s.", rich_help_panel=_FLIGHT)
    ] = 0.8,
    imu: Annotated[
        str, typer.Option(help="Inertial sensor.", rich_help_panel=_FLIGHT)
    ] = "adis16448",
    gnss: Annotated[
        str, typer.Option(help="Receiver: single, sbas or rtk.", rich_help_panel=_FLIGHT)
    ] = "sbas",
    gnss_latency_s: Annotated[
        float, typer.Option(help="Lateness of fixes, seconds.", rich_help_panel=_FLIGHT)
    ] = 0.0,
    gnss_outage: Annotated[
        list[str] | None,
        typer.Option(help="FROM-TO in seconds without fixes; repeatable.", rich_help_panel=_FLIGHT),
    ] = None,
    gnss_outliers: Annotated[
        float, typer.Option(help="Share of fixes that jump 15 m.", rich_help_panel=_FLIGHT)
    ] = 0.0,
    size: Annotated[
        int, typer.Option(help="Width and height of the photos, pixels.", rich_help_panel=_CAMERA)
    ] = 1024,
    fov: Annotated[
        float, typer.Option(help="Field of view, degrees.", rich_help_panel=_CAMERA)
    ] = 90.0,
    distortion: Annotated[
        str, typer.Option(help="k1,k2,p1,p2,k3", rich_help_panel=_CAMERA)
    ] = "0,0,0,0,0",
    thermal: Annotated[
        bool, typer.Option(help="Grey pictures of the temperature.", rich_help_panel=_CAMERA)
    ] = False,
    quality: Annotated[
        int, typer.Option(help="Of the JPEG files; 0 for PNG.", rich_help_panel=_CAMERA)
    ] = 95,
    device: Annotated[str, typer.Option(help="cpu, cuda:0, ...")] = "cpu",
    preview: Annotated[
        bool,
        typer.Option("--preview", help="Only one photo, with the people's outlines: preview.png."),
    ] = False,
) -> None:
    """Simulate a flight over a forest with people in it, with ground truth."""
    from dataclasses import replace

    import numpy as np
    from rich.console import Console

    from hsvaos.camera import Camera
    from hsvaos.kernels.device import quiet_start
    from hsvaos.simulate.forest import ForestSettings
    from hsvaos.simulate.mission import Mission
    from hsvaos.simulate.settings import SensorSettings, SimulationSettings
    from hsvaos.simulate.vehicle import Wind

    lens = _lens(distortion)
    turn = float(np.random.default_rng([max(seed, 0), 97]).uniform(0.0, 2.0 * np.pi))
    wind = Wind((wind_m_s * float(np.cos(turn)), wind_m_s * float(np.sin(turn)), 0.0), gusts_m_s)
    settings = SimulationSettings(
        forest=ForestSettings(
            season=season,
            density=density,
            seed=seed,
            leaf_density=leaf_density,
            glades=glades,
            relief_m=relief_m,
            sun_elevation_deg=sun_elevation,
            sun_azimuth_deg=sun_azimuth,
            cloud=cloud,
            detail=detail,
        ),
        mission=Mission(photos=photos, height_m=height_m, speed_m_s=speed_m_s, wind=wind),
        camera=replace(Camera.from_fov(size, size, fov), distortion=lens),
        sensors=SensorSettings(
            imu=imu,
            gnss=gnss,
            gnss_latency_s=gnss_latency_s,
            gnss_outages_s=tuple(_span(text) for text in gnss_outage or ()),
            gnss_outlier_share=gnss_outliers,
        ),
        people=people,
        classes=_names(classes),
        clothes=_names(clothes),
        fresh_poses=fresh_poses,
        thermal=thermal,
        jpeg_quality=quality,
    )
    quiet_start()
    console = Console(stderr=True)
    settings = _solved(settings, closure, visible, device, console)
    _write(settings, output, device, preview, console)


def _solved(
    settings: SimulationSettings,
    closure: float | None,
    visible: float | None,
    device: str,
    console: Any,
) -> SimulationSettings:
    """Return the settings with density and leaf density solved for what was asked."""
    from dataclasses import replace

    from hsvaos.simulate.solve import solve_closure, solve_visible

    settings = settings.fitted()
    half = max(settings.mission.half_m) + 2.0
    if closure is not None:
        with console.status("finding the density"):
            forest, got = solve_closure(settings.forest, closure, half, device=device)
        console.print(f"density {forest.density:.0f} stems a hectare: closure {got:.3f}")
        settings = replace(settings, forest=forest)
    if visible is not None:
        with console.status("finding the leaf density"):
            forest, got = solve_visible(
                settings.forest,
                visible,
                settings.camera,
                settings.mission.poses(),
                half,
                device=device,
            )
        console.print(f"leaf density {forest.leaf_density:.3f}: {got:.4f} of the ground visible")
        settings = replace(settings, forest=forest)
    return settings


def _write(
    settings: SimulationSettings, output: Path, device: str, only_preview: bool, console: Any
) -> None:
    import cv2
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    from hsvaos.simulate.record import preview, simulate_flight
    from hsvaos.simulate.simulation import Simulation

    if only_preview:
        with console.status("growing the forest"):
            simulation = Simulation(settings, device)
            image = preview(simulation, len(simulation.poses) // 2)
        output.mkdir(parents=True, exist_ok=True)
        path = output / "preview.png"
        done, data = cv2.imencode(".png", image[..., ::-1])
        if not done:
            raise ValueError(f"{path}: cannot be encoded")
        path.write_bytes(data.tobytes())
        console.print(f"{path}")
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("growing the forest", total=settings.mission.photos)

        def told(done: int, total: int) -> None:
            bar.update(task, description="taking photos", completed=done, total=total)

        folder = simulate_flight(settings, output, device=device, progress=told)
    console.print(f"{folder}: {settings.mission.photos} photos, truth.json")
