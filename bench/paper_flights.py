"""The flights of the paper's experiment: seeds, seasons, and where they are kept.

    python bench/paper_flights.py FOLDER [--seeds 5]      simulates what is missing; resumable

Each flight: 117 photos of 1024 x 1024 (90 deg, 20 m) over the default forest, twelve people, three
of each occlusion class. The paper's fall forest is thin; ours is flown thin and closed. The seeds
are unseen: training draws from 100000 on, tuning from 900000 on (`train/flights.py`).
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from hsvaos.camera import Camera
from hsvaos.kernels.device import quiet_start
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.record import simulate_flight
from hsvaos.simulate.settings import SimulationSettings

FIRST_SEED = 710
PEOPLE = 12
FORESTS: dict[str, dict[str, object]] = {
    "summer": {"season": "summer"},
    "fall_thin": {"season": "fall", "leaf_density": 0.3},
    "fall_closed": {"season": "fall"},
    "snow": {"season": "snow"},
}


def settings_of(forest: str, seed: int, photos: int = 117, size: int = 1024) -> SimulationSettings:
    """Return what is flown."""
    return SimulationSettings(
        forest=ForestSettings(seed=seed, **FORESTS[forest]),  # type: ignore[arg-type]
        mission=Mission(photos=photos),
        camera=Camera.from_fov(size, size, 90.0),
        people=PEOPLE,
    )


def flight_folder(folder: Path, forest: str, seed: int) -> Path:
    return folder / f"{forest}_{seed}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    asked = parser.parse_args()
    quiet_start()
    for seed in range(asked.first, asked.first + asked.seeds):
        for forest in FORESTS:
            target = flight_folder(asked.folder, forest, seed)
            if target.exists():
                continue
            began = time.monotonic()
            simulate_flight(settings_of(forest, seed), target)
            print(f"{target.name}: {time.monotonic() - began:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
