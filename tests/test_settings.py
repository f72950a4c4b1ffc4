from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.settings import (
    DetectSettings,
    FocusSettings,
    MaskSettings,
    PhotoSettings,
    Settings,
    ViewSettings,
)

positive = st.floats(1e-6, 1e6)


@given(
    sigmas=positive,
    method=st.sampled_from(["hue", "rarity", "anomaly", "none"]),
    down=st.none() | st.floats(-1e4, 1e4),
    frame=st.text(st.characters(exclude_categories=["Cs", "Cc"])),
    finds=st.integers(1, 1000),
    colours=st.lists(st.from_regex(r"#[0-9a-f]{6}", fullmatch=True), max_size=3),
    cut=st.none() | st.tuples(st.floats(0, 360), st.floats(0, 360)),
)
def test_toml_round_trip(
    sigmas: float,
    method: str,
    down: float | None,
    frame: str,
    finds: int,
    colours: list[str],
    cut: tuple[float, float] | None,
) -> None:
    first, last = cut or (None, None)
    settings = Settings(
        mask=MaskSettings(
            method=method,
            sigmas=sigmas,
            keep_colours=tuple(colours),
            hue_from_deg=first,
            hue_to_deg=last,
        ),
        focus=FocusSettings(down_m=down, pitch_deg=3, offset_m=-1),
        view=ViewSettings(frame=frame),
        detect=DetectSettings(max_finds=finds),
    )
    text = settings.to_toml()
    assert Settings.from_toml(text) == settings
    assert tomllib.loads(text)["mask"]["method"] == method


def test_whole_numbers_are_taken_for_lengths() -> None:
    assert Settings.from_toml("[focus]\ndown_m = 3\n").focus.down_m == 3.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[mask", "no valid TOML"),
        ("[masks]\n", "no table 'masks'; known are photos, mask"),
        ("[mask]\nsigma = 2\n", r"\[mask\]: no key 'sigma'; known are method"),
        ('[mask]\nsigmas = "two"\n', "mask.sigmas must be float, got 'two'"),
        ("[mask]\nsigmas = -1\n", "mask.sigmas must be a positive number, got -1.0"),
        ("[mask]\nbrighten = 1\n", "mask.brighten must be bool, got 1"),
        ('[mask]\nmethod = "magic"\n', "one of hue, rarity, anomaly, none"),
        ("[focus]\ndown_m = 1\nautofocus = true\n", "only one of"),
        ("mask = 3\n", "must be a table"),
        ('[mask]\nkeep_colours = ["red"]\n', "must be colours like \"#c81e1e\", got 'red'"),
        ('[mask]\nkeep_colours = "#ff0000"\n', "mask.keep_colours must be a list"),
        ("[mask]\nkeep_colours = [3]\n", "mask.keep_colours must be str, got 3"),
        ("[mask]\nhue_from_deg = 30\n", "mask must be hue_from_deg and hue_to_deg"),
        ("[mask]\nhue_from_deg = 30\nhue_to_deg = 400\n", "hues of 0 to 360 degrees"),
        ("[focus]\npitch_deg = 80\n", "focus.pitch_deg must be a tilt of at most 60 degrees"),
        ("[photos]\nscale = 2.0\n", "photos.scale"),
        ("[detect]\nmax_finds = 0\n", "detect.max_finds"),
    ],
)
def test_bad_toml_is_named(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Settings.from_toml(text)


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (Settings, {"mask": "hue"}, "mask must be MaskSettings, got 'hue'"),
        (Settings, {"mask": {"method": "hue"}}, "mask must be MaskSettings, got {"),
        (Settings, {"focus": None}, "focus must be FocusSettings, got None"),
        (ViewSettings, {"frame": 3}, "view.frame must be str, got 3"),
        (ViewSettings, {"gsd_m": float("inf")}, "view.gsd_m must be a finite number, got inf"),
        (FocusSettings, {"down_m": float("nan")}, "focus.down_m must be a finite number, got nan"),
        (FocusSettings, {"from_m": 10**400}, "focus.from_m must be a finite number"),
        (FocusSettings, {"autofocus": 1}, "focus.autofocus must be bool, got 1"),
        (FocusSettings, {"steps": 10001}, "focus.steps must be between 3 and 10000 planes, got"),
        (DetectSettings, {"max_finds": 1.5}, "detect.max_finds must be int, got 1.5"),
        (DetectSettings, {"max_finds": True}, "detect.max_finds must be int, got True"),
        (MaskSettings, {"sigmas": "2"}, "mask.sigmas must be float, got '2'"),
        (MaskSettings, {"method": ["hue"]}, "mask.method must be str, got"),
        (MaskSettings, {"rarity_smoothing_bins": 41}, "rarity_smoothing_bins must be between 0"),
        (PhotoSettings, {"scale": None}, "photos.scale must be float, got None"),
    ],
)
def test_bad_values_in_python_are_named(kind: type, values: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        kind(**values)


def test_numbers_of_numpy_are_taken_as_plain_ones() -> None:
    focus = FocusSettings(down_m=np.float32(2.5), steps=np.int64(9))  # type: ignore[arg-type]
    assert (type(focus.down_m), type(focus.steps)) == (float, int)
    assert "down_m = 2.5" in Settings(focus=focus).to_toml()
    assert type(MaskSettings(sigmas=2).sigmas) is float


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone\.toml: no such settings file"):
        Settings.from_file(tmp_path / "gone.toml")


def test_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="UTF-8"):
        Settings.from_file(path)


def test_none_changes_nothing() -> None:
    changed = Settings().with_values(mask={"sigmas": None, "method": "rarity"})
    assert changed.mask == MaskSettings(method="rarity")
