"""Requests: checked values, and views cut and resized."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hsvaos
from hsvaos.viewer.pace import MOVING_MS, Pace, Quality
from hsvaos.viewer.request import Aperture, Focus, Look, Request, resized, window


def pinhole() -> hsvaos.VirtualCamera:
    pose = np.eye(4)
    pose[:3, 3] = (1.0, 2.0, -20.0)
    return hsvaos.VirtualCamera(hsvaos.Camera(60, 40, 50.0, 51.0, 28.0, 21.0), pose)


@pytest.mark.parametrize(
    "absurd",
    [
        lambda: Focus(down_m=math.nan),
        lambda: Focus(down_m=1e9),
        lambda: Focus(pitch_deg=89.0),
        lambda: Focus(roll_deg=-1e300),
        lambda: Aperture(radius_m=0.0),
        lambda: Aperture(radius_m=-3.0),
        lambda: Aperture(radius_m=math.inf),
        lambda: Aperture(centre=(math.nan, 0.0)),
        lambda: Aperture(first=-1),
        lambda: Aperture(every=0),
        lambda: Look(contrast=0.0),
        lambda: Look(brightness=1e6),
        lambda: Request(pinhole(), layer="x-ray"),
        lambda: Request(resized(pinhole(), 100.0)),
    ],
)
def test_absurd_values_are_refused(absurd: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=r"must be|up to"):
        absurd()


def test_wrong_types_are_refused() -> None:
    with pytest.raises(TypeError, match=r"focus\.down_m must be a number, got 'deep'"):
        Focus(down_m="deep")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"aperture\.every must be a whole number"):
        Aperture(every=1.5)  # type: ignore[arg-type]


@given(
    radius=st.none() | st.floats(0.1, 30.0),
    first=st.integers(0, 12),
    last=st.none() | st.integers(0, 12),
    every=st.integers(1, 5),
)
def test_aperture_chooses_photos(
    radius: float | None, first: int, last: int | None, every: int
) -> None:
    places = np.random.default_rng(1).uniform(-20, 20, (10, 2))
    chosen = Aperture(radius, None, first, last, every).frames(places, np.array([3.0, -2.0]))
    expected = [
        i
        for i in range(10)
        if i >= first
        and (last is None or i <= last)
        and (i - first) % every == 0
        and (radius is None or math.hypot(places[i, 0] - 3.0, places[i, 1] + 2.0) <= radius)
    ]
    assert chosen == expected


@pytest.mark.parametrize(
    "view", [pinhole(), hsvaos.VirtualCamera.ortho(3.0, -2.0, 0.1, 60, 40)], ids=["pinhole", "grid"]
)
def test_a_window_has_the_rays_of_its_pixels(view: hsvaos.VirtualCamera) -> None:
    part = window(view, 7, 11, 20, 15)
    pixels = np.array([[0.0, 0.0], [19.0, 3.0], [4.5, 14.0]])
    for mine, whole in zip(part.rays(pixels), view.rays(pixels + np.array([7, 11])), strict=True):
        np.testing.assert_allclose(mine, whole, atol=1e-9)


@pytest.mark.parametrize(
    "view", [pinhole(), hsvaos.VirtualCamera.ortho(3.0, -2.0, 0.1, 60, 40)], ids=["pinhole", "grid"]
)
def test_a_smaller_view_shows_the_same(view: hsvaos.VirtualCamera) -> None:
    half = resized(view, 0.5)
    assert half.size == (30, 20)
    for mine, whole in zip(
        half.rays(np.array([10.0, 8.0])), view.rays(np.array([20.5, 16.5])), strict=True
    ):
        np.testing.assert_allclose(mine, whole, atol=1e-9)


@given(
    ns=st.floats(0.5, 100.0),
    pixels=st.integers(10_000, 2_000_000),
    frames=st.integers(1, 200),
)
def test_moving_pictures_keep_their_time(ns: float, pixels: int, frames: int) -> None:
    pace = Pace()
    for _ in range(60):
        pace.measured(10_000_000, 10.0 * ns)
    assert pace.ns_a_ray == pytest.approx(ns, rel=0.01)
    quality = pace.quality(pixels, frames)
    rays = pixels * quality.scale**2 * frames / quality.every
    coarsest = quality.scale <= 0.2 and quality.every >= frames // 12
    assert coarsest or pace.expected_ms(int(rays)) <= 1.4 * MOVING_MS
    if pace.expected_ms(pixels * frames) <= MOVING_MS:
        assert quality == Quality()


def test_a_hold_up_does_not_spoil_the_pace() -> None:
    pace = Pace()
    before = pace.ns_a_ray
    pace.measured(1_000_000, 60_000.0)
    assert pace.ns_a_ray <= 2.0 * before
