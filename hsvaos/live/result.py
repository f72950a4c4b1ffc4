"""What a live integrator says: its pictures and its counters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.hue_statistics import HueStatistics
from hsvaos.live.finds import LiveFinds


@dataclass(frozen=True, eq=False)
class LiveResult:
    """An integral image, as of one photo.

    Args:
        image: Shape (H, W, C), float32, in units of the photos; 0 where the footprint is.
        footprint: Shape (H, W), float32, sum of weights.
        number: Number of the newest photo in it, from 0, dropped ones counted.
        t_s: Time of that photo [s]; NaN where none was given.
        latency_s: From the call of `push` to the finished image [s].
        frames: Photos in it.
        view: The virtual camera it was rendered for.
        hue: What was cut from the newest photo; None under another mask than "hue".
        finds: What the detector found last, in this image or an earlier one; None for nothing yet.
    """

    image: NDArray[np.float32]
    footprint: NDArray[np.float32]
    number: int
    t_s: float
    latency_s: float
    frames: int
    view: VirtualCamera
    hue: HueStatistics | None
    finds: LiveFinds | None


@dataclass(frozen=True)
class LiveStats:
    """Counters of a flight.

    Args:
        arrived: Photos that came.
        integrated: Photos that an integral image was made with.
        dropped: Photos that gave way to newer ones while they waited.
        without_pose: Photos that came before the navigator knew where it is.
        detected: Integral images that were looked at.
        detections_skipped: Integral images that were not, because the detector was busy.
        latency: Count, p50_ms, p95_ms, p99_ms and max_ms from `push` to the image.
        work: The same of the work alone, without waiting.
        detection: The same of the detector.
    """

    arrived: int
    integrated: int
    dropped: int
    without_pose: int
    detected: int
    detections_skipped: int
    latency: dict[str, Any]
    work: dict[str, Any]
    detection: dict[str, Any]
