"""From a flight to persons on the ground: the whole data flow on one screen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

from hsvaos.camera import VirtualCamera
from hsvaos.detect.fragments import FragmentNet, PhotoEvidence
from hsvaos.detect.locate import merge_views
from hsvaos.finding import make_finder
from hsvaos.flight import Flight, FlightError
from hsvaos.focusing import choose_surface, chosen_terrain, without_parallax
from hsvaos.kernels.device import resolve_device
from hsvaos.masking import Masks, as_bytes, make_masks
from hsvaos.photos import Photos, Progress, load_photos, with_poses
from hsvaos.relief.find import find_relief, wants_relief
from hsvaos.rendering import (
    Renderer,
    evidence_integrators,
    look_at_photos,
    make_integrators,
)
from hsvaos.result import Result, ViewResult
from hsvaos.settings import Settings
from hsvaos.surface import FocalPlane, FocalSurface
from hsvaos.viewing import SEVERAL, choose_views, photo_sampling, share_held

_WHOLE = 0.9
"""Share of the ground in views from which on all of it counts as searched."""


def run(
    flight: Flight,
    settings: Settings | None = None,
    *,
    device: Any = "cpu",
    progress: Progress | None = None,
    on_view: Callable[[ViewResult], None] | None = None,
) -> Result:
    """See through the canopy: mask, integrate, detect, locate.

    Args:
        flight: Photos with poses, or with a sensor log from which they are estimated; see
            `hsvaos.open_flight`.
        settings: What to do; the defaults are those of the command line.
        device: "cpu", "cuda:0", ...
        progress: Called with stage, steps done and steps in all.
        on_view: Called with every view as it is rendered; `Result` holds the pictures of one only.

    Returns:
        Pictures of the main view, detections of every view, persons, statistics and notes.

    Raises:
        FlightError: If the flight cannot be used; the message says what was expected and what came.
        ValueError: If a setting or the device makes no sense.
    """
    if not isinstance(flight, Flight):
        raise TypeError(f"flight must be a Flight, see open_flight, got {type(flight).__name__}")
    settings = Settings() if settings is None else settings
    if not isinstance(settings, Settings):
        raise TypeError(f"settings must be Settings, got {type(settings).__name__}")
    where = resolve_device(device)
    clock = _Clock()

    chosen_terrain(flight, settings.focus)  # what contradicts itself is told before any work
    flight = with_poses(flight, progress)
    clock("navigate")
    photos = load_photos(flight, settings.photos.scale, where, progress)
    clock("decode")
    masks = make_masks(photos, settings, progress)
    clock("mask")
    by = make_integrators(photos, masks, settings.mask.method)
    sharp = (by.plain, by.rarity_map)
    surface, focus_notes = choose_surface(photos.flight, settings.focus, sharp, progress)
    for integrator in sharp:  # an autofocus packed them
        integrator.release()
    still = without_parallax(photos.flight, surface)
    if still is not None:
        settings = settings.with_values(detect={"enabled": False})
        focus_notes = (*focus_notes, still)
    clock("focus")
    views, shown = choose_views(photos.flight, settings.view, surface)
    finder = make_finder(settings.detect, len(photos.flight), photos.is_colour)
    search_notes: tuple[str, ...] = ()
    if finder is not None and settings.view.frame not in SEVERAL:
        search_notes = _partly_searched(photos.flight, surface, [view for _, view in views])
    asked = settings.focus.relief is True and still is None
    if asked and not photos.is_colour:
        raise FlightError(
            f"{flight.source}: the relief of the ground is found in RGB photos only, got grey ones"
        )
    if asked or (finder is not None and finder.looks_at_photos):
        evidence = _look(photos, masks, surface, progress)
        by = by.with_evidence(evidence_integrators(photos, evidence, masks.gains))
        clock("look at photos")
        if isinstance(surface, FocalPlane) and wants_relief(settings.focus):
            relief = find_relief(photos, evidence.ground, masks.gains, surface, progress)
            surface, focus_notes = relief[0] or surface, (*focus_notes, relief[1])
            clock("find relief")
    spreads = photos.flight.pose_covariances
    renderer = Renderer(by, settings, surface, finder, pose_covariances=spreads, lean=True)
    renderer = renderer.with_ground_for(photos.flight, [view for _, view in views])
    main, main_finds = renderer.render(*views[shown], extra=True)
    finds, detections = [], []
    for i, (name, view) in enumerate(views):
        rendered, found = (main, main_finds) if i == shown else renderer.render(name, view)
        finds.append(found)
        detections.append((name, rendered.detections))
        if on_view is not None:
            on_view(rendered)
        if progress is not None:
            progress("integrating", i + 1, len(views))
    clock("integrate and detect")
    least = 0.0 if finder is None else finder.least_score
    persons = merge_views(finds, settings.detect.person_m, least, photos.flight.origin)

    frames = photos.flight.frames
    names = [frame.name for frame in frames]
    index = names.index(main.frame) if main.frame in names else photos.flight.centre_index
    weights = masks.chosen(settings.mask.method)
    return Result(
        flight=photos.flight,
        settings=settings,
        surface=surface,
        main=main,
        views=tuple(detections),
        persons=persons,
        photo=photos.images[index].numpy(),
        photo_mask=photos.valid_of(index) if weights is None else as_bytes(weights[index]),
        photo_rarity=as_bytes(masks.rarity[index]),
        photo_frame=names[index],
        mask_stats=masks.stats,
        hue_histogram=masks.hue_histogram,
        notes=(*flight.notes, *photos.notes, *masks.notes, *focus_notes, *search_notes),
        timings_s=clock.seconds,
        mask=settings.mask.method,
        detected=settings.detect.enabled,
    )


def _look(
    photos: Photos, masks: Masks, surface: FocalSurface, progress: Progress | None
) -> PhotoEvidence:
    """Let a network look for pieces of people, and for the ground, in every photo."""
    gsd_m = photo_sampling(photos.flight, surface)
    return look_at_photos(photos, masks, FragmentNet(), gsd_m, progress)


def _partly_searched(
    flight: Flight, surface: FocalSurface, views: Sequence[VirtualCamera]
) -> tuple[str, ...]:
    """Return a note where views hold a part only of the ground that the photos see."""
    share = share_held(flight, surface, views)
    if share is None or share >= _WHOLE:
        return ()
    return (
        f"people are looked for in {100.0 * share:.0f} % of the ground that the photos see, as far "
        f"as this view goes: --view cover searches all of it",
    )


class _Clock:
    """Seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.last = perf_counter()

    def __call__(self, stage: str) -> None:
        now = perf_counter()
        self.seconds[stage] = now - self.last
        self.last = now
