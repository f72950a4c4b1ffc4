"""A real Ctrl-C in mid-flight, and the same flight from other processes and thread counts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROGRAM = """
import typer
from hsvaos.simulate.command import simulate
app = typer.Typer()
app.command()(simulate)
app()
"""
WORDS = [
    "--photos", "24", "--size", "320", "--fov", "60", "--density", "200", "--people", "1",
    "--classes", "half", "--seed", "2",
]  # fmt: skip


def start(target: Path, threads: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *WORDS, "-o", str(target)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "HSVAOS_THREADS": str(threads)},
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


@pytest.mark.slow
def test_ctrl_c_leaves_whole_photos_and_the_rerun_gives_the_same_flight(tmp_path: Path) -> None:
    whole = start(tmp_path / "a" / "flight", 1)
    assert whole.wait(300) == 0
    target = tmp_path / "b" / "flight"
    workshop = target.with_name(".flight.simulating")
    stopped = start(target, 2)
    deadline = time.monotonic() + 200
    while len(list(workshop.glob("photo_*.jpg"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.01)
    stopped.send_signal(signal.SIGINT)
    assert stopped.wait(60) != 0
    kept = list(workshop.glob("photo_*.jpg"))
    assert 3 <= len(kept) < 24
    assert not target.exists()
    assert not list(workshop.glob("*.part"))
    assert start(target, 2).wait(300) == 0
    assert not workshop.exists()
    first, second = contents(tmp_path / "a" / "flight"), contents(target)
    assert first.keys() == second.keys()
    for name, data in first.items():
        if name != "truth_terrain.npz":  # a zip file bears its time
            assert second[name] == data, name
