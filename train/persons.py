"""Choose the score from which a find counts for a person: python -m train.persons FLIGHTS

Looks at flights kept for tuning as `bench/paper.py` does, with true poses, in as many views as
hold all that the photos see, and merges the finds for one score after the other. The least score is
taken that leaves no more than one false alarm a flight, counting as many as there may well be
(95 %, Poisson). What is found in each flight is kept, so that a stopped choice goes on.
"""

from __future__ import annotations

import argparse
import pickle
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnx

from bench.paper import Measured, measure, methods
from hsvaos.detect.network import PERSON_SCORE
from hsvaos.detect.second_look import PACKAGED_SECOND_LOOK
from hsvaos.evaluate.measures import Rules
from hsvaos.evaluate.persons import match_persons
from hsvaos.kernels.device import quiet_start
from train.second_judge import most_expected

SCORES = tuple(np.arange(0.30, 0.751, 0.025).round(3).tolist())
MOST_FALSE = 1.0
"""False alarms a flight."""


class Row(NamedTuple):
    """What one score makes of all flights.

    Attributes:
        score: From which a find counts.
        found: People found, of those that enough rays reach.
        people: All of them.
        false_alarms: Persons where nobody lies.
        expected: As many false alarms a flight as there may well be.
    """

    score: float
    found: int
    people: int
    false_alarms: int
    expected: float


def rows_of(flights: Sequence[Measured], scores: Sequence[float] = SCORES) -> list[Row]:
    """Return what each score makes of flights.

    Args:
        flights: What was found in each.
        scores: The scores.

    Raises:
        ValueError: If there are no flights.
    """
    if not flights:
        raise ValueError("expected flights to choose a score by, got none")
    rules, rows = Rules(), []
    for score in scores:
        found = people = wrong = 0
        for flight in flights:
            unreached = [one.rays < rules.min_rays for one in flight.people]
            persons = flight.result(score).persons
            matches, _ = match_persons(persons, flight.people, rules.radius_m, unreached)
            found += int(((matches.truth >= 0) & ~matches.ignored).sum())
            wrong += int((matches.truth < 0).sum())
            people += len(unreached) - sum(unreached)
        rows.append(Row(score, found, people, wrong, most_expected(wrong) / len(flights)))
    return rows


def chosen(rows: Sequence[Row], most: float = MOST_FALSE) -> float:
    """Return the least score from which on, up to the highest, false alarms are few enough.

    Args:
        rows: By `rows_of`.
        most: False alarms a flight.

    Raises:
        ValueError: If the highest score leaves too many.
    """
    best = None
    for row in sorted(rows, key=lambda row: -row.score):
        if row.expected > most:
            break
        best = row.score
    if best is None:
        raise ValueError(f"expected a score with {most:g} false alarms a flight or fewer, got none")
    return best


def with_person_score(model: Path, score: float) -> None:
    """Write the score into a network's metadata.

    Args:
        model: ONNX file.
        score: 0..1.
    """
    network = onnx.load(str(model))
    kept = {entry.key: entry.value for entry in network.metadata_props}
    kept[PERSON_SCORE] = f"{score:.3f}"
    onnx.helper.set_model_props(network, kept)
    part = model.with_suffix(".part")
    onnx.save(network, str(part))
    part.replace(model)


def _measured(folder: Path, kept: Path) -> Measured:
    """Return what our method finds in a flight, from what is kept if that is there."""
    path = kept / f"{folder.name}.pickle"
    if path.exists():
        found = pickle.loads(path.read_bytes())
        if not isinstance(found, Measured):
            raise TypeError(f"{path}: expected what was found in a flight, got {type(found)}")
        return found
    ours = {name: method for name, method in methods().items() if name == "hsvaos"}
    (_, _, found), *_ = measure(folder, {"true": ours})
    part = path.with_suffix(".part")
    part.write_bytes(pickle.dumps(found))
    part.replace(path)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m train.persons", description=__doc__)
    parser.add_argument("flights", type=Path, help="folder of tuning flights (WORK/tuning_flights)")
    parser.add_argument("--kept", type=Path, help="for what is found; by default beside them")
    parser.add_argument(
        "--model", type=Path, help=f"network to write it into, such as {PACKAGED_SECOND_LOOK.name}"
    )
    asked = parser.parse_args()
    folders = sorted(path for path in asked.flights.iterdir() if (path / "truth.json").exists())
    kept = asked.kept or asked.flights.with_name(f"{asked.flights.name}_found")
    kept.mkdir(parents=True, exist_ok=True)
    quiet_start()
    flights = []
    for number, folder in enumerate(folders, 1):
        flights.append(_measured(folder, kept))
        print(f"[{number}/{len(folders)}] {folder.name}", flush=True)
    rows = rows_of(flights)
    for row in rows:
        wrong = f"{row.false_alarms} false alarms, {row.expected:.2f} a flight expected at most"
        print(f"{row.score:.3f}: {row.found} of {row.people} found, {wrong}")
    score = chosen(rows)
    print(f"chosen: {score:.3f}")
    if asked.model is not None:
        with_person_score(asked.model, score)
    return 0


if __name__ == "__main__":
    sys.exit(main())
