"""A run focuses on the ground's relief, unless it is told where to focus."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hsvaos
from hsvaos import FlightError, FocalPlane, FocalTerrain, Settings
from hsvaos.demo import demo_flight
from hsvaos.flight import Flight
from hsvaos.focusing import chosen_terrain
from hsvaos.formats.native_write import write_native
from hsvaos.photos import with_poses
from hsvaos.report.terrain import height_picture
from hsvaos.report.write import write_result
from hsvaos.settings import FocusSettings


@pytest.fixture(scope="module")
def flight() -> Flight:
    return with_poses(demo_flight())


def on(flight: Flight, **focus: object) -> hsvaos.Result:
    tables = {"focus": focus, "detect": {"method": "rarity"}}
    return hsvaos.run(flight, Settings().with_values(**tables))


def test_by_default_with_the_network(flight: Flight, tmp_path: Path) -> None:
    stages = []
    result = hsvaos.run(flight, progress=lambda stage, done, total: stages.append(stage))
    assert isinstance(result.surface, FocalTerrain)
    assert any("relief of the ground: -" in note for note in result.notes)
    assert "finding the relief of the ground" in stages
    written = write_result(result, tmp_path / "out")
    again = FocalTerrain.from_file(written["terrain.npz"])
    np.testing.assert_allclose(again.down_m, result.surface.down_m)
    assert again.spacing_m == pytest.approx(result.surface.spacing_m)
    assert (again.north0_m, again.east0_m) == pytest.approx(
        (result.surface.north0_m, result.surface.east0_m)
    )
    assert "Height of the ground" in written["report.html"].read_text()
    # a run on a plane takes the files away again
    write_result(on(flight), tmp_path / "out")
    assert not (tmp_path / "out" / "terrain.npz").exists()


def test_grey_photos_have_none_to_find(flight: Flight, tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    photos = [photo[..., 1] for photo in flight.images()]
    write_native(flight, grey, images=photos)
    with pytest.raises(FlightError, match="found in RGB photos only, got grey ones"):
        on(hsvaos.open_flight(grey), relief=True)


def test_who_names_a_plane_gets_it(flight: Flight) -> None:
    assert isinstance(on(flight).surface, FocalPlane)  # nobody looks into the photos
    result = hsvaos.run(flight, Settings().with_values(focus={"down_m": 0.0}))
    assert isinstance(result.surface, FocalPlane)
    result = hsvaos.run(flight, Settings().with_values(focus={"relief": False}))
    assert isinstance(result.surface, FocalPlane)
    both = on(flight, down_m=0.0, relief=True)
    assert isinstance(both.surface, FocalTerrain)
    assert "ground" in both.main.extra


def test_what_makes_no_sense() -> None:
    with pytest.raises(ValueError, match="no terrain beside it"):
        Settings().with_values(focus={"relief": True, "terrain": "ground.npz"})


def test_relief_is_not_found_about_a_terrain(flight: Flight, tmp_path: Path) -> None:
    (tmp_path / "own.npz").touch()  # is not even opened
    bound = flight.replace(terrain=tmp_path / "own.npz")
    with pytest.raises(FlightError, match=r"brings its terrain .*own\.npz.*expected --focus-down"):
        on(bound, relief=True)
    with pytest.raises(FlightError, match=r"own\.npz"):  # else it is used
        on(bound)
    assert chosen_terrain(bound, FocusSettings(relief=True, down_m=0.0)) is None
    assert chosen_terrain(bound, FocusSettings(relief=True, autofocus=True)) is None


def test_heights_are_drawn_north_up() -> None:
    down = np.zeros((30, 40), np.float32)
    down[0] = 1.0  # low in the south
    down[:, -1] = np.nan
    picture, low, high = height_picture(FocalTerrain(0.0, 0.0, 0.5, down))
    assert (low, high) == (-1.0, 0.0)
    assert picture.shape == (480, 640, 4)
    assert (picture[-1, 0, :3] != picture[0, 0, :3]).any()
    assert not picture[:, -1, 3].any()
    assert picture[:, 0, 3].all()
