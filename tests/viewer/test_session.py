"""The session: its pictures are those of the API, its stages are kept, its input is checked."""

from __future__ import annotations

import shutil
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER
from hsvaos.flight import FlightError
from hsvaos.masking import make_masks
from hsvaos.rendering import make_integrators
from hsvaos.report import figures
from hsvaos.settings import FocusSettings, MaskSettings, PhotoSettings, Settings
from hsvaos.viewer import weights as weights_module
from hsvaos.viewer.focus import focus_curve, sweep_pictures
from hsvaos.viewer.pace import Quality
from hsvaos.viewer.picture import integral_picture
from hsvaos.viewer.request import LAYERS, Aperture, Focus, Look, Request, window
from hsvaos.viewer.saving import settings_of, settings_toml
from hsvaos.viewer.session import Session
from hsvaos.viewer.weights import Abandoned


def by_the_api(session: Session, request: Request) -> np.ndarray:
    """What make_masks and Integrator make of a request."""
    settings = replace(session.settings, mask=request.mask)
    by = make_integrators(session.photos, make_masks(session.photos, settings), request.mask.method)
    integrator = by.plain if request.layer == "plain" else by.chosen
    surface = session.surface(request.focus)
    image, footprint = integrator.integrate(request.view, surface, frames=session.frames(request))
    return integral_picture(image.numpy(), footprint.numpy(), request.look)


@pytest.mark.parametrize("method", ["hue", "rarity", "anomaly", "none"])
@pytest.mark.parametrize("layer", ["masked", "plain"])
def test_pictures_are_those_of_the_api(
    session: Session, request_: Request, method: str, layer: str
) -> None:
    mask = MaskSettings(method=method, sigmas=1.5, brighten=method == "hue")
    focus = Focus(-2.0, pitch_deg=4.0, roll_deg=-6.0)
    aperture = Aperture(12.0, (1.0, -1.0), 2, 27, 2)
    asked = replace(request_, mask=mask, focus=focus, aperture=aperture, layer=layer)
    picture = session.render(asked)
    assert picture.frames == len(aperture.frames(session.places[:, :2], np.zeros(2)))
    expected = by_the_api(session, asked).astype(int)
    assert np.abs(picture.rgb.astype(int) - expected).max() <= 1
    assert picture.quality.full


@pytest.mark.parametrize("layer", LAYERS)
def test_every_layer_comes_coarse_and_full(session: Session, request_: Request, layer: str) -> None:
    asked = replace(request_, layer=layer, mask=MaskSettings(sigmas=1.7))
    coarse = session.render(asked, Quality(0.5, 3))
    full = session.render(asked)
    assert full.rgb.dtype == coarse.rgb.dtype == np.uint8
    assert full.rgb.shape[0] == 2 * coarse.rgb.shape[0]
    assert full.rgb.std() > 1.0
    waits = layer == "ground"  # nobody has looked into these photos
    assert full.stand_in == coarse.stand_in == waits
    assert full.note == coarse.note
    assert ("being looked into" in full.note) == bool(full.note) == waits


def test_bands_of_rows_are_the_whole(
    session: Session, request_: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = session.render(request_).rgb
    monkeypatch.setattr("hsvaos.viewer.render._BAND_RAYS", 1)
    parts = session.render(request_).rgb
    assert np.abs(whole.astype(int) - parts).max() <= 1
    asked = iter([True] * 3 + [False] * 1000)
    with pytest.raises(Abandoned):
        session.render(request_, wanted=lambda: next(asked))


def test_changing_sigmas_redoes_the_mask_only(
    request_: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session.open(hsvaos.open_flight(FOLDER), Settings(photos=PhotoSettings(scale=0.25)))
    session.render(request_)
    counted: list[str] = []
    for name in ("levelled", "hue_histograms", "cut_hues", "weigh_rarity"):
        original = getattr(weights_module, name)

        def count(*args: object, _name: str = name, _call: object = original, **more: object):
            counted.append(_name)
            return _call(*args, **more)  # type: ignore[operator]

        monkeypatch.setattr(weights_module, name, count)
    monkeypatch.setattr("hsvaos.viewer.session.load_photos", None)
    session.render(replace(request_, focus=Focus(-1.0)))
    session.render(replace(request_, look=Look(2.0)))
    assert counted == []
    session.render(replace(request_, mask=MaskSettings(sigmas=1.0)))
    assert counted == ["cut_hues"]
    counted.clear()
    session.render(request_)  # still kept
    assert counted == []


def test_a_flight_may_vanish_while_it_is_looked_at(tmp_path: Path) -> None:
    shutil.copytree(FOLDER, tmp_path / "flight")
    settings = Settings(photos=PhotoSettings(scale=0.125))
    flight = hsvaos.open_flight(tmp_path / "flight")
    session = Session.open(flight, settings)
    shutil.rmtree(tmp_path / "flight")
    view = session.flight.view(0)
    for layer in LAYERS:
        assert session.render(Request(view, layer=layer)).rgb.std() > 0.0
    with pytest.raises(FlightError, match="no photo can be used"):
        Session.open(flight, settings)


def test_notes_say_why_a_picture_is_empty(session: Session, request_: Request) -> None:
    above = session.render(replace(request_, focus=Focus(-500.0)))
    assert above.note == "no photo sees the focal surface there"
    outside = Aperture(0.5, (900.0, 900.0))
    none = session.render(replace(request_, aperture=outside))
    assert none.note == "no photo lies within the aperture"
    assert len(np.unique(none.rgb)) == 2  # the chequer of "no sample"
    with pytest.raises(FlightError, match="there is no terrain"):
        session.render(replace(request_, focus=Focus(terrain=True)))


def test_grey_photos_and_one_photo(grey: Session, lone: Session) -> None:
    for session in (grey, lone):
        view = session.flight.view(0)
        for layer in LAYERS:
            for quality in (Quality(), Quality(0.5, 2)):
                assert session.render(Request(view, layer=layer), quality).rgb.shape[2] == 3
    asked = Request(grey.flight.view(0))
    assert grey.colour_at(asked, 10.0, 10.0) is None
    assert grey.weights.hue_stats(asked.mask) == []
    lone_view = Request(lone.flight.view(0))
    assert lone.finds(lone_view) == ()
    assert lone.no_parallax is not None
    assert "one place" in lone.no_parallax


def test_a_terrain_is_shifted(tmp_path: Path, request_: Request) -> None:
    axis = np.linspace(-60.0, 60.0, 13)
    np.savez(tmp_path / "t.npz", north_m=axis, east_m=axis, down_m=np.full((13, 13), 1.0))
    focus = FocusSettings(terrain=str(tmp_path / "t.npz"), offset_m=0.5)
    settings = Settings(photos=PhotoSettings(scale=0.25), focus=focus)
    session = Session.open(hsvaos.open_flight(FOLDER), settings)
    assert session.start == Focus(0.5, terrain=True)
    terrain = session.render(replace(request_, focus=Focus(-1.0, terrain=True)))
    plane = session.render(replace(request_, focus=Focus(0.0)))
    near = np.abs(terrain.rgb.astype(int) - plane.rgb) <= 2
    assert near.mean() > 0.995


def test_eyedropper_keeps_the_colour_it_picked(session: Session, request_: Request) -> None:
    asked = replace(request_, layer="photo")
    index = session.nearest(asked.view)
    photo = session.photos.images[index].numpy()
    gains = session.weights.gains
    assert gains is not None
    colour = session.colour_at(asked, 40.0, 50.0)
    assert colour is not None
    picked = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    expected = photo[49:52, 39:42].reshape(-1, 3).mean(axis=0) * gains[index]
    np.testing.assert_allclose(picked, np.clip(expected, 0, 255), atol=2.0)
    mask = MaskSettings(keep_colours=(colour,))
    one = window(asked.view, 40, 50, 1, 1)
    before = Request(one, layer="masked", aperture=Aperture(first=index, last=index))
    kept = session.weights.integrator("hue", mask)
    cut = session.weights.integrator("hue", MaskSettings())
    ground = session.surface(before.focus)
    seen = [by.integrate(one, ground, frames=[index])[1].numpy().sum() for by in (cut, kept)]
    assert seen[1] >= seen[0]
    assert seen[1] > 0.0
    nowhere = replace(asked, layer="masked", focus=Focus(-500.0))
    assert session.colour_at(nowhere, 40.0, 50.0) is None


def test_finds_are_those_of_a_run() -> None:
    flight = hsvaos.open_flight(FOLDER)
    session = Session.open(flight)
    asked = Request(session.flight.view(session.flight.centre_index), session.start)
    looked_at: list[int] = []
    soon = session.render(replace(asked, layer="ground"))
    assert "being looked into" in soon.note
    assert np.array_equal(soon.rgb, session.render(replace(asked, layer="plain")).rgb)

    def look(stage: str, done: int, count: int) -> None:
        assert count == len(session.flight)
        assert stage == "looking for pieces of people"
        looked_at.append(done)

    with pytest.raises(Abandoned):
        session.finds(asked, lambda: len(looked_at) < 2, look)
    finds = session.finds(asked, progress=look)
    assert looked_at == list(range(1, len(session.flight) + 1))  # none of them twice
    on_its_plane = hsvaos.Settings().with_values(focus={"relief": False})
    result = hsvaos.run(flight, on_its_plane)
    assert sorted(f.score for f in finds) == pytest.approx(
        sorted(result.main.detections.scores.tolist())
    )
    ground = session.render(replace(asked, layer="ground"))
    image, rays = result.main.extra["ground"]
    assert ground.note == ""
    expected = integral_picture(image, figures.of_ground(rays), asked.look).astype(int)
    apart = np.abs(ground.rgb.astype(int) - expected)
    assert apart.max() <= 3  # a few rays give another colour where one lies on the edge of a photo
    assert (apart > 1).mean() < 1e-3
    for find in finds:
        # the place lies within its box
        low, high = find.corners.min(axis=0), find.corners.max(axis=0)
        assert (low[:2] - 1e-6 <= find.place[:2]).all()
        assert (find.place[:2] <= high[:2] + 1e-6).all()
    with pytest.raises(Abandoned):
        session.finds(replace(asked, focus=Focus(0.3)), wanted=lambda: False)
    # and on the relief of the ground, which a run finds by default
    note = session.find_relief(asked.mask)
    result = hsvaos.run(flight)
    assert note in result.notes
    there = replace(asked, focus=Focus(0.0, terrain=True))
    assert sorted(f.score for f in session.finds(there)) == pytest.approx(
        sorted(result.main.detections.scores.tolist())
    )
    saved = settings_of(session, there)
    assert (saved.focus.down_m, saved.focus.relief) == (session.start.down_m, True)
    again = hsvaos.run(flight, saved.with_values(detect={"enabled": False}))
    assert isinstance(again.surface, hsvaos.FocalTerrain)
    assert session.terrain is not None
    np.testing.assert_allclose(again.surface.down_m, session.terrain.down_m, atol=1e-4)
    assert "does not shift it" in settings_toml(
        session, replace(there, focus=Focus(1.0, 0, 0, True))
    )
    assert settings_of(session, asked).focus.relief is None


def test_no_relief_is_found_in_grey_photos(grey: Session) -> None:
    assert not grey.may_find_relief
    with pytest.raises(
        FlightError, match="found in RGB photos, about a focal plane, got grey photos"
    ):
        grey.find_relief(grey.settings.mask)


def test_focus_curve_peaks_at_the_ground(session: Session, request_: Request) -> None:
    told: list[tuple[int, int]] = []
    curve = focus_curve(
        session, request_, (-6.0, 6.0), 25, progress=lambda i, n: told.append((i, n))
    )
    assert told[-1] == (25, 25)
    assert curve.best_m == pytest.approx(0.0, abs=1.5)
    with pytest.raises(Abandoned):
        focus_curve(session, request_, (-6.0, 6.0), wanted=lambda: False)
    with pytest.raises(ValueError, match="range of depths"):
        focus_curve(session, request_, (6.0, -6.0))


def test_sweep_pictures_differ_by_depth(session: Session, request_: Request) -> None:
    first, second = sweep_pictures(session, request_, np.array([-5.0, 0.0]))
    assert first.shape == second.shape
    assert np.abs(first.astype(int) - second).mean() > 2.0


def test_many_threads_get_their_own_pictures(session: Session, request_: Request) -> None:
    requests = [
        replace(request_, focus=Focus(float(d)), mask=MaskSettings(sigmas=s, method=m))
        for d, s, m in [(-3, 1.1, "hue"), (0, 2.1, "hue"), (1, 2.0, "rarity"), (2, 2.0, "none")]
    ]
    expected = [session.render(asked).rgb for asked in requests]
    faults: list[int] = []

    def look(number: int) -> None:
        for _ in range(4):
            picture = session.render(requests[number]).rgb
            if np.abs(picture.astype(int) - expected[number]).max() > 0:
                faults.append(number)

    threads = [threading.Thread(target=look, args=(i,)) for i in range(len(requests))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert faults == []
