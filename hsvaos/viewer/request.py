"""What a picture is asked to show: plain values without any user interface, all checked."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera, VirtualCamera, finite_number
from hsvaos.settings import MOST_TILT_DEG, MaskSettings

LAYERS = ("masked", "plain", "ground", "photo", "footprint", "rarity", "compare")
"""Integral image with the chosen mask; without one; of what a network takes for ground, in colour
photos once all were looked into, and without a mask till then; the nearest photo alone, on the same
surface; sum of weights; mean rarity of the rays; and photo, plain and masked side by side."""

MOST_PX = 4096
"""Longest side of a picture: more than any screen, little enough for any memory."""

FARTHEST_FOCUS_M = 20_000.0
"""Depth beyond which a focal surface is a slip of the hand."""


@dataclass(frozen=True)
class Focus:
    """Where the focal surface lies.

    Args:
        down_m: Down of the plane below the middle of the cameras [m]; for a terrain its shift
            downwards.
        pitch_deg: Tilt of the plane, rising towards the north [deg].
        roll_deg: Tilt of the plane, falling towards the east [deg].
        terrain: Whether the session's terrain is the surface.
    """

    down_m: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    terrain: bool = False

    def __post_init__(self) -> None:
        _check_numbers(self, "focus")
        _bounded("focus.down_m", self.down_m, -FARTHEST_FOCUS_M, FARTHEST_FOCUS_M)
        for name in ("pitch_deg", "roll_deg"):
            _bounded(f"focus.{name}", getattr(self, name), -MOST_TILT_DEG, MOST_TILT_DEG)


@dataclass(frozen=True)
class Aperture:
    """Which photos count.

    Args:
        radius_m: Horizontal distance of a photo from the centre up to which it counts [m]; None
            for all.
        centre: North and east of the centre [m]; None for below the virtual camera.
        first: Number of the first photo.
        last: Number of the last photo; None for the last there is.
        every: Only every so-manieth of them counts.
    """

    radius_m: float | None = None
    centre: tuple[float, float] | None = None
    first: int = 0
    last: int | None = None
    every: int = 1

    def __post_init__(self) -> None:
        if self.radius_m is not None:
            _bounded("aperture.radius_m", self.radius_m, 0.0, math.inf, "more than")
        if self.centre is not None:
            for value in self.centre:
                finite_number(value, "aperture.centre")
        for name, least in (("first", 0), ("last", 0), ("every", 1)):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
                raise TypeError(f"aperture.{name} must be a whole number, got {value!r}")
            if value is not None and value < least:
                raise ValueError(f"aperture.{name} must be at least {least}, got {value!r}")

    def frames(self, places: NDArray[np.float64], centre: NDArray[np.float64]) -> list[int]:
        """Return the numbers of the photos that count.

        Args:
            places: Shape (N, 2), north and east of the photos [m].
            centre: Shape (2,), north and east of the virtual camera [m].
        """
        last = len(places) - 1 if self.last is None else min(self.last, len(places) - 1)
        chosen = range(self.first, last + 1, self.every)
        if self.radius_m is None:
            return list(chosen)
        middle = centre if self.centre is None else np.asarray(self.centre)
        away = np.linalg.norm(places - middle, axis=1)
        return [i for i in chosen if away[i] <= self.radius_m]


@dataclass(frozen=True)
class Look:
    """How numbers become colours.

    Args:
        contrast: Factor on the automatic stretch, 0.1 to 10.
        brightness: Factor on the exponent's inverse: above 1 the dark parts are lifted, 0.1 to 10.
    """

    contrast: float = 1.0
    brightness: float = 1.0

    def __post_init__(self) -> None:
        _check_numbers(self, "look")
        for entry in fields(self):
            _bounded(f"look.{entry.name}", getattr(self, entry.name), 0.1, 10.0)


@dataclass(frozen=True, eq=False)
class Request:
    """One picture that somebody wants to see.

    Args:
        view: The virtual camera.
        focus: The focal surface.
        aperture: The photos that count.
        mask: How pixels are weighed.
        look: Contrast.
        layer: One of `LAYERS`.
        moving: Whether something is being dragged: then soon is better than sharp.
    """

    view: VirtualCamera
    focus: Focus = field(default_factory=Focus)
    aperture: Aperture = field(default_factory=Aperture)
    mask: MaskSettings = field(default_factory=MaskSettings)
    look: Look = field(default_factory=Look)
    layer: str = "masked"
    moving: bool = False

    def __post_init__(self) -> None:
        if self.layer not in LAYERS:
            raise ValueError(f"layer must be one of {', '.join(LAYERS)}, got {self.layer!r}")
        if max(self.view.size) > MOST_PX:
            raise ValueError(
                f"a picture may have up to {MOST_PX} px a side, got {self.view.width} x "
                f"{self.view.height}"
            )


def resized(view: VirtualCamera, scale: float) -> VirtualCamera:
    """Return the same view with fewer pixels.

    Args:
        view: The virtual camera.
        scale: Factor on its sides.
    """
    if scale == 1.0:
        return view
    width, height = (max(1, round(side * scale)) for side in view.size)
    if view.camera is not None:
        return VirtualCamera(view.camera.scaled(width, height), view.world_from_camera)
    # a ground grid keeps its first pixel's corner and covers at least the same ground
    gsd = view.gsd_m * max(view.width / width, view.height / height)
    shift = 0.5 * (gsd - view.gsd_m)
    pose = view.world_from_camera.copy()
    pose[:3, 3] += pose[:3, :2] @ np.array([shift, shift])
    return VirtualCamera(None, pose, gsd, (width, height))


def window(view: VirtualCamera, left: int, top: int, width: int, height: int) -> VirtualCamera:
    """Return the part of a view that holds some of its pixels; it may reach beyond the view.

    Args:
        view: The virtual camera.
        left: First column.
        top: First row.
        width: Columns.
        height: Rows.
    """
    if view.camera is not None:
        c = view.camera
        part = Camera(width, height, c.fx, c.fy, c.cx - left, c.cy - top, c.distortion)
        return VirtualCamera(part, view.world_from_camera)
    pose = view.world_from_camera.copy()
    pose[:3, 3] += pose[:3, :2] @ np.array([left, top]) * view.gsd_m
    return VirtualCamera(None, pose, view.gsd_m, (width, height))


def _check_numbers(values: Any, table: str) -> None:
    for entry in fields(values):
        value = getattr(values, entry.name)
        if not isinstance(value, bool):
            number = finite_number(value, f"{table}.{entry.name}")
            object.__setattr__(values, entry.name, number)


def _bounded(name: str, value: Any, least: float, most: float, word: str = "at least") -> None:
    number = finite_number(value, name)
    if not (least <= number <= most) or (word == "more than" and number == least):
        upper = "" if math.isinf(most) else f" and at most {most:g}"
        raise ValueError(f"{name} must be {word} {least:g}{upper}, got {value!r}")
