"""Views drawn from the integrated ground are those that integrating every view gives."""

import numpy as np
import pytest

import hsvaos
from hsvaos.demo import demo_flight
from hsvaos.detect.anomaly import find_persons
from hsvaos.finding import Finder, Scores
from hsvaos.ground_map import grid_for
from hsvaos.kernels.rays import focal_points
from hsvaos.masking import make_masks
from hsvaos.photos import load_photos, with_poses
from hsvaos.rendering import Renderer, make_integrators
from hsvaos.settings import Settings, ViewSettings
from hsvaos.surface import FocalPlane, FocalTerrain


@pytest.fixture(scope="module")
def demo():
    flight = with_poses(demo_flight())
    photos = load_photos(flight)
    settings = Settings()
    masks = make_masks(photos, settings)
    return photos.flight, make_integrators(photos, masks, "rarity"), settings


def sloping(flight):
    axis = np.linspace(-80.0, 80.0, 41)
    north, east = np.meshgrid(axis, axis, indexing="ij")
    return FocalTerrain.from_arrays(axis, axis, flight.ground_down_m + 0.02 * north - 0.01 * east)


@pytest.mark.parametrize("kind", ["plane", "terrain"])
def test_views_from_the_ground_are_those_of_the_photos(demo, kind):
    flight, by, settings = demo
    surface = FocalPlane(flight.ground_down_m) if kind == "plane" else sloping(flight)
    views = [flight.view(i) for i in range(len(flight))]
    direct = Renderer(by, settings, surface)
    drawn = direct.with_ground_for(flight, views)
    assert drawn.ground is not None
    for i in (0, len(views) // 2):
        a, _ = direct.render("direct", views[i])
        b, _ = drawn.render("drawn", views[i])
        hits = focal_points(views[i], surface, device="cpu").numpy()
        assert np.isfinite(hits).all()
        both = (a.rays > 3) & (b.rays > 3)
        assert both.sum() > 0.99 * (a.rays > 3).sum()
        assert np.abs(a.rays - b.rays)[both].mean() < 0.2
        contrast = a.integral[both].std(axis=0).mean()
        # two resamplings blur single rays of noise; what is wider than a pixel stays
        assert np.abs(a.integral - b.integral)[both].mean() < 0.25 * contrast
        assert np.corrcoef(a.integral[both].ravel(), b.integral[both].ravel())[0, 1] > 0.97
        assert abs(np.median((a.rarity_map - b.rarity_map)[both])) < 2e-3


def test_what_counts_for_persons_only_is_no_box_of_its_view(demo):
    flight, by, settings = demo
    surface = FocalPlane(flight.ground_down_m)
    low = settings.with_values(detect={"min_z": 2.0}).detect

    def find(layers, gsd_m):
        values, rays = layers["rarity_map"]
        return find_persons(values[..., 0], rays, gsd_m, low)

    def rendered(scores):
        finder = Finder(("rarity_map",), scores, 0.5, find)
        return Renderer(by, settings, surface, finder).render("one", flight.view(3))

    view, finds = rendered(Scores(6.0, 3.0))
    assert 0 < len(view.detections) < len(finds.found)
    assert view.detections.scores.min() >= 6.0
    assert 3.0 <= finds.found.scores.min() < 6.0
    assert len(finds.places) == len(finds.covariances) == len(finds.found)
    sure = finds.above(6.0)
    np.testing.assert_array_equal(sure.found.boxes_xyxy, view.detections.boxes_xyxy)
    again, stricter = rendered(Scores(3.0, 6.0))  # the other way round
    np.testing.assert_array_equal(stricter.places, sure.places)
    assert len(again.detections) == len(finds.found)


def test_no_ground_where_it_cannot_stand_for_the_views(demo):
    flight, _, _ = demo
    surface = FocalPlane(flight.ground_down_m)
    views = [flight.view(i) for i in range(len(flight))]
    assert grid_for(flight, views, surface, ViewSettings()) is not None
    assert grid_for(flight, views[:2], surface, ViewSettings()) is None


@pytest.mark.parametrize(
    ("free", "count", "lean"),
    [(10**12, 1, True), (10**12, 2, False), (10**6, 2, True), (None, 2, False), (None, 30, True)],
    ids=["one view", "several", "short of memory", "unknown", "ground"],
)
def test_packed_photos_are_kept_where_they_are_needed_again(demo, monkeypatch, free, count, lean):
    flight, by, settings = demo
    monkeypatch.setattr("hsvaos.rendering.free_memory", lambda: free)
    surface = FocalPlane(flight.ground_down_m)
    views = [flight.view(i) for i in range(count)]
    renderer = Renderer(by, settings, surface, lean=True).with_ground_for(flight, views)
    assert renderer.lean == lean
    assert (renderer.ground is None) == (count < 30)
    own = Renderer(by, settings, surface).with_ground_for(flight, views)
    assert not own.lean  # who draws again and again keeps them
    assert grid_for(flight, views, surface, ViewSettings(aperture_m=3.0)) is None
    tilted = views[0].world_from_camera.copy()
    turn = np.radians(50.0)
    tilted[:3, :3] = tilted[:3, :3] @ np.array(
        [[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]]
    )
    oblique = hsvaos.VirtualCamera(views[0].camera, tilted)
    assert grid_for(flight, [*views, oblique], surface, ViewSettings()) is None
