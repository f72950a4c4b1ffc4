"""Poses of a file, of a trajectory and of the log, and which file a flight gets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER
from hsvaos.evaluate.poses import open_posed, own_file
from hsvaos.flight import FlightError
from hsvaos.formats.sensor_log import sensor_log_of
from hsvaos.formats.trajectory_csv import write_trajectory
from hsvaos.nav.photos import poses_at_photos


def test_own_poses_and_those_of_a_file() -> None:
    own, file = open_posed(FOLDER, None), open_posed(FOLDER, FOLDER / "poses_ekf.csv")
    np.testing.assert_array_equal(own.poses, hsvaos.open_flight(FOLDER).poses)
    assert 1e-4 < np.abs(own.poses - file.poses).max() < 1.0


def test_a_trajectory_gives_the_poses_that_the_log_gives(tmp_path: Path) -> None:
    unposed = open_posed(FOLDER, Path("nav"))
    assert not unposed.has_poses  # a run estimates them
    trajectory = hsvaos.estimate_trajectory(sensor_log_of(unposed))
    from_log = poses_at_photos(unposed, trajectory)
    path = tmp_path / "trajectory.csv"
    write_trajectory(path, trajectory, 50.0)
    along = open_posed(FOLDER, path)
    np.testing.assert_allclose(along.poses[:, :3, 3], from_log.poses[:, :3, 3], atol=1e-3)
    np.testing.assert_allclose(along.poses[:, :3, :3], from_log.poses[:, :3, :3], atol=1e-4)
    rows = path.read_text().splitlines(keepends=True)
    times = [frame.t_s for frame in along.frames]
    half = [row for row in rows[1:] if float(row.split(",")[0]) < np.median(times)]
    path.write_text("".join([rows[0], *half]))
    short = open_posed(FOLDER, path)
    assert len(short) == len(along) // 2
    assert any("outside the trajectory" in note for note in short.notes)
    path.write_text("".join(rows[:3]))
    with pytest.raises(FlightError, match="no photo lies within the trajectory"):
        open_posed(FOLDER, path)
    path.write_text("".join([rows[0], rows[2], rows[1]]))
    with pytest.raises(FlightError, match="rising order"):
        open_posed(FOLDER, path)
    path.write_text("".join(rows[:2]))
    with pytest.raises(FlightError, match="at least 2 rows"):
        open_posed(FOLDER, path)


def test_the_log_must_be_there(tmp_path: Path) -> None:
    for name in ("flight.toml", "poses.csv", "truth.json"):
        text = (FOLDER / name).read_text()
        (tmp_path / name).write_text(text.partition("[nav]")[0] if name == "flight.toml" else text)
    (tmp_path / "images").symlink_to(FOLDER / "images")
    with pytest.raises(FlightError, match="no sensor log"):
        open_posed(tmp_path, Path("nav"))


def test_which_file_a_flight_gets(tmp_path: Path) -> None:
    (tmp_path / "p.csv").touch()
    inside, outside = Path("p.csv"), tmp_path / "p.csv"
    assert own_file(tmp_path, inside, False, "poses") == outside
    assert own_file(tmp_path, inside, True, "poses") == outside
    assert own_file(FOLDER, outside, True, "poses") == outside
    with pytest.raises(FlightError, match="one file for several flights"):
        own_file(tmp_path, outside, False, "poses")
    with pytest.raises(FlightError, match=r"must lie in the folder of each"):
        own_file(FOLDER, Path("nothing.csv"), False, "poses")
    with pytest.raises(FlightError, match=r"nothing\.csv: no such file \(given as poses\)$"):
        own_file(FOLDER, Path("nothing.csv"), True, "poses")
