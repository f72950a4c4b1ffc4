from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.settings import DetectSettings, FocusSettings, MaskSettings, Settings, ViewSettings

positive = st.floats(1e-6, 1e6)


@given(
    sigmas=positive,
    method=st.sampled_from(["hue", "rarity", "anomaly", "none"]),
    down=st.none() | st.floats(-1e4, 1e4),
    frame=st.text(st.characters(exclude_categories=["Cs", "Cc"])),
    finds=st.integers(1, 1000),
)
def test_toml_round_trip(
    sigmas: float, method: str, down: float | None, frame: str, finds: int
) -> None:
    settings = Settings(
        mask=MaskSettings(method=method, sigmas=sigmas),
        focus=FocusSettings(down_m=down),
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
        ("[photos]\nscale = 2.0\n", "photos.scale"),
        ("[detect]\nmax_finds = 0\n", "detect.max_finds"),
    ],
)
def test_bad_toml_is_named(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Settings.from_toml(text)


def test_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="UTF-8"):
        Settings.from_file(path)


def test_none_changes_nothing() -> None:
    changed = Settings().with_values(mask={"sigmas": None, "method": "rarity"})
    assert changed.mask == MaskSettings(method="rarity")
