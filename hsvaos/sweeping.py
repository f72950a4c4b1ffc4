"""A focal sweep of a flight: the masked integral image at many depths, and how sharp each is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.flight import Flight, FlightError
from hsvaos.focusing import clearest_focus
from hsvaos.kernels.device import resolve_device
from hsvaos.kernels.sweep import MEASURES, focus_measure
from hsvaos.masking import make_masks
from hsvaos.photos import Progress, load_photos, with_poses
from hsvaos.rendering import make_integrators
from hsvaos.settings import Settings
from hsvaos.viewing import SEVERAL, sized_view

_PLANES_AT_ONCE = 8

RARITY_CURVE = "rarity_kurtosis"


@dataclass(frozen=True, eq=False)
class FocalSweep:
    """A focal stack and what its planes measure.

    Args:
        downs_m: Shape (D,), depths of the planes [m].
        images: Shape (D, H, W, C), float32, integral images.
        footprints: Shape (D, H, W), float32.
        curves: Shape (D,) each, by name: focus measures of the plain integral, and the kurtosis of
            the rarity map.
        focus_m: Depth of the most prominent peak of either kurtosis [m].
        prominence: How far that peak rises above its valleys (0: there is no inner peak).
        frame: Whose pose the view has.
        notes: What the user should know.
    """

    downs_m: NDArray[np.float64]
    images: NDArray[np.float32]
    footprints: NDArray[np.float32]
    curves: dict[str, NDArray[np.float64]]
    focus_m: float
    prominence: float
    frame: str
    notes: tuple[str, ...]

    def summary(self) -> str:
        """Return one line about the focus."""
        if self.prominence == 0.0:
            return "No plane stands out: the focus curve has no inner peak"
        return (
            f"Sharpest small things at down = {self.focus_m:.2f} m "
            f"(peak {100 * self.prominence:.0f} % above its valleys)"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return depths, curves and focus for JSON."""
        return {
            "frame": self.frame,
            "downs_m": self.downs_m.tolist(),
            "curves": {name: curve.tolist() for name, curve in self.curves.items()},
            "focus_m": self.focus_m,
            "prominence": self.prominence,
            "notes": list(self.notes),
        }


def sweep_flight(
    flight: Flight,
    first_m: float,
    last_m: float,
    steps: int,
    settings: Settings | None = None,
    *,
    size_px: int = 1024,
    device: Any = "cpu",
    progress: Progress | None = None,
) -> FocalSweep:
    """Render a flight's masked integral image on horizontal planes between two depths.

    Args:
        flight: Photos with poses.
        first_m: Down of the first plane [m].
        last_m: Down of the last plane [m].
        steps: Number of planes, at least 2.
        settings: Mask, view and photos as for `run`.
        size_px: Longest side of the pictures, at most that of the photos.
        device: "cpu", "cuda:0", ...
        progress: Called with stage, steps done and steps in all.

    Raises:
        FlightError: If the flight cannot be used or no plane is seen.
        ValueError: If the range makes no sense.
    """
    if not (np.isfinite([first_m, last_m]).all() and first_m < last_m) or steps < 2:
        raise ValueError(
            f"a sweep runs downwards over at least 2 planes: expected --from below --to, got "
            f"{first_m!r} to {last_m!r} in {steps}"
        )
    settings = settings or Settings()
    flight = with_poses(flight, progress)
    photos = load_photos(flight, settings.photos.scale, resolve_device(device), progress)
    masks = make_masks(photos, settings, progress)
    by = make_integrators(photos, masks, settings.mask.method)
    name, view = _view(photos.flight, settings.view.frame, size_px)
    downs = np.linspace(first_m, last_m, steps)
    pictures: list[Any] = []
    footprints: list[Any] = []
    curves: dict[str, list[Any]] = {name: [] for name in (*MEASURES, RARITY_CURVE)}
    for start in range(0, steps, _PLANES_AT_ONCE):
        part = downs[start : start + _PLANES_AT_ONCE]
        curves[RARITY_CURVE].append(focus_measure(*by.rarity_map.sweep(view, part)))
        stack, cover = by.plain.sweep(view, part)
        for measure in MEASURES:
            curves[measure].append(focus_measure(stack, cover, measure))
        if by.chosen is not by.plain:
            stack, cover = by.chosen.sweep(view, part)
        pictures.append(stack.numpy())
        footprints.append(cover.numpy())
        if progress is not None:
            progress("sweeping", min(start + _PLANES_AT_ONCE, steps), steps)
    footprint = np.concatenate(footprints)
    if not footprint.any():
        raise FlightError(
            f"no photo sees a plane between down = {first_m:.2f} m and {last_m:.2f} m from view "
            f"{name}: expected depths below the cameras"
        )
    joined = {measure: np.concatenate(parts) for measure, parts in curves.items()}
    focus, prominence = clearest_focus(downs, [joined["kurtosis"], joined[RARITY_CURVE]])
    notes = (*flight.notes, *photos.notes, *masks.notes)
    return FocalSweep(
        downs, np.concatenate(pictures), footprint, joined, focus, prominence, name, notes
    )


def _view(flight: Flight, frame: str, size_px: int) -> tuple[str, VirtualCamera]:
    if frame in (*SEVERAL, "ortho"):
        raise ValueError(f"a sweep needs the view of one frame, got {frame!r}")
    index = flight.centre_index if frame in ("centre", "center") else flight.index(frame)
    return flight.frames[index].name, sized_view(flight, index, size_px)
