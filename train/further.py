"""Train the person network further on looks: python -m train.further WORK [--steps 2800]

Learns from crops of the looks that `python -m train.second WORK` made of its flights, judges by
those of the tuning flights, and writes WORK/person.onnx and WORK/person/curve.csv. Goes on where it
was stopped.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

from hsvaos.detect.yolo import PACKAGED


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m train.further", description=__doc__)
    parser.add_argument("work", type=Path, help="folder with looks and tuning_looks")
    parser.add_argument("--steps", type=int, default=2800)
    parser.add_argument("--start-from", type=Path, default=PACKAGED, help="an exported network")
    parser.add_argument("--keep", type=float, default=0.0, help="share of its weights that stays")
    parser.add_argument("--rate", type=float, default=1.2e-3, help="highest learning rate")
    parser.add_argument("--seed", type=int, default=11, help="of crops")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    if not 0.0 <= asked.keep < 1.0:
        parser.error(f"--keep: expected 0 to 1, got {asked.keep:g}")
    for name in ("looks", "tuning_looks"):
        if not any((asked.work / name).glob("*_0.npz")):
            parser.error(
                f"{asked.work / name}: expected looks, as `python -m train.second` makes them, "
                "got none"
            )
    return train(asked)


def train(asked: argparse.Namespace) -> int:
    """Fit, choose the threshold, export.

    Args:
        asked: Of the command line.
    """
    from train.export import export
    from train.fit import BATCH, fit
    from train.judge import from_looks, judge, threshold
    from train.look_crops import LookCrops
    from train.second import look_paths, read_looks
    from train.stages import seeds_of
    from train.warm import blended

    looks, tuning = asked.work / "looks", asked.work / "tuning_looks"
    held_out = partial(from_looks, read_looks(tuning))
    net = fit(
        partial(LookCrops, look_paths(looks)),
        asked.work / "person",
        steps=asked.steps,
        seed=asked.seed,
        workers=max(1, asked.workers - 1),
        tune=judge(held_out),
        tune_every=300,
        start_from=asked.start_from,
        rate=asked.rate,
    )
    if asked.keep:
        net = blended(net, asked.start_from, asked.keep)
    figures = judge(held_out)(net)
    score = threshold(net, held_out())
    story = {
        "recipe": "python -m train.further",
        "training_seeds": seeds_of(looks),
        "tuning_seeds": seeds_of(tuning),
        "steps": asked.steps,
        "crops": asked.steps * BATCH,
        "started_from": asked.start_from.name,
        "kept_of_it": asked.keep,
        "tuning": figures,
    }
    export(net, asked.work / "person.onnx", score, story)
    print(f"{asked.work / 'person.onnx'}: threshold {score:.3f}, {figures}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
