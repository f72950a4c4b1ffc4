"""Make the small flight that ships in the wheel for `hsvaos demo`.

    python bench/make_demo.py            writes hsvaos/data/demo_flight
    python bench/make_demo.py try 1 2 3  says how well the hidden person shows for some seeds

Seed and forest were chosen among some twenty tries: no photo that has the hidden person in the
middle third of its width and height but one shows a pixel of it, most others show none either, and
the integral of all shows it well enough to be found.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np

from hsvaos.camera import Camera
from hsvaos.kernels.device import quiet_start
from hsvaos.kernels.hue_mask import hue_masks
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.rarity import rarity_weights
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.photo import CameraEffects
from hsvaos.simulate.record import simulate_flight
from hsvaos.simulate.settings import SimulationSettings
from hsvaos.simulate.simulation import Simulation
from hsvaos.surface import FocalPlane

FOLDER = Path(__file__).parents[1] / "hsvaos" / "data" / "demo_flight"
SEED = 4
MOST_BYTES = 2_500_000


def settings(seed: int) -> SimulationSettings:
    return SimulationSettings(
        forest=ForestSettings(
            season="summer",
            seed=seed,
            density=380.0,
            leaf_density=0.7,
            relief_m=0.08,
            glades=0.0,
            cloud=0.4,
        ),
        mission=Mission(
            photos=30, photo_distance_m=3.0, strip_distance_m=5.0, speed_m_s=4.0, hover_s=4.0
        ),
        camera=Camera.from_fov(512, 512, 75.0),
        effects=CameraEffects(full_well=30000.0, defocus_px=0.5),
        people=2,
        classes=("full", "half"),
        clothes=("orange", "blue"),
        jpeg_quality=70,
    )


def central_fractions(simulation: Simulation, pixels: list[list[tuple[int, int]]]) -> list[float]:
    """Return the shown fraction of the first person in photos that have it near their centre."""
    person = simulation.cast.people[0]
    camera = simulation.camera
    shares = []
    for pose, counts in zip(simulation.poses, pixels, strict=True):
        pixel = camera.project((person.outline.mean(axis=0) - pose[:3, 3]) @ pose[:3, :3])
        middle = np.array([camera.cx, camera.cy])
        if np.abs(pixel - middle).max() < camera.width / 6:
            shares.append(counts[0][0] / max(counts[0][1], 1))
    return shares


def attempt(seed: int) -> None:
    from simulate_effect import contrast, person_regions

    simulation = Simulation(settings(seed))
    photos = [simulation.photo(k) for k in range(len(simulation.poses))]
    images = np.stack([p.image for p in photos])
    pixels = [p.people for p in photos]
    central = central_fractions(simulation, pixels)
    print(f"seed {seed}: visible {np.round(simulation.cast.visible, 3)}")
    print(f"  hidden person in {len(central)} photo centres, shown {np.round(central, 3)}")
    masks, _ = hue_masks(images)
    rare, _ = rarity_weights(images)
    for person in simulation.cast.people:
        view, body, ring = person_regions(person)
        plane = FocalPlane(float(person.place[2]) - 0.1)
        for name, weights in (("plain", None), ("hue", masks), ("rarity", rare)):
            integrator = Integrator(simulation.camera, images, simulation.poses, weights=weights)
            picture, footprint = integrator.integrate(view, plane)
            print("  ", person.asked, name,
                  contrast(np.asarray(picture), np.asarray(footprint), body, ring))  # fmt: skip


def make() -> None:
    shutil.rmtree(FOLDER, ignore_errors=True)
    simulate_flight(settings(SEED), FOLDER)
    total = sum(p.stat().st_size for p in FOLDER.rglob("*") if p.is_file())
    print(f"{FOLDER}: {total / 1e6:.2f} MB unpacked")


if __name__ == "__main__":
    quiet_start()
    if sys.argv[1:2] == ["try"]:
        for word in sys.argv[2:]:
            attempt(int(word))
    else:
        make()
