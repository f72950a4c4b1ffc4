"""Paces, paths between poses, and what of a flight's masks is used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import Camera, Flight, FlightError, Frame
from hsvaos.live.path import PosePath
from hsvaos.live.play import Pace
from hsvaos.nav.online import NoPoseError
from tests.kernels.strategies import random_pose, seeds


def flight(*times: float) -> Flight:
    frames = tuple(Frame(f"{i}.png", Path(f"{i}.png"), np.eye(4), t) for i, t in enumerate(times))
    return Flight("timed", Camera.from_fov(8, 8, 60.0), frames)


def test_photos_come_by_their_times_or_by_a_rate() -> None:
    made = flight(10.0, 10.5, 11.5, 12.0)
    np.testing.assert_allclose(Pace().offsets_s(made), [0.0, 0.5, 1.5, 2.0, 2.5])
    np.testing.assert_allclose(Pace(speed=2.0).offsets_s(made), [0.0, 0.25, 0.75, 1.0, 1.25])
    np.testing.assert_allclose(Pace(rate_hz=4.0).offsets_s(made), [0.0, 0.25, 0.5, 0.75, 1.0])
    landed = flight(0.0, 1.0, 4000.0, 4001.0)  # a change of battery is not waited for
    np.testing.assert_allclose(Pace().offsets_s(landed), [0.0, 1.0, 61.0, 62.0, 63.0])
    with pytest.raises(FlightError, match="give a rate"):
        Pace().offsets_s(flight(0.0, float("nan")))
    with pytest.raises(ValueError, match="rate_hz must be a positive"):
        Pace(rate_hz=0.0)


@given(seed=seeds, share=st.floats(0.0, 1.0))
def test_a_path_runs_straight_and_turns_evenly(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    a, b = random_pose(rng), random_pose(rng)
    path = PosePath([1.0, 3.0], [a, b])
    pose = path.at(1.0 + 2.0 * share)
    np.testing.assert_allclose(pose[:3, 3], (1 - share) * a[:3, 3] + share * b[:3, 3], atol=1e-9)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    angles = [
        np.arccos(np.clip((np.trace(x[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1)) for x in (a, b)
    ]
    whole = np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))
    assert angles[0] == pytest.approx(share * whole, abs=1e-5)
    assert angles[1] == pytest.approx((1 - share) * whole, abs=1e-5)


def test_a_path_bridges_no_gaps() -> None:
    poses = [np.eye(4)] * 3
    path = PosePath([0.0, 1.0, 20.0], poses)
    assert path.span == (0.0, 20.0)
    np.testing.assert_array_equal(path.at(20.0), np.eye(4))
    for t, said in ((-0.1, "outside"), (20.1, "outside"), (10.0, "gap of 19.0 s")):
        with pytest.raises(NoPoseError, match=said):
            path.at(t)
    with pytest.raises(ValueError, match="increasing times"):
        PosePath([1.0, 1.0], poses[:2])
    with pytest.raises(ValueError, match="world_from_camera"):
        PosePath([0.0, 1.0], [np.eye(4), 2 * np.eye(4)])
