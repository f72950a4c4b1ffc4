"""Views of browsers, pictures on the ground, outlines."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import hsvaos
from hsvaos.nav.attitude import from_matrix
from hsvaos.viewer.geometry import (
    Ground,
    browser_view,
    corners_on,
    fitted,
    outline,
    try_ground,
    vertical_fov,
)
from hsvaos.viewer.request import Focus, Request
from hsvaos.viewer.session import Session


def test_the_browser_at_a_photo_sees_its_view(session: Session) -> None:
    camera, pose = session.flight.camera, session.flight.poses[4]
    seen = browser_view(
        from_matrix(pose[:3, :3]), pose[:3, 3], vertical_fov(camera), (camera.width, camera.height)
    )
    pixels = np.array([[0.0, 0.0], [100.0, 30.0], [127.0, 127.0]])
    mine, theirs = seen.rays(pixels), session.flight.view(4).rays(pixels)
    for a, b in zip(mine, theirs, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-5)


@pytest.mark.parametrize(
    ("wxyz", "place", "fov", "size"),
    [
        ((1, 0, 0, 0), (0, 0, math.nan), 1.0, (10, 10)),
        ((1, 0, 0, 0), (0, 0, 0), math.inf, (10, 10)),
        ((1, 0, 0, 0), (0, 0, 0), 1.0, (0, 10)),
        ((1, 0, 0, 0), (0, 0, 1e30), 1.0, (10, 10)),
        ((0, 0, 0, 0), (0, 0, 0), 1.0, (10, 10)),
    ],
)
def test_absurd_views_are_refused(
    wxyz: tuple[float, ...], place: tuple[float, ...], fov: float, size: tuple[int, int]
) -> None:
    with pytest.raises(ValueError, match=r"finite|within|quaternion|zero|rotation|unit"):
        browser_view(wxyz, place, fov, size)
    wide = browser_view((1, 0, 0, 0), (0, 0, 0), 3.5, (10, 10))
    assert wide.camera is not None
    assert wide.camera.fy > 0.0


def test_pictures_fit_the_screen() -> None:
    assert fitted((1920, 1080), 1280) == (1280, 720)
    assert fitted((300, 200), 1280) == (300, 200)
    assert fitted((3, 5000), 1000) == (2, 1000)


def test_the_ground_picture_lies_in_the_plane(session: Session, request_: Request) -> None:
    ground = Ground(session.flight, 0.0)
    for focus in (Focus(0.0), Focus(-3.0, 20.0, 10.0), Focus(2.0, -40.0, 5.0)):
        surface = session.surface(focus)
        view = ground.view(surface, 200)
        origins, directions = view.rays(np.array([[0.0, 0.0], [199.0, 50.0], [30.0, 150.0]]))
        assert isinstance(surface, hsvaos.FocalPlane)
        np.testing.assert_allclose((origins - surface.point) @ surface.normal, 0.0, atol=1e-6)
        np.testing.assert_allclose(np.abs(directions @ surface.normal), 1.0, atol=1e-9)
        assert max(view.size) == 200
        picture = session.render(Request(view, focus))
        assert picture.note == ""
    # north is up: the same ground from the photo and on the ground
    level = ground.view(session.surface(Focus(0.0)), 300)
    np.testing.assert_allclose(level.world_from_camera[:3, 1], [-1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(level.world_from_camera[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)
    place, target = ground.overview()
    assert place[2] < session.places[:, 2].min()
    assert np.linalg.norm(target - ground.centre) < ground.size_m


def test_outlines_hold_the_corners(session: Session) -> None:
    surface = session.surface(Focus(0.0))
    corners = corners_on(session.flight, 0, surface)
    assert corners is not None
    seen = session.flight.view(0).project(corners)
    width, height = session.flight.camera.width, session.flight.camera.height
    expected = [
        [-0.5, -0.5],
        [width - 0.5, -0.5],
        [width - 0.5, height - 0.5],
        [-0.5, height - 0.5],
    ]
    np.testing.assert_allclose(seen, expected, atol=1e-6)
    hull = outline(session.flight, surface)
    np.testing.assert_allclose(hull[:, 2], 0.0, atol=1e-9)
    assert len(hull) >= 4


def test_photos_of_the_sky_see_no_ground(session: Session) -> None:
    flight = session.flight
    up = flight.poses[0].copy()
    up[:3, 1:3] *= -1.0
    sky = flight.replace(frames=(replace(flight.frames[0], world_from_camera=up),))
    assert try_ground(sky, 0.0) is None
    assert corners_on(sky, 0, session.surface(Focus(0.0))) is None
    assert outline(sky, session.surface(Focus(0.0))).shape == (0, 3)
