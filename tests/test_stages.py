"""Photos, views and focal surfaces of a run, on the demo flight."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER, demo_flight
from hsvaos.focusing import check_above, choose_surface, search_planes
from hsvaos.formats.native_write import write_native
from hsvaos.kernels.integrate import Integrator
from hsvaos.masking import make_masks
from hsvaos.photos import load_photos
from hsvaos.settings import FocusSettings, MaskSettings, PhotoSettings, Settings, ViewSettings
from hsvaos.viewing import choose_views, ground_grid
from tests.planes import planes_flight


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> hsvaos.Flight:
    made, photos, truth = planes_flight()
    folder = tmp_path_factory.mktemp("demo") / "flight"
    write_native(made, folder, images=photos, truth=truth)
    return hsvaos.open_flight(folder)


def away(found: hsvaos.Person, person: dict[str, float]) -> float:
    return float(np.hypot(found.north_m - person["north_m"], found.east_m - person["east_m"]))


def test_demo_finds_people_from_the_log_alone() -> None:
    """Everyone reached by rays; the one whom the photos see 2 % stands out by rarity only."""
    people = json.loads((FOLDER / "truth.json").read_text())["people"]
    (reached,) = [p for p in people if 30 * p["visible_fraction_mean"] >= 1.5]
    by_network = hsvaos.run(demo_flight())
    assert len(by_network.persons) == 1
    assert away(by_network.persons[0], reached) < 0.9  # within the body's length of its middle
    settings = hsvaos.Settings().with_values(detect={"method": "rarity"})
    by_rarity = hsvaos.run(demo_flight(), settings)
    assert len(by_rarity.persons) == len(people) == 2
    for person in people:
        assert min(away(found, person) for found in by_rarity.persons) < 0.9


def test_person_under_leaves_comes_first(flight: hsvaos.Flight) -> None:
    seen = []
    result = hsvaos.run(flight, progress=lambda stage, done, total: seen.append((done, total)))
    best = result.persons[0]
    assert (best.north_m, best.east_m) == pytest.approx((0.6, -0.4), abs=0.5)
    assert all(0 < done <= total for done, total in seen)
    assert set(result.main.extra) == {"plain", "rarity", "ground"}
    # the person is hidden in the single photo: its colours are hardly there
    red = result.photo[..., 0].astype(float) - result.photo[..., 1]
    assert (red > 40).sum() < 60


def test_photos_are_shrunk_with_their_camera_and_mask(
    flight: hsvaos.Flight, tmp_path: Path
) -> None:
    mask = np.full((512, 512), 255, np.uint8)
    mask[400:, 300:] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    photos = load_photos(flight.replace(mask=tmp_path / "mask.png"), scale=0.5)
    assert photos.images.shape == (30, 256, 256, 3)
    assert photos.flight.camera.width == 256
    assert photos.flight.camera.fov_deg == pytest.approx(flight.camera.fov_deg)
    assert photos.valid is not None
    assert photos.valid.shape == (256, 256)
    assert photos.valid[220, 200] == 0
    assert photos.valid[0, 0] == 255


def test_masks_that_differ_are_held_for_each_photo(flight: hsvaos.Flight, tmp_path: Path) -> None:
    mask = np.zeros((512, 512), np.uint8)
    cv2.imwrite(str(tmp_path / "m.png"), mask)
    from dataclasses import replace

    frames = [replace(flight.frames[0], mask=tmp_path / "m.png"), *flight.frames[1:3]]
    photos = load_photos(flight.replace(frames=tuple(frames)))
    assert photos.valid is not None
    assert photos.valid.shape == (3, 512, 512)
    assert (photos.valid[0] == 0).all()
    assert (photos.valid[1:] == 255).all()
    assert (photos.valid_of(1) == 255).all()


def test_too_many_pixels_for_the_memory_are_refused(
    flight: hsvaos.Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hsvaos.photos.free_memory", lambda: 10_000_000)
    with pytest.raises(hsvaos.FlightError, match=r"GiB.*--scale 0\.5"):
        load_photos(flight)


def test_views(flight: hsvaos.Flight) -> None:
    plane = hsvaos.FocalPlane(0.0)
    (centre,), shown = choose_views(flight, ViewSettings(), plane)
    assert centre[0] == flight.frames[flight.centre_index].name
    assert shown == 0
    views, shown = choose_views(flight, ViewSettings(frame="all"), plane)
    assert len(views) == 30
    assert shown == flight.centre_index
    few, shown = choose_views(flight, ViewSettings(frame="cover"), plane)
    assert few[shown][0] == centre[0]
    names = [name for name, _ in views]
    places = [names.index(name) for name, _ in few]
    assert places == sorted(set(places))
    assert len(few) < len(views) / 2
    (named,), _ = choose_views(flight, ViewSettings(frame="demo_003"), plane)
    assert named[0] == "demo_003.jpg"
    ((_, grid),), _ = choose_views(flight, ViewSettings(frame="ortho"), plane)
    corners = grid.rays([[0, 0], [grid.width - 1, grid.height - 1]])[0]
    assert corners[0, 0] > 15  # north-west corner beyond what any photo sees
    assert corners[1, 0] < -15
    assert corners[1, 1] > corners[0, 1]


def test_ground_grid_has_bounds(flight: hsvaos.Flight) -> None:
    plane = hsvaos.FocalPlane(0.0)
    assert ground_grid(flight, plane, None).gsd_m == pytest.approx(
        20.0 / flight.camera.fx, rel=0.05
    )
    with pytest.raises(hsvaos.FlightError, match="million pixels"):
        ground_grid(flight, plane, 1e-4)
    with pytest.raises(hsvaos.FlightError, match="not vertical"):
        ground_grid(flight, hsvaos.FocalPlane(point=[0, 0, 0], normal=[1, 0, 0]), None)


def test_focus_order_and_faults(flight: hsvaos.Flight, tmp_path: Path) -> None:
    few = load_photos(flight.subset(range(0, 30, 6)))
    integrator = Integrator(few.flight.camera, few.images, few.flight.poses)

    def surface(settings: FocusSettings, made: hsvaos.Flight = few.flight) -> object:
        return choose_surface(made, settings, [integrator])[0]

    asked = surface(FocusSettings(down_m=1.5))
    assert isinstance(asked, hsvaos.FocalPlane)
    assert asked.point[2] == 1.5
    known = surface(FocusSettings())
    assert isinstance(known, hsvaos.FocalPlane)
    assert known.point[2] == 0.0
    axis = np.arange(-30.0, 31.0)
    np.savez(tmp_path / "t.npz", north_m=axis, east_m=axis, down_m=np.zeros((61, 61)))
    terrain = surface(FocusSettings(), few.flight.replace(terrain=tmp_path / "t.npz"))
    assert isinstance(terrain, hsvaos.FocalTerrain)
    with pytest.raises(hsvaos.FlightError, match="above all 5 cameras"):
        surface(FocusSettings(down_m=-100.0))
    tilted = hsvaos.FocalPlane(point=[0.0, 0.0, -20.0], normal=[0.3, 0.0, 1.0])
    assert check_above(few.flight, tilted)[0].endswith("cameras lie below the focal surface")
    with pytest.raises(ValueError, match="must run downwards"):
        search_planes(flight, FocusSettings(from_m=5.0, to_m=-5.0))


def test_autofocus_of_a_flight_that_knows_no_ground(flight: hsvaos.Flight) -> None:
    lost = flight.replace(ground_down_m=None)
    focus = FocusSettings(from_m=-12.0, to_m=6.0)
    result = hsvaos.run(lost, Settings(focus=focus))
    assert result.surface.point[2] == pytest.approx(0.0, abs=1.0)
    assert any("does not say where its ground is" in note for note in result.notes)


def test_tilted_plane_and_aperture_change_the_picture(flight: hsvaos.Flight) -> None:
    settings = Settings(mask=MaskSettings(method="none"), photos=PhotoSettings(scale=0.25))
    wide = hsvaos.run(flight, settings)
    narrow = hsvaos.run(flight, settings.with_values(view={"aperture_m": 3.0}))
    assert narrow.main.footprint.max() < wide.main.footprint.max()
    assert narrow.main.footprint.max() >= 1.0


@pytest.mark.parametrize("count", [1, 4])
def test_photos_from_one_place_show_nothing_and_say_so(flight: hsvaos.Flight, count: int) -> None:
    from dataclasses import replace

    pose = flight.frames[0].world_from_camera
    frames = tuple(replace(frame, world_from_camera=pose) for frame in flight.frames[:count])
    result = hsvaos.run(flight.replace(frames=frames))
    assert not result.detected
    assert result.persons == ()
    assert any("from one place" in note for note in result.notes)


def test_what_is_no_flight_and_no_settings_is_refused(flight: hsvaos.Flight) -> None:
    with pytest.raises(TypeError, match="flight must be a Flight"):
        hsvaos.run("folder")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="settings must be Settings"):
        hsvaos.run(flight, {})  # type: ignore[arg-type]


def test_hues_cut_by_hand_and_colours_kept(flight: hsvaos.Flight) -> None:
    photos = load_photos(flight)

    def hue_mask(**mask: object) -> np.ndarray:
        settings = Settings(mask=MaskSettings(**mask), photos=PhotoSettings(level=False))
        return make_masks(photos, settings).hue.numpy() > 0

    hue = hsvaos.rgb_to_hsv(photos.images.numpy())[..., 0]
    cut = hue_mask(hue_from_deg=350.0, hue_to_deg=20.0)
    inside = (hue + 10.0) % 360.0
    clear = (np.abs(inside - 0.0) > 0.5) & (np.abs(inside - 30.0) > 0.5) & (hue > 0.0)
    np.testing.assert_array_equal(cut[clear], (inside > 30.0)[clear])
    assert not hue_mask(hue_from_deg=0.0, hue_to_deg=360.0)[hue > 0.0].any()

    leaf = photos.images.numpy()[0, 0, 0]
    kept = hue_mask(keep_colours=("#" + bytes(leaf).hex(),), keep_distance=3.0)
    plain = hue_mask()
    assert (kept >= plain).all()
    assert (kept & ~plain).any()


def test_surfaces_tilt_and_shift_as_settings_say(flight: hsvaos.Flight, tmp_path: Path) -> None:
    north, east = flight.poses[:, :2, 3].mean(axis=0)
    tilt = FocusSettings(down_m=2.0, pitch_deg=45.0, roll_deg=0.0)
    surface, _ = choose_surface(flight, tilt, ())
    assert isinstance(surface, hsvaos.FocalPlane)
    # one metre to the north the plane is one metre higher
    off = np.array([north + 1.0, east, 1.0]) - surface.point
    assert off @ surface.normal == pytest.approx(0.0, abs=1e-9)
    surface, _ = choose_surface(flight, FocusSettings(down_m=2.0, roll_deg=45.0), ())
    off = np.array([north, east + 1.0, 3.0]) - surface.point
    assert off @ surface.normal == pytest.approx(0.0, abs=1e-9)
    axis = np.linspace(-30, 30, 5)
    np.savez(tmp_path / "t.npz", north_m=axis, east_m=axis, down_m=np.zeros((5, 5)))
    moved = FocusSettings(terrain=str(tmp_path / "t.npz"), offset_m=1.5)
    surface, _ = choose_surface(flight, moved, ())
    assert isinstance(surface, hsvaos.FocalTerrain)
    np.testing.assert_allclose(surface.down_m, 1.5)
