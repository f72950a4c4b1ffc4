from __future__ import annotations

import pytest

from hsvaos.camera import Camera
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.settings import SimulationSettings
from hsvaos.simulate.simulation import Simulation

LENS = (-0.10, 0.02, 0.0015, -0.001, 0.0)


def small_settings(**changes: object) -> SimulationSettings:
    """A flight of six small photos with distortion, two people and some stakes."""
    base = Camera.from_fov(256, 256, 64.0)
    values: dict[str, object] = {
        "forest": ForestSettings(seed=5, density=260.0, leaf_density=0.5),
        "mission": Mission(photos=6, hover_s=1.0),
        "camera": Camera(256, 256, base.fx, base.fy, 126.0, 129.0, LENS),
        "people": 2,
        "classes": ("half", "full"),
        "stakes": 3,
    }
    return SimulationSettings(**{**values, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def simulation() -> Simulation:
    return Simulation(small_settings())
