"""What a run of the pipeline hands on to reports and users."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.flight import Flight
from hsvaos.surface import FocalSurface

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ViewResult:
    """Everything computed for one virtual camera.

    Images are in units of the photos (0..255 for uint8), RGB or grey, 0 where the footprint is 0.

    Args:
        frame: Name of the frame whose pose the view has, or "ortho".
        view: The virtual camera.
        integral: Shape (H, W, C), float32, the integral image of the chosen mask.
        footprint: Shape (H, W), float32, its sum of weights.
        rarity_map: Shape (H, W), float32, mean rarity weight over the rays, 0..1; or None.
        rays: Shape (H, W), float32, number of valid rays a pixel, without the colour mask; or None.
        detections: What was found in this view.
        extra: Further integral images by name ("plain", "hue", "rarity", "anomaly", "ground") with
            their footprints, for the main view only.
        fragment_map: Shape (H, W), float32, mean evidence of pieces of people over the rays, 0..1,
            see `hsvaos.detect.fragments`; None where the photos were not looked into.
    """

    frame: str
    view: VirtualCamera
    integral: Image
    footprint: Image
    rarity_map: Image | None
    rays: Image | None
    detections: Detections
    extra: dict[str, tuple[Image, Image]] = field(default_factory=dict)
    fragment_map: Image | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """The outcome of `hsvaos.run`.

    Args:
        flight: The flight that was integrated (without the frames that were skipped).
        settings: The settings as used, with every default written out.
        surface: The focal surface that was used.
        main: The view that the pictures show.
        views: Frame name and detections of every view, the main one among them.
        persons: The finds on the ground, strongest first.
        photo: Shape (H, W, C) or (H, W), the photo of the centre frame as decoded.
        photo_mask: Shape (H, W), uint8, its weight in the chosen mask (255 = full weight).
        photo_rarity: Shape (H, W), uint8, its rarity weight (255 = 1); or None.
        photo_frame: Name of that frame.
        mask_stats: What the mask measured; reports read "hue_mean_deg", "hue_sigma_deg", "sigmas",
            "kept_share" (0..1) and "hue_informative" (bool) where they are there.
        hue_histogram: Shape (B,), float64, weighted hue histogram over the flight; or None.
        notes: What the user should know: frames skipped, defaults assumed, hue that said nothing.
        timings_s: Seconds by stage.
        mask: Name of the mask of the main integral image: "hue", "rarity", "anomaly" or "none".
        detected: Whether finds were looked for at all.
    """

    flight: Flight
    settings: Any
    surface: FocalSurface
    main: ViewResult
    views: tuple[tuple[str, Detections], ...]
    persons: tuple[Person, ...]
    photo: NDArray[Any]
    photo_mask: NDArray[np.uint8]
    photo_rarity: NDArray[np.uint8] | None
    photo_frame: str
    mask_stats: dict[str, Any]
    hue_histogram: NDArray[np.float64] | None
    notes: tuple[str, ...]
    timings_s: dict[str, float]
    mask: str = "none"
    detected: bool = True
