"""Whatever happens to the files of a flight: it opens, or a FlightError of one line says why."""

from __future__ import annotations

import contextlib
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hsvaos
from hsvaos.camera import Camera
from hsvaos.flight import Flight, FlightError, Frame
from hsvaos.formats.native_write import write_native
from hsvaos.formats.terrain import read_terrain

NOISE = np.random.default_rng(2).integers(0, 256, (6, 8, 3), dtype=np.uint8)
POISON = [b"", b"nan", b"-1", b"1e999", b"[", b'"', b"\xff", b"\0", b"\n", b",", b"true", b"{}"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A flight that is native and JKU's at once, as far as its files go."""
    folder = tmp_path_factory.mktemp("damage") / "flight"
    frames = tuple(Frame(f"{i}.png", Path(), np.eye(4), float(i)) for i in range(2))
    mounting = {"camera_lever_arm_m": [0.0, 0.0, 0.1]}
    flight = Flight("x", Camera.from_fov(8, 6, 50.0), frames, hsvaos.Origin(1, 2, 3), 0.0)
    write_native(flight.replace(sensors=mounting), folder, images=[NOISE] * 2)
    entries = [{"imagefile": f"{i}.png", "M3x4": np.eye(4)[:3].tolist()} for i in range(2)]
    (folder / "poses.json").write_text(json.dumps({"images": entries}))
    (folder / "mesh.obj").write_text("v 0 0 1\nv 3 0 1\nv 0 3 1\nf 1 2 3\n")
    np.savez(folder / "grid.npz", north_m=[0.0, 1.0], east_m=[0.0, 1.0], down_m=np.zeros((2, 2)))
    cv2.imwrite(str(folder / "dem.tif"), NOISE[..., 0].astype(np.float32))
    return folder


def damaged(whole, tmp_path_factory, name, at, length, poison):
    folder = tmp_path_factory.mktemp("damaged") / "flight"
    shutil.copytree(whole, folder)
    content = (whole / name).read_bytes()
    start = int(at * len(content))
    (folder / name).write_bytes(content[:start] + poison + content[start + length :])
    return folder


def opens_or_says_why(call):
    try:
        return call()
    except FlightError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) > 20
    return None


damage = (st.floats(0, 1), st.integers(0, 12), st.sampled_from(POISON))
plenty = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@plenty
@given(st.sampled_from(["flight.toml", "poses.csv", "images/0.png"]), *damage)
def test_native(whole, tmp_path_factory, name, at, length, poison):
    folder = damaged(whole, tmp_path_factory, name, at, length, poison)
    flight = opens_or_says_why(lambda: hsvaos.open_flight(folder))
    if flight is not None:
        with contextlib.suppress(FlightError):
            assert all(image.shape[:2] == (6, 8) for image in flight.images(workers=1))
    shutil.rmtree(folder)


@plenty
@given(*damage)
def test_jku(whole, tmp_path_factory, at, length, poison):
    folder = damaged(whole, tmp_path_factory, "poses.json", at, length, poison)
    opens_or_says_why(lambda: hsvaos.open_flight(folder, format="jku", fov_deg=40))
    shutil.rmtree(folder)


@plenty
@given(st.sampled_from(["mesh.obj", "grid.npz", "dem.tif"]), *damage)
def test_terrain(whole, tmp_path_factory, name, at, length, poison):
    folder = damaged(whole, tmp_path_factory, name, at, length, poison)
    opens_or_says_why(lambda: read_terrain(folder / name, hsvaos.Origin(1.0, 2.0, 3.0)))
    shutil.rmtree(folder)
