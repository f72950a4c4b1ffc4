"""Which frames' views hold all that any frame's view holds."""

from pathlib import Path

import numpy as np
import pytest

import hsvaos
from hsvaos import Camera, Flight, FocalPlane, Frame, Settings
from hsvaos.demo import demo_flight
from hsvaos.viewing import covering_poses, ground_grid, share_held
from tests.kernels.test_integrate import looking_down


def strips(rows, columns, apart_m, height_m=20.0):
    frames = tuple(
        Frame(f"{i}_{k}", Path(__file__), looking_down(apart_m * i, apart_m * k, height_m))
        for i in range(rows)
        for k in range(columns)
    )
    return Flight("strips", Camera.from_fov(100, 100, 90.0), frames)


def held(flight, index, places):
    view = flight.view(index)
    u, v = view.project(places).T
    return (u >= 0) & (u <= view.width - 1) & (v >= 0) & (v <= view.height - 1)


@pytest.mark.parametrize("first", [(), (0,), (14, 3)])
def test_whom_any_view_holds_one_of_the_chosen_holds(first):
    flight = strips(5, 6, 5.0)
    others = covering_poses(flight, FocalPlane(0.0), first)
    chosen = [*first, *others]
    assert len(set(chosen)) == len(chosen) < len(flight) / 2
    rng = np.random.default_rng(0)
    # within 90 % of what is seen: strips at the border may be left out
    reach = 18.0 + 2.5 * np.array([4, 5])
    places = np.zeros((2000, 3))
    places[:, :2] = rng.uniform(-reach, reach, (2000, 2)) + np.array([10.0, 12.5])
    seen = np.array([held(flight, k, places) for k in range(len(flight))])
    assert seen.any(axis=0).all()
    assert seen[chosen].any(axis=0).mean() > 0.99


def test_views_far_apart_are_all_needed_and_the_same_one_twice_is_not():
    apart = strips(1, 3, 60.0)
    assert sorted(covering_poses(apart, FocalPlane(0.0))) == [0, 1, 2]
    same = strips(1, 4, 0.0)
    assert len(covering_poses(same, FocalPlane(0.0))) == 1
    assert covering_poses(same, FocalPlane(0.0), (2,)) == []


def test_how_much_of_the_ground_views_hold():
    flight, plane = strips(1, 4, 40.0), FocalPlane(0.0)  # side by side
    views = [flight.view(k) for k in range(4)]
    for count in (1, 2, 4):
        assert share_held(flight, plane, views[:count]) == pytest.approx(count / 4, abs=0.02)
    assert share_held(flight, plane, [ground_grid(flight, plane, 1.0)]) == 1.0
    assert share_held(flight, FocalPlane(-30.0), views) is None  # above the cameras
    wide = strips(2, 3, 900.0, height_m=300.0)  # squares larger than a metre
    assert share_held(wide, plane, [wide.view(1)]) == pytest.approx(1 / 6, abs=0.03)


@pytest.mark.parametrize(("frame", "told"), [("centre", True), ("cover", False), ("ortho", False)])
def test_a_run_tells_what_it_leaves_unsearched(frame, told):
    flight = demo_flight()
    settings = Settings().with_values(
        view={"frame": frame}, detect={"method": "rarity"}, photos={"scale": 0.25}
    )
    notes = hsvaos.run(flight, settings).notes
    assert any("--view cover searches all of it" in note for note in notes) == told
    unasked = settings.with_values(detect={"enabled": False})
    assert not any("--view cover" in note for note in hsvaos.run(flight, unasked).notes)


@pytest.mark.slow
def test_few_views_find_whom_all_of_them_find():
    persons = {
        frame: hsvaos.run(demo_flight(), Settings().with_values(view={"frame": frame})).persons
        for frame in ("cover", "all")
    }
    assert len(persons["cover"]) == len(persons["all"]) > 0
    for few, every in zip(persons["cover"], persons["all"], strict=True):
        assert np.hypot(few.north_m - every.north_m, few.east_m - every.east_m) < 0.3
        assert few.score == pytest.approx(every.score, abs=0.05)
        assert few.views < every.views
