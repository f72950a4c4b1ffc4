"""`hsvaos evaluate` as a user meets it, on the flight in the package with a few of its photos."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

import hsvaos
from hsvaos.__main__ import main
from hsvaos.camera import Camera
from hsvaos.demo import FOLDER
from hsvaos.evaluate.measures import Evaluation
from hsvaos.evaluate.operating import persons_from, widened
from hsvaos.evaluate.results import FlightResult
from hsvaos.evaluate.truth import read_truth
from hsvaos.kernels import device
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.record import simulate_flight
from hsvaos.simulate.settings import SimulationSettings

Fails = Callable[..., str]


def cli(*args: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hsvaos", "evaluate", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture
def fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Fails:
    """Run the command in this process; it must end in one clear line and exit code 2."""

    def run(*args: object) -> str:
        monkeypatch.setattr(sys, "argv", ["hsvaos", "evaluate", *map(str, args)])
        monkeypatch.setattr(device, "on_slow_load", None)
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        (line,) = [t for t in capsys.readouterr().err.splitlines() if t.startswith("error: ")]
        return line

    return run


def few_photos(folder: Path, every: int, first: int = 0) -> Path:
    """The flight in the package with every n-th of its photos."""
    shutil.copytree(FOLDER, folder, ignore=shutil.ignore_patterns("images"))
    (folder / "images").symlink_to(FOLDER / "images")
    for name in ("poses.csv", "poses_ekf.csv", "triggers.csv"):
        head, *rows = (folder / name).read_text().splitlines(keepends=True)
        (folder / name).write_text("".join([head, *rows[first::every]]))
    return folder


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("flights")
    return [few_photos(folder / "a", 5), few_photos(folder / "b", 5, 2)]


OPTIONS = ("--mask", "rarity", "--scale", "0.5", "--json")
PEAKS = (*OPTIONS, "--detect", "rarity")
"""Without the network: where it does not matter who is found."""


def test_tables_and_curve_and_what_is_kept(flights: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = cli(*flights, "-o", out, *OPTIONS)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    outcome = json.loads(done.stdout)
    assert [flight["kept"] for flight in outcome["flights"]] == [False, False]
    assert [flight["name"] for flight in outcome["flights"]] == ["a", "b"]
    evaluation = Evaluation.from_json((out / "evaluation.json").read_text())
    assert json.loads(evaluation.to_json()) == outcome["evaluation"]
    assert [row.iou for row in evaluation.detection[:3]] == [0.10, 0.25, 0.50]
    assert [row.views for row in evaluation.flights] == [6, 6]
    assert evaluation.rules.score == pytest.approx(hsvaos.Detector().score)
    assert {row.group for row in evaluation.persons} >= {"all", "half"}
    assert "## Persons on the ground" in (out / "evaluation.md").read_text()
    assert (out / "evaluation.csv").read_text().startswith("group,iou,boxes,ap_coco101")
    assert cv2.imread(str(out / "pr_curve.png")) is not None
    # other rules: the flights are kept, and the same as before
    few = cli(*flights, "-o", out, *OPTIONS, "--iou", "0.3", "--radius", "1")
    assert few.returncode == 0, few.stderr
    again = json.loads(few.stdout)
    assert [flight["kept"] for flight in again["flights"]] == [True, True]
    assert [row["iou"] for row in again["evaluation"]["detection"][:2]] == [0.3, 0.3]


def test_other_settings_and_poses_are_other_results(flights: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"

    def kept(*args: object) -> list[bool]:
        done = cli(*args, "-o", out, *PEAKS)
        assert done.returncode == 0, done.stderr
        return [flight["kept"] for flight in json.loads(done.stdout)["flights"]]

    assert kept(*flights) == [False, False]
    assert kept(*flights, "--score-threshold", "3.5") == [False, False]
    assert kept(*flights, "--poses", "poses_ekf.csv") == [False, False]
    said = cli(*flights, "-o", out, *PEAKS, "--poses", "poses_ekf.csv")
    assert [flight["kept"] for flight in json.loads(said.stdout)["flights"]] == [True, True]
    loud = [option for option in PEAKS if option != "--json"]
    said = cli(*flights, "-o", out, *loud, "--poses", "poses_ekf.csv")
    assert "flight 1 of 2, a: kept, same settings and inputs" in said.stderr
    assert "look at" in said.stdout
    assert kept(flights[0], "--poses", "poses_ekf.csv", "--fresh") == [False]


def test_changed_truth_is_seen(tmp_path: Path) -> None:
    flight, out = few_photos(tmp_path / "f", 10), tmp_path / "out"
    assert cli(flight, "-o", out, *PEAKS).returncode == 0
    truth = json.loads((flight / "truth.json").read_text())
    truth["people"] = truth["people"][1:]
    (flight / "truth.json").write_text(json.dumps(truth))
    outcome = json.loads(cli(flight, "-o", out, *PEAKS).stdout)
    assert not outcome["flights"][0]["kept"]
    assert outcome["evaluation"]["persons"][-1]["people"] == 1  # everyone
    # a damaged result is made anew
    (out / "flights" / "f.json").write_text("{")
    assert not json.loads(cli(flight, "-o", out, *PEAKS).stdout)["flights"][0]["kept"]


def test_weak_finds_change_no_person(flights: list[Path]) -> None:
    flight = hsvaos.open_flight(flights[0])
    settings = hsvaos.Settings().with_values(
        mask={"method": "rarity"}, view={"frame": "all"}, photos={"scale": 0.5}
    )
    plain, wide = hsvaos.run(flight, settings), hsvaos.run(flight, widened(settings))
    assert plain.persons
    assert sum(len(found) for _, found in wide.views) > sum(len(f) for _, f in plain.views)
    assert persons_from(wide, settings, "cpu") == plain.persons
    result = FlightResult.from_run(wide, read_truth(flight))
    assert result.area_ha == pytest.approx(0.25, abs=0.1)
    assert all(len(view.truth) > 0 for view in result.views)
    # finds and truth speak of the same pixels: the person in the open is among them
    hits = sum(
        any(b[0] - 5 < (t.xyxy[0] + t.xyxy[2]) / 2 < b[2] + 5 for b in view.found.boxes_xyxy)
        for view in result.views
        for t in view.truth
        if t.person == "person_1"
    )
    assert hits >= 4


def test_faults_are_named_before_the_work(
    flights: list[Path], tmp_path: Path, fails: Fails
) -> None:
    file = tmp_path / "file"
    file.touch()
    assert "expected a folder for the output" in fails(flights[0], "-o", file)
    out = tmp_path / "out"
    no_truth = few_photos(tmp_path / "bare", 5)
    (no_truth / "truth.json").unlink()
    assert "truth.json: no such file" in fails(flights[0], no_truth, "-o", out)
    (no_truth / "truth.json").write_text('{"people": []}')
    assert "no people" in fails(no_truth, "-o", out)
    assert not list((out / "flights").iterdir())
    assert "given once" in fails(flights[0], flights[0], "-o", out)
    assert "no such folder" in fails(tmp_path / "nothing", "-o", out)
    missing = fails(tmp_path / "no", tmp_path / "nor", "-o", out)
    assert "no such folder" in missing
    off = tmp_path / "off.toml"
    off.write_text("[detect]\nenabled = false\n")
    assert "detect.enabled must be true" in fails(flights[0], "-o", out, "--settings", off)
    assert "given as poses" in fails(*flights, "-o", out, "--poses", "nothing.csv")
    assert "given as terrain" in fails(*flights, "-o", out, "--terrain", "nothing.npz")
    assert "ious must be above 0" in fails(flights[0], "-o", out, "--iou", "0")
    assert "radius_m must be" in fails(flights[0], "-o", out, "--radius", "-1")
    wrong = ("--score-threshold", "-1")
    assert "min_score must be" in fails(flights[0], "-o", out, *wrong)
    assert "min_z must be" in fails(flights[0], "-o", out, "--detect", "rarity", *wrong)
    assert "cuda:7" in fails(flights[0], "-o", out, "--device", "cuda:7")


def test_flights_of_one_name_are_told_apart(tmp_path: Path) -> None:
    from hsvaos.evaluate.command import _names

    for name in ("x/flight", "y/flight", "z"):
        (tmp_path / name).mkdir(parents=True)
    paths = [tmp_path / name for name in ("x/flight", "y/flight", "z")]
    names = _names(paths)
    assert names[:2] == ["x/flight", "y/flight"]
    assert len(set(names)) == 3


@pytest.mark.slow
def test_ctrl_c_keeps_finished_flights(flights: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    third = few_photos(tmp_path / "c", 1)
    command = [sys.executable, "-m", "hsvaos", "evaluate", *flights, third, "-o", out]
    child = subprocess.Popen(
        [*map(str, command), "--mask", "rarity"], stderr=subprocess.PIPE, env=os.environ, text=True
    )
    deadline = time.monotonic() + 200
    while not (out / "flights" / "b.json").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=60)
    assert child.returncode == 130
    assert "2 of 3 flights are kept" in said
    assert "Traceback" not in said
    assert sorted(p.name for p in (out / "flights").iterdir()) == ["a.json", "b.json"]
    done = cli(*flights, third, "-o", out, "--mask", "rarity", "--json")
    assert [flight["kept"] for flight in json.loads(done.stdout)["flights"]] == [True, True, False]


@pytest.mark.slow
def test_simulated_flight_with_poses_of_its_log(tmp_path: Path) -> None:
    flight, out = tmp_path / "flight", tmp_path / "out"
    settings = SimulationSettings(
        forest=ForestSettings(seed=5, density=260.0, leaf_density=0.5),
        mission=Mission(photos=12),
        camera=Camera.from_fov(256, 256, 64.0),
        people=3,
        classes=("half", "open", "full"),
    )
    simulate_flight(settings, flight)
    found = {}
    for poses in (None, "poses_ekf.csv", "nav"):
        given = () if poses is None else ("--poses", poses)
        done = cli(flight / "flight.toml", "-o", out, "--mask", "rarity", "--json", *given)
        assert done.returncode == 0, done.stderr
        evaluation = json.loads(done.stdout)["evaluation"]
        assert evaluation["flights"][0]["views"] == 12
        found[poses] = evaluation["persons"][-1]
    # people belong to their groups by the true poses, whatever poses are tried
    assert found[None]["people"] == found["nav"]["people"] == 3
    assert max(row["found"] for row in found.values()) >= 1
