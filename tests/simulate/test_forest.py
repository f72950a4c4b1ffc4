from __future__ import annotations

import colorsys

import numpy as np
import pytest

from hsvaos.camera import Camera
from hsvaos.simulate.forest import ForestSettings, grow_forest
from hsvaos.simulate.ground import make_ground
from hsvaos.simulate.instances import Kind
from hsvaos.simulate.mesh import Mesh
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.occlusion import (
    closure,
    label,
    mean_fraction,
    visibility_map,
)
from hsvaos.simulate.planting import glade_circles, stem_places
from hsvaos.simulate.seasons import SEASONS, season, sun_direction
from hsvaos.simulate.solve import solve_closure, solve_visible
from hsvaos.simulate.textures import Tile, draw_atlas

SMALL = ForestSettings(seed=3, half_m=16.0, density=300.0)
CAMERA = Camera.from_fov(256, 256, 60.0)
POSES = Mission(photos=6).poses()


def hue_deg(rgb: tuple[float, float, float]) -> float:
    return colorsys.rgb_to_hsv(*rgb)[0] * 360.0


def test_stems_are_as_many_as_asked_apart_and_clear_of_glades() -> None:
    settings = ForestSettings(seed=1, density=400.0, half_m=30.0, glades=0.15)
    places = stem_places(settings)
    assert len(places) == round(400.0 * 0.36)
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e3 * np.eye(len(places))
    assert gaps.min() > 0.6 * np.sqrt(1e4 / 400.0)
    for north, east, radius in glade_circles(settings):
        assert np.hypot(places[:, 0] - north, places[:, 1] - east).min() > radius


def test_the_same_seed_gives_the_same_forest_and_another_seed_another() -> None:
    first, again = grow_forest(SMALL), grow_forest(SMALL)
    np.testing.assert_array_equal(first.stems, again.stems)
    np.testing.assert_array_equal(first.ground.colour, again.ground.colour)
    np.testing.assert_array_equal(first.instances.place, again.instances.place)
    for a, b in zip(first.instances.meshes, again.instances.meshes, strict=True):
        np.testing.assert_array_equal(a.corner, b.corner)
        np.testing.assert_array_equal(a.colour, b.colour)
    other = grow_forest(SMALL.replace(seed=4))
    assert not np.array_equal(first.stems[: len(other.stems)], other.stems[: len(first.stems)])


def test_fall_leaves_straddle_red_and_summer_leaves_are_green() -> None:
    fall = [hue_deg(c) for s in season("fall").species for c in s.palette]
    assert min(fall) < 15.0
    assert max(h for h in fall if h > 180.0) > 340.0
    assert sum(30.0 < h < 65.0 for h in fall) >= 5
    summer = [hue_deg(c) for s in season("summer").species for c in s.palette]
    assert 70.0 < min(summer) <= max(summer) < 170.0


def test_winter_trees_are_bare_or_conifers() -> None:
    assert {s.kind for s in season("snow").species} == {"bare", "conifer"}


def test_leaf_tiles_have_holes_and_keep_their_cover_at_every_level() -> None:
    atlas = draw_atlas(0).reshape(len(Tile), -1, 3)
    for tile in Tile:
        start, shares = 0, []
        for level in range(4):
            size = (128 >> level) ** 2
            shares.append(float((atlas[tile, start : start + size, 0] > 0).mean()))
            start += size
        assert 0.08 < shares[0] < 0.9
        assert max(shares) - min(shares) < 0.06


def test_the_ground_is_as_rough_as_asked_and_its_triangles_are_its_heights() -> None:
    ground = make_ground(1, season("summer"), 16.0, 0.3, 256)
    assert ground.down_m.std() == pytest.approx(0.3, rel=0.35)
    mesh, place = ground.tiles()[0]
    points = mesh.vertices()[::7] + place
    np.testing.assert_allclose(ground.down_at(points[:, 0], points[:, 1]), points[:, 2], atol=1e-4)


def test_a_clearing_has_no_trees() -> None:
    forest = grow_forest(SMALL)
    cleared = forest.cleared(2.0, -3.0, 6.0)
    assert len(cleared.stems) < len(forest.stems)
    away = np.hypot(cleared.stems[:, 0] - 2.0, cleared.stems[:, 1] + 3.0)
    assert away.min() >= 6.0
    assert sum(k == Kind.TREE for k in cleared.instances.kind) == len(cleared.stems)


def test_more_stems_close_the_canopy_and_hide_the_ground() -> None:
    closed, seen = [], []
    for density in (60.0, 250.0, 600.0):
        scene = grow_forest(SMALL.replace(density=density)).scene()
        closed.append(closure(scene, 12.0))
        seen.append(visibility_map(scene, CAMERA, POSES, 10.0).mean)
    assert closed == sorted(closed)
    assert seen == sorted(seen, reverse=True)
    assert closed[0] < 0.5 < closed[2]


def test_an_empty_forest_hides_nothing() -> None:
    forest = grow_forest(SMALL.replace(density=0.0, bushes=0.0))
    assert visibility_map(forest.scene(), CAMERA, POSES, 10.0).mean > 0.99


@pytest.mark.slow
def test_solvers_reach_closure_and_visible_fraction() -> None:
    settings, got = solve_closure(SMALL, 0.6, 12.0)
    assert got == pytest.approx(0.6, abs=0.03)
    assert closure(grow_forest(settings).scene(), 12.0) == pytest.approx(got, abs=1e-9)
    settings, got = solve_visible(SMALL, 0.2, CAMERA, POSES, 10.0)
    assert got == pytest.approx(0.2, abs=0.03)
    again = visibility_map(grow_forest(settings).scene(), CAMERA, POSES, 10.0).mean
    assert again == pytest.approx(got, abs=1e-9)


@pytest.mark.slow
def test_solvers_say_what_can_be_reached() -> None:
    with pytest.raises(ValueError, match=r"closure of 0.999 cannot be reached.* give 0\.\d+ to"):
        solve_closure(SMALL.replace(glades=0.5), 0.999, 12.0)
    with pytest.raises(ValueError, match=r"visible fraction of 0.9 cannot be reached"):
        solve_visible(SMALL, 0.9, CAMERA, POSES, 10.0)


@pytest.mark.parametrize("wanted", [0.0, 1.0, -0.2, 3.0, float("nan")])
def test_shares_out_of_range_are_refused(wanted: float) -> None:
    with pytest.raises(ValueError, match="closure must lie"):
        solve_closure(SMALL, wanted, 12.0)
    with pytest.raises(ValueError, match="visible must lie"):
        solve_visible(SMALL, wanted, CAMERA, POSES, 10.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"season": "spring"}, "summer, fall, snow.*'spring'"),
        ({"density": -1.0}, "density"),
        ({"density": float("nan")}, "density"),
        ({"half_m": -5.0}, "half_m"),
        ({"leaf_density": 0.0}, "leaf_density"),
        ({"glades": 1.0}, "glades"),
        ({"detail": "ultra"}, "light, heavy"),
        ({"seed": -1}, "seed"),
        ({"sun_elevation_deg": -3.0}, "sun elevation"),
        ({"cloud": 1.2}, "cloud"),
    ],
)
def test_bad_forests_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SMALL.replace(**change)


def test_a_density_that_does_not_fit_says_how_much_does() -> None:
    with pytest.raises(ValueError, match=r"density 5000 .* cannot be reached.* \d+ fit"):
        stem_places(ForestSettings(density=5000.0, half_m=10.0, glades=0.7))


def test_the_sun_points_up_and_by_azimuth() -> None:
    np.testing.assert_allclose(sun_direction(90.0, 0.0), [0, 0, -1], atol=1e-12)
    east = sun_direction(30.0, 90.0)
    np.testing.assert_allclose(east, [0.0, np.cos(np.pi / 6), -0.5], atol=1e-12)


@pytest.mark.parametrize("name", SEASONS)
def test_every_mesh_of_a_forest_is_finite(name: str) -> None:
    forest = grow_forest(SMALL.replace(season=name, density=40.0))
    joined = Mesh.join(forest.instances.meshes)
    for part in (joined.corner, joined.side_a, joined.side_b):
        assert np.isfinite(part).all()
    trees = [
        forest.instances.meshes[m]
        for m, k in zip(forest.instances.mesh, forest.instances.kind, strict=True)
        if k == Kind.TREE
    ]
    height = -np.array([t.vertices()[:, 2].min() for t in trees])
    assert ((height > 8.5) & (height < 16.0)).all()


def test_occlusion_labels() -> None:
    assert label(0.02, False) == "full"
    assert label(0.5, False) == "half"
    assert label(0.95, False) == "open"
    assert label(0.3, True) == "bush"
    assert mean_fraction([(5, 10), (0, 100), (1, 4)]) == pytest.approx(0.0)
    assert mean_fraction([(1, 4)]) is None
