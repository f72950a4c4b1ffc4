from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
import typer
from typer.testing import CliRunner

import hsvaos
from hsvaos.simulate.command import simulate

app = typer.Typer()
app.command()(simulate)

SMALL = ["--photos", "2", "--size", "96", "--fov", "60", "--density", "150"]


def run(*words: str) -> object:
    return CliRunner().invoke(app, list(words), catch_exceptions=True)


def test_a_short_flight_is_written(tmp_path: Path) -> None:
    result = run(
        *SMALL,
        "--size",
        "160",
        "--season",
        "snow",
        "--people",
        "1",
        "--classes",
        "half",
        "--clothes",
        "olive",
        "--seed",
        "6",
        "--gnss-outage",
        "3-4",
        "--distortion",
        "-0.05,0,0,0,0",
        "-o",
        str(tmp_path / "f"),
    )
    assert result.exception is None, result.output
    flight = hsvaos.open_flight(tmp_path / "f")
    assert len(flight) == 2
    assert flight.camera.distortion[0] == -0.05
    truth = json.loads((tmp_path / "f" / "truth.json").read_text())
    assert truth["season"] == "snow"
    assert truth["people"][0]["clothes"] == "olive"
    assert truth["settings"]["sensors"]["gnss_outages_s"] == [[3.0, 4.0]]


def test_a_preview_is_one_picture(tmp_path: Path) -> None:
    result = run(*SMALL, "--people", "1", "--preview", "-o", str(tmp_path))
    assert result.exception is None, result.output
    assert [p.name for p in tmp_path.iterdir()] == ["preview.png"]
    assert cv2.imread(str(tmp_path / "preview.png")).shape == (96, 96, 3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--season", "spring"], "season must be one of summer, fall, snow"),
        (["--density", "-5"], "density must lie in"),
        (["--density", "4999", "--glades", "0.5"], "cannot be reached"),
        (["--size", "0"], "positive whole number"),
        (["--size", "-64"], "positive"),
        (["--photos", "0"], "photos must be"),
        (["--height-m", "-20"], "height_m must be positive"),
        (["--people", "-1"], "people must be"),
        (["--fov", "190"], "fov_deg"),
        (["--seed", "-1"], "seed must be"),
        (["--distortion", "1,2"], "5 numbers"),
        (["--distortion", "a,b"], "5 numbers"),
        (["--gnss-outage", "9"], "FROM-TO"),
        (["--gnss", "galileo"], "gnss must be one of"),
        (["--visible", "2"], "visible must lie"),
        (["--closure", "0"], "closure must lie"),
        (["--device", "cuda:7"], "cuda:7"),
        (["--size", "40", "--people", "1", "--classes", "half"], "fewer than 12 pixels"),
        (["--quality", "300"], "jpeg_quality"),
    ],
)
def test_bad_input_is_a_value_error_that_names_it(
    words: list[str], message: str, tmp_path: Path
) -> None:
    result = run(*SMALL, *words, "-o", str(tmp_path / "f"))
    assert isinstance(result.exception, ValueError), result.output
    assert message in str(result.exception)
    assert not list(tmp_path.iterdir())


def test_importing_the_command_imports_nothing_heavy() -> None:
    import subprocess
    import sys

    code = (
        "import sys, hsvaos.simulate.command;"
        "print([m for m in ('numpy', 'warp', 'cv2', 'hsvaos.simulate.scene') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
