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
    parser.add_argument("--keep-of", type=Path, help="an earlier network, of which --keep stays")
    parser.add_argument("--rate", type=float, default=1.2e-3, help="highest learning rate")
    parser.add_argument("--seed", type=int, default=11, help="of crops")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    if not 0.0 <= asked.keep < 1.0:
        parser.error(f"--keep: expected 0 to 1, got {asked.keep:g}")
    if asked.keep_of is not None and not asked.keep:
        parser.error("--keep-of: expected --keep with it, the share that stays")
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
    from train.judge import from_looks
    from train.look_crops import LookCrops
    from train.person import make_person
    from train.second import look_paths, read_looks

    looks, tuning = asked.work / "looks", asked.work / "tuning_looks"
    return make_person(
        asked,
        "python -m train.further",
        partial(LookCrops, look_paths(looks)),
        asked.work / "person",
        partial(from_looks, read_looks(tuning)),
        (looks, tuning),
        tune_every=300,
        keep_of=asked.keep_of,
    )


if __name__ == "__main__":
    sys.exit(main())
