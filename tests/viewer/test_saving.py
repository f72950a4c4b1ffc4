"""What is taken away: settings that hsvaos run takes, and films that can be played."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER
from hsvaos.settings import FocusSettings, MaskSettings, PhotoSettings, Settings
from hsvaos.viewer.picture import integral_picture
from hsvaos.viewer.request import Aperture, Focus, Request
from hsvaos.viewer.saving import film, settings_of, settings_toml
from hsvaos.viewer.session import Session


def test_a_run_with_saved_settings_renders_what_was_seen(
    session: Session, request_: Request, tmp_path: Path
) -> None:
    mask = MaskSettings(
        sigmas=1.4, hue_from_deg=40.0, hue_to_deg=150.0, keep_colours=("#3355aa",), keep_distance=9
    )
    asked = replace(
        request_, mask=mask, focus=Focus(-1.25, 5.0, -3.0), aperture=Aperture(radius_m=9.0)
    )
    file = tmp_path / "settings.toml"
    file.write_text(settings_toml(session, asked), encoding="utf-8")
    settings = Settings.from_file(file)
    assert settings == settings_of(session, asked)
    result = hsvaos.run(hsvaos.open_flight(FOLDER), settings)
    assert result.main.frame == session.flight.frames[session.flight.centre_index].name
    painted = integral_picture(result.main.integral, result.main.footprint, asked.look)
    seen = session.render(asked).rgb
    assert np.abs(painted.astype(int) - seen).max() <= 1


def test_what_has_no_setting_is_a_comment(session: Session, request_: Request) -> None:
    asked = replace(request_, aperture=Aperture(5.0, (1.0, 2.0), first=3, every=2))
    text = settings_toml(session, asked)
    assert "# photos within 5 m of north 1 m, east 2 m" in text
    assert "# photos 3 to None, every 2" not in text
    assert "# photos 3 to 29, every 2" in text
    assert Settings.from_toml(text).view.aperture_m is None


def test_terrain_is_saved_as_terrain(tmp_path: Path, request_: Request) -> None:
    axis = np.linspace(-60.0, 60.0, 13)
    path = tmp_path / "t.npz"
    np.savez(path, north_m=axis, east_m=axis, down_m=np.zeros((13, 13)))
    start = Settings(focus=FocusSettings(terrain=str(path)), photos=PhotoSettings(scale=0.125))
    session = Session.open(hsvaos.open_flight(FOLDER), start)
    saved = settings_of(session, replace(request_, focus=Focus(-2.0, terrain=True))).focus
    assert (saved.terrain, saved.offset_m, saved.down_m) == (str(path), -2.0, None)
    saved = settings_of(session, replace(request_, focus=Focus(-2.0, 1.0))).focus
    assert (saved.terrain, saved.offset_m, saved.down_m) == (None, 0.0, -2.0)


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_films_can_be_played(kind: str, tmp_path: Path) -> None:
    shades = [30, 120, 220]
    pictures = [np.full((61, 80, 3), shade, np.uint8) for shade in shades]
    path = tmp_path / f"film.{kind}"
    path.write_bytes(film(pictures, kind))
    capture = cv2.VideoCapture(str(path))
    for shade in shades:
        good, picture = capture.read()
        assert good
        assert picture.mean() == pytest.approx(shade, abs=6)
    assert not capture.read()[0]


def test_other_kinds_of_film_are_refused() -> None:
    with pytest.raises(ValueError, match="a film must be one of mp4, gif, got 'avi'"):
        film([np.zeros((8, 8, 3), np.uint8)], "avi")
