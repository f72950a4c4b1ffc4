"""Fit a person network, choose its threshold, export it: what its recipes share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from torch.utils.data import IterableDataset

from train.export import export
from train.fit import BATCH, fit
from train.judge import Judged, judge, threshold
from train.stages import seeds_of
from train.warm import blended


def make_person(
    asked: argparse.Namespace,
    recipe: str,
    source: Callable[[int], IterableDataset[Any]],
    state: Path,
    held_out: Callable[[], Iterable[Judged]],
    folders: tuple[Path, Path],
    tune_every: int = 1500,
    keep_of: Path | None = None,
) -> int:
    """Write WORK/person.onnx.

    Args:
        asked: Of the command line: work, steps, seed, workers, start_from, keep and rate.
        recipe: Command that is kept in the metadata.
        source: Makes endless batches of crops from a seed.
        state: Folder for the state and the curve.
        held_out: Gives what the network is judged by.
        folders: Of what is learnt from and what is judged by, whose seeds are kept too.
        tune_every: Steps between two judgements.
        keep_of: Network of which a share is kept; by default the one that was started from.
    """
    kept_of = keep_of or asked.start_from
    net = fit(
        source,
        state,
        steps=asked.steps,
        seed=asked.seed,
        workers=max(1, asked.workers - 1),
        tune=judge(held_out),
        tune_every=tune_every,
        start_from=asked.start_from,
        rate=asked.rate,
    )
    if asked.keep:
        net = blended(net, kept_of, asked.keep)
    figures = judge(held_out)(net)
    score = threshold(net, held_out())
    learnt, judged = folders
    story = {
        "recipe": recipe,
        "training_seeds": seeds_of(learnt),
        "tuning_seeds": seeds_of(judged),
        "steps": asked.steps,
        "crops": asked.steps * BATCH,
        "started_from": asked.start_from.name if asked.start_from else "new weights",
        "kept_of_it": asked.keep,
        "kept_of": kept_of.name if asked.keep else "nothing",
        "tuning": figures,
    }
    target = asked.work / "person.onnx"
    export(net, target, score, story)
    print(f"{target}: threshold {score:.3f}, {figures}", flush=True)
    return 0
