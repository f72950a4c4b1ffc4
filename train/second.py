"""Remake the network of the second look: python -m train.second WORK [--flights 158] [--steps 2600]

Simulates flights that neither the person network nor that of fragments has seen, integrates their
maps, lets the person network look at them, trains on what it found, right and wrong, brings the
scores to the person network's threshold by the tuning flights, and writes WORK/second_look.onnx and
curves. Flights, maps and looks that are there are not made again.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path

from hsvaos.detect.fragments import PACKAGED_FRAGMENTS
from hsvaos.detect.network import Network
from hsvaos.detect.yolo import PACKAGED, Detector
from hsvaos.kernels.device import quiet_start
from train.flights import FIRST_TRAINING_SEED, FIRST_TUNING_SEED, is_thermal
from train.looks import Look, make_look, read_look
from train.stages import each, flight_stage, maps_stage, seeds_of
from train.teacher import teach

_FOR_MOMENTS = 8
"""Batches on which the layers of a network that is brought back are measured."""


def _looks(maps: Path, looks: Path, first: Path, as_found: bool, seed: int) -> str:
    quiet_start()
    network = Network(first, threads=1)
    for path in sorted(maps.glob(f"flight_{seed}_[0-9].npz")):
        if not list(looks.glob(f"{path.stem}*.npz")):
            make_look(path, looks, network, as_found=as_found)
    return f"flight_{seed}"


def _taught(looks: Path, teacher: Path, seed: int) -> str:
    quiet_start()
    for path in sorted(looks.glob(f"flight_{seed}_[0-9].npz")):
        teach(path, teacher)
    return f"flight_{seed}"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m train.second", description=__doc__)
    parser.add_argument("work", type=Path, help="folder for everything; some 50 GB")
    parser.add_argument("--flights", type=int, default=158, help="seeds; thermal ones are left out")
    parser.add_argument("--first", type=int, default=101_083, help="seed of the first")
    parser.add_argument("--tuning", type=int, default=9)
    parser.add_argument("--steps", type=int, default=2600)
    parser.add_argument("--fragments", type=Path, default=PACKAGED_FRAGMENTS)
    parser.add_argument("--person", type=Path, default=PACKAGED, help="the first network")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rate", type=float, default=2e-3, help="highest learning rate")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2], help="one a network")
    parser.add_argument("--start-from", type=Path, help="a second look to be trained further")
    parser.add_argument(
        "--keep", type=float, default=0.0, help="share of its weights that stays as it was"
    )
    parser.add_argument(
        "--earlier", type=Path, help="an earlier second look, to be asked beside the new one"
    )
    parser.add_argument(
        "--teacher", type=Path, help="an earlier second look, to learn from; that of --earlier"
    )
    parser.add_argument(
        "--weights", type=float, nargs="+", help="of each new network; all alike by default"
    )
    parser.add_argument(
        "--ask-first", type=float, default=0.0, help="share of the first network's opinion"
    )
    asked = parser.parse_args()
    asked.teacher = asked.teacher or asked.earlier
    asked.weights = asked.weights or [1.0] * len(asked.seeds)
    if not FIRST_TRAINING_SEED <= asked.first <= FIRST_TUNING_SEED - asked.flights:
        parser.error(f"--first: expected {FIRST_TRAINING_SEED} or more, got {asked.first}")
    if len(asked.weights) != len(asked.seeds) or min(asked.weights) <= 0.0:
        parser.error(f"--weights: expected {len(asked.seeds)} above 0, got {asked.weights}")
    if not 0.0 <= asked.keep < 1.0 or (asked.keep and asked.start_from is None):
        parser.error(f"--keep: expected 0 to 1, with --start-from, got {asked.keep:g}")
    if not 0.0 <= asked.ask_first < 1.0:
        parser.error(f"--ask-first: expected 0 to 1, got {asked.ask_first:g}")
    if asked.start_from is not None:
        from train.warm import stored_seconds

        held = len(stored_seconds(asked.start_from))
        if held != len(asked.seeds):
            parser.error(f"--seeds: expected {held}, one a network of the file, got {asked.seeds}")
    seeds = [
        seed for seed in range(asked.first, asked.first + asked.flights) if not is_thermal(seed)
    ]
    tuning = list(range(FIRST_TUNING_SEED, FIRST_TUNING_SEED + asked.tuning))
    looks = _prepared(asked, "", seeds), _prepared(asked, "tuning_", tuning)
    if asked.teacher is not None:
        each("teacher", partial(_taught, looks[0], asked.teacher), seeds, asked.workers)
    return train(asked, *looks)


def _prepared(asked: argparse.Namespace, kind: str, seeds: list[int]) -> Path:
    names = ("flights", "maps", "looks")
    flights, maps, looks = (asked.work / f"{kind}{name}" for name in names)
    for folder in (flights, maps, looks):
        folder.mkdir(parents=True, exist_ok=True)
    nets, as_found = [asked.fragments], bool(kind)
    parts: dict[str, Callable[[int], str]] = {
        "flights": partial(flight_stage, flights),
        "maps": partial(maps_stage, flights, maps, nets),
        "looks": partial(_looks, maps, looks, asked.person, as_found),
    }
    for name, part in parts.items():
        each(kind.replace("_", " ") + name, part, seeds, asked.workers)
    return looks


def read_looks(folder: Path) -> list[Look]:
    """Return all looks of a folder.

    Args:
        folder: Of looks.
    """
    return [read_look(path) for path in look_paths(folder)]


def look_paths(folder: Path) -> list[Path]:
    """Return the files of the looks of a folder, in order.

    Args:
        folder: Of looks.
    """
    return sorted(path for path in folder.glob("*.npz") if ".part." not in path.name)


def train(asked: argparse.Namespace, looks: Path, tuning: Path) -> int:
    """Fit, bring to the threshold, export.

    Args:
        asked: Of the command line.
        looks: Folder of what is learnt from.
        tuning: Folder of what is judged by.
    """
    from train.judge import figures_of
    from train.second_fit import Candidates, fit_second
    from train.second_judge import matched_again, threshold_shift
    from train.second_net import MeanOfNets, SecondNet, export_second
    from train.warm import blended_second, stored_seconds, unfolded_seconds

    held_out = read_looks(tuning)
    begun: list[SecondNet | None] = [None] * len(asked.seeds)
    if asked.start_from is not None:
        some = islice(Candidates(look_paths(looks), seed=0), _FOR_MOMENTS)
        begun = list(unfolded_seconds(asked.start_from, [batch[:2] for batch in some]))
    nets = [
        fit_second(
            look_paths(looks),
            asked.work / f"second_{seed}",
            steps=asked.steps,
            seed=seed,
            rate=asked.rate,
            workers=max(1, asked.workers - 1),
            tune=lambda mean: figures_of(matched_again(mean, held_out)),
            start=start,
        )
        for seed, start in zip(asked.seeds, begun, strict=True)
    ]
    if asked.keep:
        nets = [blended_second(net, asked.start_from, k, asked.keep) for k, net in enumerate(nets)]
    beside = stored_seconds(asked.earlier) if asked.earlier else []
    # those of one file count as much as those of the other
    weights = [weight / sum(asked.weights) for weight in asked.weights]
    weights += [1.0 / max(1, len(beside))] * len(beside)
    net = MeanOfNets([*nets, *beside], weights, asked.ask_first)
    matches = matched_again(net, held_out)
    shift = threshold_shift(matches, Detector(asked.person.read_bytes()).score)
    story = {
        "recipe": "python -m train.second",
        "training_seeds": seeds_of(looks),
        "tuning_seeds": seeds_of(tuning),
        "steps": asked.steps,
        "seeds": asked.seeds,
        "weights": asked.weights,
        "first": asked.person.name,
        "share_of_first": asked.ask_first,
        "started_from": _story_of(asked.start_from) if asked.start_from else "new weights",
        "kept_of_it": asked.keep,
        "earlier": _story_of(asked.earlier) if asked.earlier else "none",
        "teacher": _story_of(asked.teacher) if asked.teacher else "none",
        "tuning": figures_of(matches),
        "shift": round(shift, 4),
    }
    export_second(net, asked.work / "second_look.onnx", shift, story)
    print(f"{asked.work / 'second_look.onnx'}: {story['tuning']}, shifted by {shift:.3f}")
    return 0


def _story_of(path: Path) -> dict[str, object]:
    told: dict[str, object] = json.loads(Network(path).metadata["training"])
    return told


if __name__ == "__main__":
    sys.exit(main())
