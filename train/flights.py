"""Training flights: small simulated forests of every season with many people in them.

Seeds: training flights have seeds from `FIRST_TRAINING_SEED`, those for choosing epochs and
thresholds from `FIRST_TUNING_SEED`. Tests and tables use other seeds, which are thus unseen.
Crowns are thin or dense and glades small or large, so that people in the open are seen as well as
hidden ones. Where people lie is drawn blindly in the first flights; since three of four of those
whom photos reach are half hidden by crowns then, and hardly anyone lies under a bush, later ones
(`by_visibility`) draw it by how much of the ground the photos see. Tuning flights are searches: 117
photos, the simulator's forests of each season, and people of every occlusion class.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from hsvaos.camera import Camera
from hsvaos.simulate.clothes import OUTFITS
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.instances import Kind
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.photo import CameraEffects
from hsvaos.simulate.planting import stem_places
from hsvaos.simulate.record import simulate_flight
from hsvaos.simulate.settings import SimulationSettings
from hsvaos.simulate.simulation import Photo, Simulation
from train.places import blind_places, placed_by_visibility

FIRST_TRAINING_SEED = 101_000
FIRST_TUNING_SEED = 900_100

ON_PERSON, ON_GROUND = 255, 128
"""What labels say of a pixel."""

_GROUND = [int(kind) for kind in (Kind.GROUND, Kind.LITTER, Kind.WOOD, Kind.STAKE)]
_SEARCHED_FOR = 20
_BUSH_SHARE = 0.2
_THERMAL_SHARE = 0.14

_FIRST_BY_VISIBILITY = 101_448


def by_visibility(seed: int) -> bool:
    """Return whether people lie by classes in a training flight, and are as rare as in a search.

    Args:
        seed: Of the flight.
    """
    return _FIRST_BY_VISIBILITY <= seed < FIRST_TUNING_SEED


def flight_settings(seed: int) -> SimulationSettings:
    """Return what to simulate for a seed: everything is drawn from it.

    Args:
        seed: Of the flight.
    """
    drawn = _blind_settings(seed)
    return placed_by_visibility(drawn) if by_visibility(seed) else drawn


def is_thermal(seed: int) -> bool:
    """Return whether the photos of a training flight are thermal.

    Args:
        seed: Of the flight.
    """
    return _blind_settings(seed).thermal


def _blind_settings(seed: int) -> SimulationSettings:
    rng = np.random.default_rng([seed, 301])
    season = str(rng.choice(["summer", "fall", "snow"], p=[0.37, 0.37, 0.26]))
    density = rng.uniform(280.0, 620.0)
    leaves = np.exp(rng.uniform(np.log(0.15), np.log(1.2)))
    relief, glades = rng.uniform(0.1, 0.35), rng.uniform(0.0, 0.6)
    forest = ForestSettings(
        season=season,
        seed=seed,
        density=float(density),
        leaf_density=float(leaves),
        relief_m=float(relief),
        glades=float(glades),
        bushes=float(rng.uniform(60.0, 300.0)),
        sun_elevation_deg=float(rng.uniform(22.0, 65.0)),
        sun_azimuth_deg=float(rng.uniform(0.0, 360.0)),
        cloud=float(rng.choice([0.0, 0.0, rng.uniform(0.0, 1.0)])),
    )
    size = int(rng.choice([704, 832, 960, 1024]))
    mission = Mission(
        photos=int(rng.integers(30, 46)),
        height_m=float(rng.uniform(18.0, 23.0)),
        photo_distance_m=float(rng.uniform(3.8, 5.4)),
        strip_distance_m=float(rng.uniform(5.0, 8.4)),
    )
    half = np.array(mission.half_m) + 3.0
    places = blind_places(rng, half)
    bush = rng.uniform(size=len(places)) < _BUSH_SHARE
    drawn = SimulationSettings(
        forest=forest,
        mission=mission,
        camera=Camera.from_fov(size, size, float(rng.uniform(82.0, 92.0))),
        effects=CameraEffects(
            defocus_px=float(rng.uniform(0.25, 0.8)),
            exposure_ev=float(rng.uniform(-0.3, 0.3)),
            exposure_jitter_ev=float(rng.uniform(0.0, 0.12)),
        ),
        people=len(places),
        classes=tuple("bush" if under else "half" for under in bush),
        clothes=tuple(str(rng.choice(OUTFITS)) for _ in places),
        places=places,
        stakes=int(rng.choice([0, 0, 3])),
        thermal=bool(rng.uniform() < _THERMAL_SHARE),
        jpeg_quality=int(rng.integers(88, 98)),
    )
    return _with_room(drawn)


def _with_room(drawn: SimulationSettings) -> SimulationSettings:
    """Thin the forest until its stems find room beside the glades."""
    while True:
        try:
            stem_places(drawn.fitted().forest)
        except ValueError:
            forest = drawn.forest.replace(density=0.8 * drawn.forest.density)
            drawn = replace(drawn, forest=forest)
        else:
            return drawn


def search_settings(seed: int) -> SimulationSettings:
    """Return what to simulate for a search, by which the threshold is chosen.

    Args:
        seed: Of the flight; four in a row are summer, thin fall, closed fall and snow.
    """
    season, leaves = (("summer", 1.0), ("fall", 0.3), ("fall", 1.0), ("snow", 1.0))[seed % 4]
    return SimulationSettings(
        forest=ForestSettings(season=season, seed=seed, leaf_density=leaves),
        mission=Mission(photos=117),
        camera=Camera.from_fov(1024, 1024, 90.0),
        people=_SEARCHED_FOR,
    )


class Labelled(Simulation):
    """A simulation that writes down which pixels of each photo show the ground, or a person on it.

    Attributes:
        labels: Folder of the labels, see `labels_of`.
    """

    labels: Path

    def photo(self, index: int) -> Photo:
        """Take a photo and write its label."""
        photo = super().photo(index)
        shown = np.zeros_like(photo.kind)
        shown[np.isin(photo.kind, _GROUND)] = ON_GROUND
        shown[photo.kind == int(Kind.PERSON)] = ON_PERSON
        name = Path(self.names()[index]).stem
        cv2.imwrite(str(self.labels / f"{name}.png"), shown)
        return photo


def labels_of(flight: Path) -> Path:
    """Return the folder of a training flight's labels: a PNG a photo.

    Pixels are `ON_PERSON`, `ON_GROUND` (soil, litter, dead wood and what else lies there), or 0
    (crowns, trunks and bushes).

    Args:
        flight: The flight's folder.
    """
    return flight.parent / f"labels_{flight.name}"


def make_flight(seed: int, folder: Path) -> Path:
    """Simulate the flight of a seed below a folder, if it is not there yet.

    Args:
        seed: Of the flight; those for training get labels too.
        folder: Of all training flights.
    """
    target = folder / f"flight_{seed}"
    if not target.exists():
        if seed >= FIRST_TUNING_SEED:
            simulate_flight(search_settings(seed), target)
        else:
            settings = flight_settings(seed)
            simulation = Labelled(settings, measure=False)  # its places are given
            simulation.labels = labels_of(target)
            simulation.labels.mkdir(exist_ok=True)
            simulate_flight(settings, target, simulation=simulation)
    return target
