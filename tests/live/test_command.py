"""`hsvaos live` as users run it, the page that it serves, and the examples."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER
from hsvaos.formats.native_write import write_native
from hsvaos.report.figures import stretch
from hsvaos.viewer.stream import Shown, Stream
from tests.detect.nets import photo_net
from tests.test_cli import cli, fails

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight photos of the demo flight."""
    flight = hsvaos.open_flight(FOLDER).subset(range(8))
    folder = tmp_path_factory.mktemp("live") / "few"
    write_native(flight.replace(sensors={}), folder, images=list(flight.images()))
    return folder


def outcome(*args: object) -> dict[str, object]:
    done = cli("live", *args, "--no-show", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("view", ["moving", "fixed"])
def test_a_flight_is_played_and_its_last_picture_saved(
    few: Path, tmp_path: Path, view: str
) -> None:
    picture = tmp_path / "last.png"
    options = ("--rate", 4, "--window", 5, "--size", 96, "--view", view, "-o", picture)
    options += ("--mask", "none")
    said = outcome(few, *options)
    assert (said["arrived"], said["integrated"], said["window"]) == (8, 8, 5)
    assert said["latency"]["count"] == 8  # type: ignore[index]
    saved = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    assert saved.shape == (96, 96, 4)
    flight = hsvaos.open_flight(few)
    eye = flight.camera.without_distortion().scaled(96, 96)
    middle = flight.poses[7 if view == "moving" else flight.centre_index]
    last = np.stack(list(flight.images()))[3:]
    made = hsvaos.Integrator(flight.camera, last, flight.poses[3:])
    ground = hsvaos.FocalPlane(flight.ground_down_m or 0.0)
    expected = stretch(*made.integrate(hsvaos.VirtualCamera(eye, middle), ground))
    assert np.abs(saved[..., [2, 1, 0, 3]].astype(int) - expected).mean() < 0.5


def test_it_goes_round_for_as_long_as_it_is_told(few: Path) -> None:
    said = outcome(few, "--rate", 20, "--minutes", 0.03, "--size", 64, "--mask", "none")
    assert 30 <= int(said["arrived"]) <= 36  # 1.8 s of 20 a second: more than four rounds


def test_it_looks_for_people_beside(few: Path, tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(photo_net("yolov8"))
    settings = tmp_path / "settings.toml"
    settings.write_text(f'[detect]\nmodel = "{tmp_path / "net.onnx"}"\n')
    look = ("--detect-every", 4, "--settings", settings)
    said = outcome(few, "--rate", 5, "--size", 96, *look)
    assert int(said["detected"]) + int(said["detections_skipped"]) == 2
    assert int(said["detected"]) >= 1


def test_it_searches_beside_and_saves_who_was_found(few: Path, tmp_path: Path) -> None:
    saved = tmp_path / "found.geojson"
    options = ("--search", "--finds", saved, "--rate", 4, "--window", 6, "--mask", "none")
    said = outcome(few, *options)
    assert said["integrated"] == 8
    assert 1 <= int(said["detected"]) <= 8  # type: ignore[call-overload]
    assert int(said["detected"]) + int(said["detections_skipped"]) == 8  # type: ignore[call-overload]
    features = json.loads(saved.read_text(encoding="utf-8"))["features"]
    persons = said["persons"]
    assert isinstance(persons, list)
    assert [one["properties"] for one in features] == persons
    assert "expected --search" in fails("live", few, "--finds", saved, "--no-show")
    assert "ends .geojson" in fails("live", few, "--search", "--finds", tmp_path / "x.png")


def test_people_are_told_how_it_goes(few: Path) -> None:
    done = cli("live", few, "--rate", 2, "--size", 64, "--port", 0)
    assert done.returncode == 0, done.stderr
    assert "look at http://localhost:" in done.stderr.replace("127.0.0.1", "localhost")
    assert "latency p50 p95 p99" in done.stderr
    assert "8 photos came, 8 integrated, 0 dropped" in done.stdout


def test_ctrl_c_ends_it_with_the_summary(few: Path) -> None:
    command = [sys.executable, "-m", "hsvaos", "live", few, "--rate", "5", "--minutes", "5"]
    command += ["--no-show", "--size", "64"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as running:
        assert running.stderr is not None
        for line in running.stderr:
            if "latency" in line:
                break
        running.send_signal(signal.SIGINT)
        said, error = running.communicate(timeout=60)
    assert running.returncode == 0
    assert "stopped" in error
    assert "photos came" in said
    assert "Traceback" not in error


def test_a_sensor_log_places_the_photos() -> None:
    said = outcome(FOLDER, "--log-poses", "--speed", 6, "--size", 96, "--mask", "none")
    assert said["arrived"] == 30
    assert int(said["without_pose"]) + int(said["integrated"]) + int(said["dropped"]) == 30
    assert int(said["integrated"]) > 5  # once the heading had shown itself


def test_what_cannot_be_played_is_said_in_one_line(few: Path, tmp_path: Path) -> None:
    assert "a file that ends .png" in fails("live", few, "-o", tmp_path / "last.tiff")
    assert "speed" in fails("live", few, "--speed", -1)
    assert "--minutes" in fails("live", FOLDER, "--log-poses", "--minutes", 1, "--no-show")
    assert "--log-poses" in fails("live", FOLDER, "--log-poses", "--view", "fixed", "--no-show")
    bare = tmp_path / "bare"
    shutil.copytree(few, bare)
    toml = (bare / "flight.toml").read_text()
    lines = [line for line in toml.splitlines() if "ground_down_m" not in line]
    (bare / "flight.toml").write_text("\n".join(lines))
    assert "--focus-down" in fails("live", bare, "--no-show")
    poses = (bare / "poses.csv").read_text().splitlines()
    rows = [row.split(",") for row in poses]
    rows[1:] = [[row[0], "", *row[2:]] for row in rows[1:]]
    (bare / "poses.csv").write_text("\n".join(",".join(row) for row in rows))
    assert "--rate" in fails("live", bare, "--no-show", "--focus-down", 0)


@pytest.fixture
def stream() -> Iterator[tuple[Stream, dict[str, int]]]:
    state = {"number": -1}

    def draw() -> Shown:
        return Shown(np.full((8, 8, 3), 10 * state["number"], np.uint8), {"text": "as it goes"})

    made = Stream("a <b>", lambda: state["number"], draw, port=0)
    yield made, state
    made.close()


def get(stream: Stream, path: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection(stream.host, stream.port, timeout=60)
    connection.request("GET", path)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), content


def test_the_page_shows_each_new_picture_once(stream: tuple[Stream, dict[str, int]]) -> None:
    made, state = stream
    status, _, page = get(made, "/")
    assert status == 200
    assert b"a &lt;b&gt;" in page
    later = threading.Timer(0.2, lambda: state.update(number=3))
    later.start()
    status, headers, content = get(made, "/picture.jpg?after=-1")  # waits for the first
    assert status == 200
    assert json.loads(headers["X-Status"]) == {"number": 3, "text": "as it goes"}
    shown = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(shown.astype(int) - 30).max() <= 2
    later = threading.Timer(0.2, lambda: state.update(number=5))
    later.start()
    start = time.monotonic()
    status, headers, _ = get(made, "/picture.jpg?after=3")  # not the same again
    assert json.loads(headers["X-Status"])["number"] == 5
    assert time.monotonic() - start > 0.1
    assert get(made, "/picture.jpg?after=x")[0] == 400
    assert get(made, "/elsewhere")[0] == 404


def example(name: str, *args: object) -> str:
    command = [sys.executable, str(EXAMPLES / name), *map(str, args)]
    path = os.pathsep.join([str(EXAMPLES.parent), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, check=False, env=env
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_simulated_flight_example(tmp_path: Path) -> None:
    picture = tmp_path / "live.png"
    said = example("live_simulated.py", "--rate", 8, "--photos", 6, "-o", picture)
    assert "6 photos integrated, 0 dropped" in said
    assert cv2.imread(str(picture)).shape == (512, 512, 3)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """A film of the demo flight, ten pictures a second as if the drone flew that fast."""
    path = tmp_path_factory.mktemp("film") / "film.avi"
    flight = hsvaos.open_flight(FOLDER)
    small = (256, 256)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, small)
    assert writer.isOpened()
    for photo in flight.subset(range(12)).images():
        writer.write(cv2.resize(photo[..., ::-1], small, interpolation=cv2.INTER_AREA))
    writer.release()
    return path, flight.camera.fov_deg


def test_the_video_example_with_poses(film: tuple[Path, float], tmp_path: Path) -> None:
    rows = (FOLDER / "poses.csv").read_text().splitlines()
    timed = [row.split(",") for row in rows[1:12]]
    lines = [",".join([r[0], str(0.1 * i), *r[2:]]) for i, r in enumerate(timed)]
    (tmp_path / "poses.csv").write_text("\n".join([rows[0], *lines]))
    path, fov = film
    options = ("--poses", tmp_path / "poses.csv", "--fov", fov, "-o", tmp_path / "live.png")
    said = example("live_video.py", path, *options)
    assert "11 frames integrated, 0 dropped" in said
    assert "1 frames without a pose" in said  # the log ends before the film
    assert cv2.imread(str(tmp_path / "live.png")).shape == (512, 512, 3)


def test_the_video_example_with_a_log(film: tuple[Path, float], tmp_path: Path) -> None:
    path, fov = film
    options = ("--log", FOLDER, "--fov", fov, "--start", 40.0, "-o", tmp_path / "live.png")
    said = example("live_video.py", path, *options)
    assert "12 frames integrated" in said
    assert (tmp_path / "live.png").exists()
