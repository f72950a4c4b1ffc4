"""The command line as a user meets it: outcomes, and bad input in one clear line."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.formats.native_write import write_native
from tests.planes import planes_flight


def cli(*args: object, timeout: float = 300.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hsvaos", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)


@pytest.fixture(scope="module")
def flight_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo flight with every fifth photo only: small, but real enough to run."""
    flight, photos, truth = planes_flight()
    few = list(range(0, len(flight), 5))
    images = [photo for i, photo in enumerate(photos) if i in few]
    folder = tmp_path_factory.mktemp("flights") / "small"
    write_native(flight.subset(few), folder, images=images, truth=truth)
    return folder


@pytest.fixture
def flight_copy(flight_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(flight_folder, tmp_path / "flight"))


def fails(*args: object) -> str:
    """Run a command that must end in one clear line and exit code 2."""
    done = cli(*args)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, done.stderr
    return lines[0]


def test_help_is_quick_and_names_the_commands() -> None:
    before = os.times()
    done = cli("--help")
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user
    spent -= before.children_system
    assert done.returncode == 0
    for command in (
        "demo",
        "run",
        "sweep",
        "detect",
        "nav",
        "simulate",
        "info",
        "convert",
        "doctor",
    ):
        assert command in done.stdout
    assert spent < 2.0  # 0.2 s on a quiet machine; the limit is for loaded ones
    loaded = subprocess.run(
        [sys.executable, "-c", "import hsvaos.cli, sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert not {"warp", "numpy", "cv2", "onnxruntime"} & set(loaded)


def test_demo_runs_from_log_to_report(tmp_path: Path) -> None:
    done = cli("demo", "-o", tmp_path / "demo", "--json")
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["frames"] == 30
    assert len(outcome["persons"]) == 1
    assert (tmp_path / "demo" / "report.html").stat().st_size > 0


def test_run_writes_the_folder_and_json(flight_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = cli("run", flight_folder, "-o", out, "--json")
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert done.stderr == ""
    assert outcome["frames"] == 6
    for name in (
        "integral.png",
        "integral.npz",
        "detections.json",
        "detections.geojson",
        "settings.toml",
        "report.html",
    ):
        assert (out / name).stat().st_size > 0
        assert name in outcome["files"]
    stored = np.load(out / "integral.npz")
    assert stored["image"].dtype == stored["footprint"].dtype == np.float32
    assert np.isfinite(stored["image"]).all()
    picture = cv2.imread(str(out / "integral.png"), cv2.IMREAD_UNCHANGED)
    assert ((picture[..., 3] == 0) == (stored["footprint"] == 0)).all()
    found = json.loads((out / "detections.json").read_text())
    assert found["views"][0]["frame"] == outcome["frame"]
    # the settings that were written make the same picture again
    again = tmp_path / "again"
    done = cli("run", flight_folder, "-o", again, "--settings", out / "settings.toml", "--json")
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(np.load(again / "integral.npz")["image"], stored["image"])


def test_every_mask_and_view(flight_folder: Path, tmp_path: Path) -> None:
    for mask in ("rarity", "anomaly", "none"):
        done = cli("run", flight_folder, "-o", tmp_path / mask, "--mask", mask, "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["mask"]["method"] == mask
    done = cli("run", flight_folder, "-o", tmp_path / "all", "--view", "all", "--json")
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "all" / "views").glob("*.png"))) == 6
    views = json.loads((tmp_path / "all" / "detections.json").read_text())["views"]
    assert len(views) == 6
    (tmp_path / "all" / "views" / "mine.txt").write_text("keep")
    done = cli("run", flight_folder, "-o", tmp_path / "all", "--json")  # no mix of two runs
    assert [p.name for p in (tmp_path / "all" / "views").iterdir()] == ["mine.txt"]
    done = cli("run", flight_folder, "-o", tmp_path / "few", "--view", "cover", "--json")
    assert done.returncode == 0, done.stderr
    views = json.loads((tmp_path / "few" / "detections.json").read_text())["views"]
    assert len(list((tmp_path / "few" / "views").glob("*.png"))) == len(views) < 6
    done = cli("run", flight_folder, "-o", tmp_path / "grid", "--view", "ortho", "--gsd", 0.1)
    assert done.returncode == 0, done.stderr
    assert "report.html" in done.stdout


def test_plain_integral_is_the_plain_mean(flight_folder: Path, tmp_path: Path) -> None:
    done = cli("run", flight_folder, "-o", tmp_path / "o", "--mask", "none", "--json")
    stored = np.load(tmp_path / "o" / "integral.npz")
    flight = hsvaos.open_flight(flight_folder)
    integrator = hsvaos.Integrator(flight.camera, np.stack(list(flight.images())), flight.poses)
    view = flight.view(flight.index(json.loads(done.stdout)["frame"]))
    image, footprint = integrator.integrate(view, hsvaos.FocalPlane(0.0))
    np.testing.assert_array_equal(stored["image"], image)
    np.testing.assert_array_equal(stored["footprint"], footprint)


def test_sweep_info_convert_doctor(flight_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    args = ("--from", -4, "--to", 2, "--steps", 5, "--size", 128)
    done = cli("sweep", flight_folder, "-o", out, *args, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["downs_m"] == [-4.0, -2.5, -1.0, 0.5, 2.0]
    assert len(list(out.glob("plane_*.png"))) == 5
    assert len((out / "focus.csv").read_text().splitlines()) == 6
    assert "plane_0004.png" in (out / "sweep.html").read_text()

    done = cli("info", flight_folder, "--json")
    assert json.loads(done.stdout)["photos"] == 6

    done = cli("convert", flight_folder, "-o", tmp_path / "copy")
    assert done.returncode == 0, done.stderr
    assert len(hsvaos.open_flight(tmp_path / "copy")) == 6

    done = cli("doctor", "--json")
    assert json.loads(done.stdout)["versions"]["hsvaos"] == hsvaos.__version__


def test_missing_and_empty_folder(tmp_path: Path) -> None:
    assert "no such folder" in fails("run", tmp_path / "nowhere", "-o", tmp_path / "out")
    assert "no known flight" in fails("run", tmp_path, "-o", tmp_path.parent / "out")


def test_no_poses(flight_copy: Path, tmp_path: Path) -> None:
    (flight_copy / "poses.csv").unlink()
    assert "poses" in fails("run", flight_copy, "-o", tmp_path / "out")


def test_absent_images_are_counted(flight_copy: Path, tmp_path: Path) -> None:
    images = sorted((flight_copy / "images").iterdir())
    images[0].unlink()
    done = cli("run", flight_copy, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["frames"] == 5
    assert any(images[0].name in note for note in outcome["notes"])
    for image in images[1:]:
        image.unlink()
    assert "error: " in fails("run", flight_copy, "-o", tmp_path / "out2")


def test_truncated_and_unreadable_images_are_left_out(flight_copy: Path, tmp_path: Path) -> None:
    images = sorted((flight_copy / "images").iterdir())
    images[1].write_bytes(images[1].read_bytes()[:-2000])
    images[2].write_bytes(b"this is no picture")
    done = cli("run", flight_copy, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["frames"] == 4
    notes = " ".join(outcome["notes"])
    assert images[1].name in notes
    assert images[2].name in notes


def test_image_of_another_size_is_left_out(flight_copy: Path, tmp_path: Path) -> None:
    odd = sorted((flight_copy / "images").iterdir())[3]
    cv2.imwrite(str(odd), np.zeros((100, 100, 3), np.uint8))
    done = cli("run", flight_copy, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["frames"] == 5
    assert any(odd.name in note for note in outcome["notes"])


@pytest.mark.parametrize("bad", ["nan", "7.0"])
def test_bad_pose_is_named(flight_copy: Path, tmp_path: Path, bad: str) -> None:
    path = flight_copy / "poses.csv"
    lines = path.read_text().splitlines()
    fields = lines[2].split(",")
    fields[5] = bad  # qw: neither NaN nor a quaternion of length 7 is a rotation
    path.write_text("\n".join([*lines[:2], ",".join(fields), *lines[3:]]) + "\n")
    done = cli("run", flight_copy, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert outcome["frames"] == 5
    assert any(fields[0] in note for note in outcome["notes"])


def test_camera_without_intrinsics(flight_copy: Path, tmp_path: Path) -> None:
    path = flight_copy / "flight.toml"
    kept = [
        line
        for line in path.read_text().splitlines()
        if not line.startswith(("fx", "fy", "cx", "cy", "fov", "distortion"))
    ]
    path.write_text("\n".join(kept))
    message = fails("run", flight_copy, "-o", tmp_path / "out")
    assert "--fov" in message or "fov_deg" in message


def test_focus_mistakes(flight_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert "above all" in fails("run", flight_folder, "-o", out, "--focus-down", -500)
    assert "only one of" in fails("run", flight_folder, "-o", out, "--focus-down", 0, "--autofocus")
    assert "no such terrain" in fails("run", flight_folder, "-o", out, "--terrain", "none.tif")
    assert not (out / "report.html").exists()


def test_view_mistakes(flight_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert "no frame called" in fails("run", flight_folder, "-o", out, "--view", "x.jpg")
    assert "million pixels" in fails(
        "run", flight_folder, "-o", out, "--view", "ortho", "--gsd", 0.0001
    )
    assert "view.gsd_m must be" in fails("run", flight_folder, "-o", out, "--gsd", -1)


def test_view_that_sees_nothing(flight_copy: Path, tmp_path: Path) -> None:
    path = flight_copy / "poses.csv"
    lines = path.read_text().splitlines()
    fields = lines[1].split(",")
    fields[2] = "100000"  # far away from the ground that the others see, looking up
    fields[5:9] = ["0", "1", "0", "0"] if fields[5] != "0" else ["0", "0", "1", "0"]
    path.write_text("\n".join([lines[0], ",".join(fields), *lines[2:]]) + "\n")
    pose = hsvaos.open_flight(flight_copy).poses[0]
    if pose[2, 2] > 0:  # optical axis still falls: turn the camera over
        fields[5:9] = ["1", "0", "0", "0"]
    message = fails("run", flight_copy, "-o", tmp_path / "out", "--view", fields[0])
    assert "sees the focal surface" in message


def test_all_masked(flight_folder: Path, tmp_path: Path) -> None:
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((512, 512), np.uint8))
    message = fails("run", flight_folder, "-o", tmp_path / "out", "--frame-mask", black)
    assert "black.png: the user masks ignore every pixel" in message


def test_cut_that_would_take_every_hue_is_not_made(flight_folder: Path, tmp_path: Path) -> None:
    done = cli("run", flight_folder, "-o", tmp_path / "out", "--sigmas", 1e6)
    assert done.returncode == 0, done.stderr
    assert "hue says nothing in 6 of 6 photos" in " ".join(done.stderr.split())


def test_out_not_writable(flight_folder: Path, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert str(blocked) in fails("run", flight_folder, "-o", blocked)
    assert blocked.read_text() == "in the way"


def test_device_that_is_not_there(flight_folder: Path, tmp_path: Path) -> None:
    message = fails("run", flight_folder, "-o", tmp_path / "out", "--device", "cuda:77")
    assert "cuda:77" in message


def test_bad_settings_file(flight_folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("[mask]\nsigma = 3\n")
    message = fails("run", flight_folder, "-o", tmp_path / "out", "--settings", path)
    assert "no key 'sigma'" in message
    assert "s.toml" in message
    message = fails("run", flight_folder, "-o", tmp_path / "o", "--settings", tmp_path / "gone")
    assert "gone" in message


def test_sweep_that_runs_upwards(flight_folder: Path, tmp_path: Path) -> None:
    message = fails("sweep", flight_folder, "-o", tmp_path / "o", "--from", 2, "--to", -2)
    assert "downwards" in message


def test_ctrl_c_leaves_no_half_file(flight_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "hsvaos", "run", str(flight_folder), "-o", str(out)]
    process = subprocess.Popen(
        [*command, "--view", "all"], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    for line in process.stderr:  # the first picture of a view follows this stage
        if "integrating" in line:
            break
    time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 130, rest
    assert "Traceback" not in rest
    assert not (out / "report.html").exists()
    for picture in out.rglob("*.png"):
        assert cv2.imread(str(picture)) is not None
    assert all(p.suffix in (".png", ".txt") for p in out.rglob("*") if p.is_file())
