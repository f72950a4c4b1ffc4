"""Remake the person network: python -m train WORK [--flights 43] [--steps 2400]

Simulates the flights, integrates their maps, trains, chooses the threshold on tuning flights and
writes WORK/person.onnx and WORK/curve.csv. Every part goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from hsvaos.kernels.device import quiet_start
from train.flights import FIRST_TRAINING_SEED, FIRST_TUNING_SEED, make_flight
from train.maps import CONDITIONS, SEARCH_CONDITIONS, make_maps


def _prepare(job: tuple[int, Path, Path]) -> str:
    seed, flights, maps = job
    began = time.monotonic()
    quiet_start()
    flight = make_flight(seed, flights)
    search = seed >= FIRST_TUNING_SEED
    count = SEARCH_CONDITIONS if search else CONDITIONS
    done = [maps / f"{flight.name}_{k}.npz" for k in range(count)]
    if not all(path.exists() for path in done):
        make_maps(flight, maps, search=search)
    return f"{flight.name}: {time.monotonic() - began:.0f} s"


def _flights(first: int, count: int, flights: Path, maps: Path, workers: int) -> None:
    flights.mkdir(parents=True, exist_ok=True)
    maps.mkdir(parents=True, exist_ok=True)
    jobs = [(first + k, flights, maps) for k in range(count)]
    with ProcessPoolExecutor(workers) as pool:
        for number, line in enumerate(pool.map(_prepare, jobs)):
            print(f"[{number + 1}/{count}] {line}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m train", description=__doc__)
    parser.add_argument("work", type=Path, help="folder for everything; some 12 GB")
    parser.add_argument("--flights", type=int, default=43)
    parser.add_argument("--tuning", type=int, default=4)
    parser.add_argument("--steps", type=int, default=2400)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--start-from", type=Path, help="an exported network to train further")
    parser.add_argument("--rate", type=float, default=2e-3, help="highest learning rate")
    parser.add_argument("--seed", type=int, default=1, help="of first weights and of crops")
    asked = parser.parse_args()
    work = asked.work
    print("flights and maps for training", flush=True)
    maps, tuning = work / "maps", work / "tuning_maps"
    _flights(FIRST_TRAINING_SEED, asked.flights, work / "flights", maps, asked.workers)
    print("flights and maps for tuning", flush=True)
    _flights(FIRST_TUNING_SEED, asked.tuning, work / "tuning_flights", tuning, asked.workers)
    return train(work, maps, tuning, asked)


def train(work: Path, maps: Path, tuning: Path, asked: argparse.Namespace) -> int:
    """Fit, choose the threshold, export."""
    from train.export import export
    from train.fit import BATCH, Crops, fit
    from train.judge import judge, threshold

    held_out = sorted(tuning.glob("*.npz"))
    net = fit(
        partial(Crops, maps),
        work,
        steps=asked.steps,
        seed=asked.seed,
        tune=judge(held_out),
        workers=max(1, asked.workers - 1),
        start_from=asked.start_from,
        rate=asked.rate,
    )
    figures = judge(held_out)(net)
    score = threshold(net, held_out)
    story = {
        "recipe": "python -m train",
        "training_seeds": _seeds(maps),
        "tuning_seeds": _seeds(tuning),
        "steps": asked.steps,
        "crops": asked.steps * BATCH,
        "started_from": asked.start_from.name if asked.start_from else "new weights",
        "tuning": figures,
    }
    export(net, work / "person.onnx", score, story)
    print(f"{work / 'person.onnx'}: threshold {score:.3f}, {figures}", flush=True)
    return 0


def _seeds(maps: Path) -> str:
    seeds = sorted({int(path.stem.split("_")[1]) for path in maps.glob("*_0.npz")})
    jumps = np.flatnonzero(np.diff(seeds) != 1)
    starts = [seeds[0], *(seeds[k + 1] for k in jumps)]
    ends = [*(seeds[k] for k in jumps), seeds[-1]]
    return ", ".join(f"{a}-{b}" for a, b in zip(starts, ends, strict=True))


if __name__ == "__main__":
    sys.exit(main())
