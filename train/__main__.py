"""Remake the networks for colour: python -m train WORK [--flights 43] [--steps 2400]

Simulates the flights, trains the network that looks at single photos, integrates the flights' maps
with what it sees, trains the one that looks at those, chooses the threshold on tuning flights and
writes WORK/fragments.onnx, WORK/person.onnx and their curves. Every part goes on where it was
stopped.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

from hsvaos.kernels.device import quiet_start
from train.flights import FIRST_TRAINING_SEED, FIRST_TUNING_SEED, is_thermal
from train.fragment_crops import make_crops
from train.stages import each, flight_stage, maps_stage

FOLDS = 2
"""Evidence in a training map comes from a network that never saw the flight: by seed, even or odd.
Else it would be surer there than it ever is in use, and be trusted too much."""

_LEFT_FOR_LOSS = 2
"""Flights on which the fragment network's loss is measured."""


def _crops(flights: Path, crops: Path, seed: int) -> str:
    quiet_start()
    flight, target = flights / f"flight_{seed}", crops / f"flight_{seed}.npz"
    if not target.exists() and not is_thermal(seed):
        make_crops(flight, target)
    return flight.name


def train_fragments(work: Path, crops: Path, steps: int) -> tuple[Path, list[Path]]:
    """Train the network of single photos, and one for each half of the flights.

    Args:
        work: Folder for the networks.
        crops: Of the crops of all flights.
        steps: Batches for the first; the others get half as many.

    Returns:
        The network, and those for maps of flights of even and of odd seeds, which saw the others.
    """
    from train.fragment_crops import read_crops
    from train.fragment_fit import fit_fragments, loss_on
    from train.fragment_net import export_fragments

    paths = sorted(p for p in crops.glob("flight_*.npz") if ".part." not in p.name)
    parities = [[p for p in paths if int(p.stem.split("_")[1]) % FOLDS == k] for k in range(FOLDS)]
    jobs = [("fragments", paths[_LEFT_FOR_LOSS:], paths[:_LEFT_FOR_LOSS], steps)]
    jobs += [
        (f"fragments_for_{k}", parities[1 - k], parities[k][:_LEFT_FOR_LOSS], steps // 2)
        for k in range(FOLDS)
    ]
    made = []
    for name, own, others, count in jobs:
        target = work / f"{name}.onnx"
        made.append(target)
        if target.exists():
            continue
        model = fit_fragments(own, others, work / name, steps=count)
        loss = loss_on(model, [read_crops(path) for path in others])
        story = {"recipe": "python -m train", "steps": count, "flights": len(own), "loss": loss}
        export_fragments(model, target, story)
    return made[0], made[1:]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m train", description=__doc__)
    parser.add_argument("work", type=Path, help="folder for everything; some 14 GB")
    parser.add_argument("--flights", type=int, default=43)
    parser.add_argument("--first", type=int, default=FIRST_TRAINING_SEED, help="seed of the first")
    parser.add_argument("--tuning", type=int, default=4)
    parser.add_argument("--steps", type=int, default=2400)
    parser.add_argument("--fragment-steps", type=int, default=3000)
    parser.add_argument(
        "--fragments", type=Path, help="a network of fragments that saw none of these flights"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--start-from", type=Path, help="an exported network to train further")
    parser.add_argument(
        "--keep", type=float, default=0.0, help="share of that network's weights that stays"
    )
    parser.add_argument("--rate", type=float, default=2e-3, help="highest learning rate")
    parser.add_argument("--seed", type=int, default=1, help="of first weights and of crops")
    asked = parser.parse_args()
    if not FIRST_TRAINING_SEED <= asked.first <= FIRST_TUNING_SEED - asked.flights:
        parser.error(f"--first: expected {FIRST_TRAINING_SEED} or more, got {asked.first}")
    if not 0.0 <= asked.keep < 1.0 or (asked.keep and asked.start_from is None):
        parser.error(f"--keep: expected 0 to 1, with --start-from, got {asked.keep:g}")
    work = asked.work
    names = ("flights", "tuning_flights", "crops", "maps", "tuning_maps")
    flights, searches, crops, maps, tuning = (work / name for name in names)
    for folder in (flights, searches, crops, maps, tuning):
        folder.mkdir(parents=True, exist_ok=True)
    seeds = range(asked.first, asked.first + asked.flights)
    tuning_seeds = range(FIRST_TUNING_SEED, FIRST_TUNING_SEED + asked.tuning)
    each("flights", partial(flight_stage, flights), seeds, asked.workers)
    each("tuning flights", partial(flight_stage, searches), tuning_seeds, asked.workers)
    net, halves = asked.fragments, [asked.fragments]
    if net is None:
        each("crops of photos", partial(_crops, flights, crops), seeds, asked.workers)
        net, halves = train_fragments(work, crops, asked.fragment_steps)
    each("maps", partial(maps_stage, flights, maps, halves), seeds, asked.workers)
    each("tuning maps", partial(maps_stage, searches, tuning, [net]), tuning_seeds, asked.workers)
    return train(work, maps, tuning, asked)


def train(work: Path, maps: Path, tuning: Path, asked: argparse.Namespace) -> int:
    """Fit, choose the threshold, export."""
    from train.fit import Crops
    from train.judge import from_maps
    from train.person import make_person

    held_out = partial(from_maps, sorted(tuning.glob("*.npz")))
    folders = maps, tuning
    return make_person(asked, "python -m train", partial(Crops, maps), work, held_out, folders)


if __name__ == "__main__":
    sys.exit(main())
