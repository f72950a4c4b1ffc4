"""From a flight and what was asked for to a live integrator."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hsvaos.detect.yolo import Detector
from hsvaos.flight import Flight, FlightError
from hsvaos.focusing import choose_surface
from hsvaos.formats.images import decode_photo
from hsvaos.formats.sensor_log import sensor_log_of
from hsvaos.live.integrator import LiveIntegrator
from hsvaos.live.play import Sensors, valid_pixels
from hsvaos.nav.checks import check_log
from hsvaos.nav.online import OnlineFilter
from hsvaos.settings import Settings
from hsvaos.surface import FocalPlane, FocalSurface
from hsvaos.viewing import sized_view


@dataclass(frozen=True)
class Options:
    """What was asked for.

    Args:
        window: Photos of the window.
        size: Longest side of the picture [px].
        moving: Whether the view follows the photos.
        detect_every: Pictures from one that is looked at to the next; 0 for none.
        search: Whether the photos of the window are searched instead, with all that a run looks at.
        from_log: Whether poses come from the sensor log even where there are some.
    """

    window: int
    size: int
    moving: bool
    detect_every: int
    search: bool
    from_log: bool


def integrator_for(
    flight: Flight,
    settings: Settings,
    asked: Options,
    any_mask: bool,
    device: str,
) -> tuple[LiveIntegrator, Sensors | None, Flight, tuple[str, ...]]:
    """Return the integrator, the log that feeds it, the flight with times of photos, and notes.

    Args:
        flight: The flight.
        settings: Mask, focus, scale of the photos, and the network.
        asked: The rest.
        any_mask: Whether the mask was left to us: grey photos then have none.
        device: "cpu", "cuda:0", ...

    Raises:
        FlightError: If the flight cannot be played like that.
        ValueError: If an option makes no sense.
    """
    notes: tuple[str, ...] = ()
    navigator = sensors = None
    if asked.from_log or not flight.has_poses:
        log = check_log(sensor_log_of(flight))
        navigator = OnlineFilter(mounting=log.mounting, origin=log.origin)
        sensors = Sensors(log, navigator)
        times = dict(log.triggers)
        frames = [replace(f, t_s=times.get(f.name, f.t_s)) for f in flight.frames]
        timed = tuple(frame for frame in frames if np.isfinite(frame.t_s))
        if not timed:
            raise FlightError(
                f"{flight.source}: expected times of the photos (triggers), to place them by the "
                f"sensor log, got none"
            )
        flight = flight.replace(frames=timed)
        if not asked.moving:
            raise FlightError("--view fixed needs a flight with poses: leave --log-poses away")
    first = decode_photo(flight.frames[0].path).image
    method = settings.mask
    if first.ndim == 2 and any_mask and method.method == "hue":
        method = replace(method, method="none")
        notes = ("the photos are grey: hue says nothing, the mask keeps everything",)
    camera = flight.camera
    scale = settings.photos.scale
    camera = camera.scaled(*(max(1, round(n * scale)) for n in (camera.width, camera.height)))
    detector = None
    if asked.detect_every and not asked.search:
        detect = settings.detect
        detector = Detector(detect.model, detect.layout, score=detect.min_score, threads=1)
    integrator = LiveIntegrator(
        camera,
        surface_of(flight, settings),
        frames=asked.window,
        size=asked.size,
        view=None if asked.moving else sized_view(flight, flight.centre_index, asked.size),
        mask=method,
        valid=valid_pixels(flight, scale),
        channels=3 if first.ndim == 3 else 1,
        dtype=first.dtype.name,
        navigator=navigator,
        detector=detector,
        search=settings if asked.search else None,
        detect_every=max(1, asked.detect_every),
        device=device,
    )
    return integrator, sensors, flight, notes


def surface_of(flight: Flight, settings: Settings) -> FocalSurface:
    """Return the focal surface that the settings ask for, or the flight's ground.

    Raises:
        FlightError: If neither says where it lies.
    """
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
