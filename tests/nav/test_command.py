"""The command: what it writes and prints, and how it fails."""

import csv
import subprocess
import sys

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from hsvaos.flight import FlightError
from hsvaos.formats.sensor_csv import write_csv_log
from hsvaos.nav.command import nav

app = typer.Typer()
app.command("nav")(nav)
app.command("other")(lambda: None)


@pytest.fixture(scope="module")
def folder(simulated, short_mission, tmp_path_factory):
    _, photos = short_mission
    names = [f"{i}.jpg" for i in range(len(photos))]
    triggers = (*zip(names, photos.tolist(), strict=True), ("late.jpg", 1e4))
    where = tmp_path_factory.mktemp("log")
    write_csv_log(simulated(1).replace(triggers=triggers), where)
    return where


def run(*arguments):
    return CliRunner().invoke(app, ["nav", *map(str, arguments)])


def test_table_trajectory_poses_and_figure(folder, tmp_path):
    out, poses, figure = (tmp_path / name for name in ("t.csv", "poses.csv", "figure.png"))
    presets = ("--imu", "adis16448", "--gnss", "sbas", "--gnss-latency", "0")
    result = run(folder, "-o", out, "--poses", poses, "--plot", figure, "--rate", "5", *presets)
    assert result.exit_code == 0, result.output
    for word in ("gnss position", "gnss velocity", "baro", "mean NIS", "smoothed", "1 sigma"):
        assert word in result.output
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 270
    assert np.isfinite([[float(v) for v in row.values()] for row in rows]).all()
    with poses.open() as file:
        assert len(list(csv.DictReader(file))) == 21
    assert "1 outside the trajectory left out" in result.output
    assert figure.stat().st_size > 20_000


def test_filter_without_smoothing_and_the_papers(folder, tmp_path):
    presets = ("--imu", "adis16448", "--gnss", "sbas", "--gnss-latency", "0")
    for arguments in (("--no-smooth",), ("--filter", "paper")):
        result = run(folder, "-o", tmp_path / "t.csv", *arguments, *presets)
        assert result.exit_code == 0, result.output
        assert "filtered" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--filter", "ukf"), "filter must be one of"),
        (("--imu", "none"), "imu must be one of"),
        (
            ("--rate", "-1", "--imu", "adis16448", "--gnss", "sbas", "--gnss-latency", "0"),
            "rate_hz",
        ),
    ],
)
def test_wrong_options_are_raised_for_the_cli_to_print(folder, tmp_path, arguments, message):
    result = run(folder, "-o", tmp_path / "t.csv", *arguments)
    assert isinstance(result.exception, ValueError)
    assert message in str(result.exception)
    assert not (tmp_path / "t.csv").exists()


@pytest.mark.parametrize("option", ["-o", "--poses", "--plot"])
def test_targets_are_checked_before_the_work(tmp_path, option):
    (tmp_path / "file").write_text("")
    for target, got in (
        (tmp_path, "got a folder"),
        (tmp_path / "no" / "t.png", "no, which is no folder"),
        (tmp_path / "file" / "t.png", "file, which is no folder"),
    ):
        result = run(tmp_path / "nowhere", option, target)
        assert isinstance(result.exception, FlightError)
        assert "expected a file in an existing folder" in str(result.exception)
        assert str(result.exception).endswith(got)


@pytest.mark.parametrize(("name", "got"), [("f.foo", ".foo"), ("f", "no ending")])
def test_the_format_of_the_figure_is_checked_before_the_work(tmp_path, name, got):
    result = run(tmp_path / "nowhere", "--plot", tmp_path / name)
    assert isinstance(result.exception, ValueError)
    assert str(result.exception).endswith(
        f"expected a figure ending in .png, .pdf or .svg, got {got}"
    )


def test_what_is_not_there_is_raised(tmp_path):
    result = run(tmp_path / "nowhere")
    assert isinstance(result.exception, FlightError)


def test_without_matplotlib_one_line_says_what_to_install(folder, tmp_path, monkeypatch):
    import hsvaos.nav.plot

    monkeypatch.setattr(hsvaos.nav.plot, "find_spec", lambda name: None)
    result = run(folder, "-o", tmp_path / "t.csv", "--plot", tmp_path / "f.png")
    assert isinstance(result.exception, FlightError)
    assert "pip install 'hsvaos[plot]'" in str(result.exception)


def test_importing_the_command_is_light():
    code = (
        "import sys, hsvaos.nav.command; "
        "heavy = {'numpy', 'matplotlib', 'scipy', 'pyulog', 'pymavlink'} & set(sys.modules); "
        "raise SystemExit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
