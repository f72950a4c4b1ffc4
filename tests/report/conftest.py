"""A small synthetic run: five photos in a row, a red square on the ground, a corner never seen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.flight import Flight, Frame, Origin
from hsvaos.result import Result, ViewResult
from hsvaos.surface import FocalPlane

ORIGIN = Origin(47.5, 13.25, 600.0)
MakeResult = Callable[..., Result]


class StubSettings:
    def to_toml(self) -> str:
        return '[mask]\nmethod = "hue"  # <b>\n'


def looking_down(north: float, east: float, down: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    pose[:3, 3] = [north, east, down]
    return pose


def make_flight(origin: Origin | None, name: str = "trial") -> Flight:
    camera = Camera.from_fov(96, 64, 70.0)
    frames = tuple(
        Frame(f"p{i}.png", Path(f"p{i}.png"), looking_down(0.0, 2.0 * i - 4.0, -20.0))
        for i in range(5)
    )
    return Flight(name, camera, frames, origin=origin)


def make_result(
    *,
    origin: Origin | None = ORIGIN,
    ortho: bool = False,
    channels: int = 3,
    persons: bool = True,
    rarity: bool = True,
    mask: str = "hue",
    name: str = "trial",
    notes: tuple[str, ...] = (),
    stats: dict[str, Any] | None = None,
) -> Result:
    rng = np.random.default_rng(5)
    flight = make_flight(origin, name)
    view = VirtualCamera.ortho(10.0, -10.0, 0.25, 80, 60) if ortho else flight.view(2)
    height, width = view.height, view.width
    image = rng.uniform(60, 90, (height, width, channels)).astype(np.float32)
    image[20:26, 30:34, 0] = 220.0
    footprint = rng.uniform(0.5, 5.0, (height, width)).astype(np.float32)
    footprint[:15, :20] = 0.0
    image[footprint == 0] = 0.0
    map_ = rng.uniform(0, 0.1, (height, width)).astype(np.float32) if rarity else None
    boxes = np.array([[29.5, 19.5, 33.5, 25.5]], np.float32)
    found = (
        Detections(boxes, np.array([8.25], np.float32), np.zeros(1, np.int64))
        if persons
        else Detections.none()
    )
    extra = {"plain": (image * 0.5, footprint), "rarity": (image, footprint)} if rarity else {}
    if rarity and channels == 3:
        extra["ground"] = (image * 0.7, footprint * 0.4)
    place = (47.50001, 13.24999) if origin else (None, None)
    person = Person(1.5, -0.5, 0.0, *place, 0.4, 8.25, 3)
    photo = rng.integers(40, 90, (64, 96, 3)[: 3 if channels == 3 else 2], dtype=np.uint8)
    kept = np.where(rng.random((64, 96)) < 0.3, 255, 0).astype(np.uint8)
    return Result(
        flight=flight,
        settings=StubSettings(),
        surface=FocalPlane(0.0),
        main=ViewResult(
            "ortho" if ortho else "p2.png",
            view,
            image,
            footprint,
            map_,
            None,
            found,
            extra,
            None if map_ is None else 0.1 * map_,
        ),
        views=(("p2.png", found),),
        persons=(person,) if persons else (),
        photo=photo,
        photo_mask=kept,
        photo_rarity=kept if rarity else None,
        photo_frame="p2.png",
        mask_stats=stats
        if stats is not None
        else {
            "hue_mean_deg": 20.0,
            "hue_sigma_deg": 15.0,
            "sigmas": 2.0,
            "kept_share": 0.3,
            "hue_informative": True,
        },
        hue_histogram=rng.random(72),
        notes=notes,
        timings_s={"integrate": 1.5},
        mask=mask,
    )


@pytest.fixture
def result_of() -> MakeResult:
    return make_result
