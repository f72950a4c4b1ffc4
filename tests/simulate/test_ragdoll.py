"""New poses by MuJoCo, where it is installed."""

from __future__ import annotations

import numpy as np
import pytest

from hsvaos.simulate.forest import ForestSettings, grow_forest
from hsvaos.simulate.people import lay_person, pose_library
from hsvaos.simulate.ragdoll import make_library, settle


def test_a_body_comes_to_lie_on_the_very_ground_it_falls_on() -> None:
    pytest.importorskip("mujoco", reason="extra sim is not installed")
    ground = grow_forest(ForestSettings(seed=4, density=0.0, half_m=14.0, relief_m=0.5)).ground
    for k in range(6):
        person = lay_person(k, ground, -5.0 + 2.0 * k, 3.0, 4, fresh=True)
        points = person.mesh.vertices() + person.place
        height = ground.down_at(points[:, 0], points[:, 1]) - points[:, 2]
        assert -0.15 < height.min() < 0.02
        assert height.max() < 1.0
        assert np.hypot(*np.ptp(person.outline[:, :2], axis=0)) > 0.8
        assert np.abs(person.outline[:, :2].mean(0) - [-5.0 + 2.0 * k, 3.0]).max() < 1.5


def test_the_shipped_library_is_what_the_script_makes() -> None:
    pytest.importorskip("mujoco", reason="extra sim is not installed")
    places, _ = pose_library()
    again = make_library(2, seed=7)
    # Bit for bit on the same MuJoCo; contacts may fall a little otherwise on another.
    np.testing.assert_allclose(again["places"], places[:2], atol=0.3)


def test_without_mujoco_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ValueError, match=r"pip install 'hsvaos\[sim\]'"):
        settle(np.zeros((41, 41)), [1])
