"""A view is looked at with what lies around it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.demo import demo_flight
from hsvaos.detect.detections import Detections
from hsvaos.detect.surroundings import Surroundings, with_surroundings
from hsvaos.finding import Finder, Scores
from hsvaos.flight import FlightError
from hsvaos.masking import make_masks
from hsvaos.photos import load_photos, with_poses
from hsvaos.rendering import Renderer, make_integrators
from hsvaos.settings import Settings
from hsvaos.surface import FocalPlane

EVERY = Scores(0.1, 0.1)

POSE = np.array([[0.0, -1, 0, 3], [1, 0, 0, -2], [0, 0, 1, -20], [0, 0, 0, 1]])


def view(width=60, height=40):
    return VirtualCamera(Camera(width, height, 50.0, 52.0, 28.3, 21.9), POSE)


@given(st.integers(1, 80), st.integers(0, 59), st.integers(0, 39))
def test_the_wider_view_sees_the_same_at_shifted_pixels(margin, x, y):
    around = Surroundings(view(), margin)
    assert around.view.size == (60 + 2 * margin, 40 + 2 * margin)
    _, here = view().rays([x, y])
    _, there = around.view.rays([x + margin, y + margin])
    assert there == pytest.approx(here, abs=1e-12)
    picture = np.zeros((*around.view.size[::-1], 2))
    picture[y + margin, x + margin] = 7.0
    cut = around.cut(picture)
    assert cut.shape == (40, 60, 2)
    assert (cut[y, x] == 7.0).all()
    assert cut.sum() == 14.0


def found(*boxes):
    return Detections(
        np.array(boxes, np.float32).reshape(-1, 4),
        np.linspace(0.9, 0.5, len(boxes), dtype=np.float32),
        np.zeros(len(boxes), np.int64),
    )


def test_finds_are_cut_off_at_the_border_and_those_beyond_dropped():
    around = Surroundings(view(), 10)
    inside = (20.0, 20.0, 30.0, 40.0)
    half = (4.5, 20.0, 14.5, 40.0)  # the view begins at 9.5
    mostly_beyond = (1.0, 20.0, 11.0, 40.0)
    beyond = (70.0, 20.0, 78.0, 40.0)
    kept = around.within(found(inside, half, mostly_beyond, beyond))
    assert kept.boxes_xyxy.tolist() == [[10.0, 10.0, 20.0, 30.0], [-0.5, 10.0, 4.5, 30.0]]
    assert kept.scores == pytest.approx([0.9, 0.9 - 0.4 / 3])
    assert len(around.within(Detections.none())) == 0


@pytest.mark.parametrize(
    ("gsd_m", "reach_m", "margin"),
    [(0.05, 2.0, 30), (0.1, 2.0, 20), (0.3, 2.0, 7), (0.1, 0.0, 0), (np.nan, 2.0, 0), (0, 2.0, 0)],
)
def test_how_wide(gsd_m, reach_m, margin):
    assert with_surroundings(view(), gsd_m, reach_m).margin_px == margin


def test_a_grid_has_no_surroundings():
    grid = VirtualCamera.ortho(0.0, 0.0, 0.1, 30, 20)
    around = with_surroundings(grid, 0.1, 2.0)
    assert around.view is grid
    picture = np.zeros((20, 30))
    assert around.cut(picture).shape == (20, 30)


@pytest.fixture(scope="module")
def demo():
    flight = with_poses(demo_flight())
    photos = load_photos(flight)
    by = make_integrators(photos, make_masks(photos, Settings()), "rarity")
    return photos.flight, by


@pytest.mark.parametrize("once", [False, True], ids=["every view", "ground once"])
def test_a_run_shows_the_network_more_than_the_view_and_reports_what_is_in_it(demo, once):
    flight, by = demo
    shown = []

    def find(layers, gsd_m):
        rays = layers["rarity_map"][1]
        shown.append((rays.shape, gsd_m))
        margin = (rays.shape[0] - flight.camera.height) // 2
        return found((1, 1, 9, 9), (margin - 6.5, 100, margin + 9.5, 110))

    surface = FocalPlane(flight.ground_down_m)
    finder = Finder(("rarity_map",), EVERY, 0.5, find)
    narrow = Renderer(by, Settings(), surface, finder)
    wide = Renderer(by, Settings(), surface, replace(finder, reach_m=2.0))
    if once:
        views = [flight.view(i) for i in range(len(flight))]
        narrow, wide = (one.with_ground_for(flight, views) for one in (narrow, wide))
        assert wide.ground is not None
    at = flight.view(len(flight) // 2)
    gsd_m = (flight.ground_down_m - at.world_from_camera[2, 3]) / at.camera.fx
    a, _ = narrow.render("narrow", at)
    b, finds = wide.render("wide", at)
    width, height = at.size
    margin = (shown[1][0][0] - height) // 2
    assert margin * gsd_m == pytest.approx(2.0, abs=0.1)  # the view is tilted a little
    assert [shape for shape, _ in shown] == [
        (height, width),
        (height + 2 * margin, width + 2 * margin),
    ]
    assert [gsd for _, gsd in shown] == pytest.approx([gsd_m] * 2, rel=0.02)
    for name in ("integral", "footprint", "rarity_map", "rays"):
        ours, theirs = getattr(b, name), getattr(a, name)
        assert ours.shape == theirs.shape
        close = np.isclose(ours, theirs, rtol=1e-3, atol=1e-3)
        assert close.mean() > 0.999, name  # a ray at a photo's last pixel may round either way
    assert b.detections.boxes_xyxy.tolist() == [[-0.5, 100 - margin, 9.5, 110 - margin]]
    assert len(finds.places) == 1
    assert finds.view is at
    middle = at.project(finds.places[0])
    assert middle == pytest.approx([4.5, 105 - margin], abs=0.6)


def test_a_view_of_no_ground_is_said_to_be_one(demo):
    flight, by = demo
    finder = Finder(("rarity_map",), EVERY, 0.5, lambda layers, gsd_m: found(), 2.0)
    above = FocalPlane(float(flight.poses[:, 2, 3].min()) - 10.0)
    with pytest.raises(FlightError, match="no photo sees the focal surface"):
        Renderer(by, Settings(), above, finder).render("up", flight.view(0))
