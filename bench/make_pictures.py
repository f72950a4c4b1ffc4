"""Make the pictures of docs/: one simulated photo a season, a preview, a thermal photo.

python bench/make_pictures.py
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from hsvaos.camera import Camera
from hsvaos.kernels.device import quiet_start
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.record import preview
from hsvaos.simulate.settings import SimulationSettings
from hsvaos.simulate.simulation import Simulation

DOCS = Path(__file__).parents[1] / "docs"
SIZE = 768
MOST_BYTES = 290_000
CHOSEN = {"summer": (3, 5), "fall": (3, 5), "snow": (4, 3)}
"""Seed and photo of each season."""


def save(name: str, image: np.ndarray) -> None:
    pixels = image[..., ::-1] if image.ndim == 3 else image
    for quality in range(92, 40, -4):
        done, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if done and len(data) < MOST_BYTES:
            (DOCS / name).write_bytes(data.tobytes())
            print(f"{name}: {len(data) / 1e3:.0f} kB, quality {quality}")
            return
    raise ValueError(f"{name} does not fit into {MOST_BYTES} bytes")


def simulation(season: str, seed: int, *, thermal: bool = False) -> Simulation:
    return Simulation(
        SimulationSettings(
            forest=ForestSettings(season=season, seed=seed),
            mission=Mission(photos=30),
            camera=Camera.from_fov(SIZE, SIZE, 90.0),
            thermal=thermal,
        )
    )


if __name__ == "__main__":
    quiet_start()
    DOCS.mkdir(exist_ok=True)
    for season, (seed, photo) in CHOSEN.items():
        made = simulation(season, seed)
        save(f"simulated_{season}.jpg", made.photo(photo).image)
        if season == "fall":
            seen = [
                sum(
                    np.abs(pose[:2, 3] - person.place[:2]).max() < 16.0
                    for person in made.cast.people
                )
                for pose in made.poses
            ]
            save("simulated_preview.jpg", preview(made, int(np.argmax(seen))))
    made = simulation("summer", CHOSEN["summer"][0], thermal=True)
    save("simulated_thermal.jpg", made.photo(CHOSEN["summer"][1]).image)
