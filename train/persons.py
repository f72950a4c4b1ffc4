"""Choose the scores from which finds count: python -m train.persons FLIGHTS

Looks at flights kept for tuning as `bench/paper.py` does, with true poses, in as many views as
hold all that the photos see. For persons the finds are merged for one score after the other, and
the least score is taken that leaves no more than one false alarm a flight, counting as many as
there may well be (95 %, Poisson). For boxes, which are reported view by view, it is the least
score from which 95 in 100 are right in a search, counting as many wrong ones as there may well be
(80 %). What is found in each flight is kept, so that a stopped choice goes on.
"""

from __future__ import annotations

import argparse
import json
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
from hsvaos.detect.yolo import Detector
from hsvaos.evaluate.evaluation import evaluate_flights
from hsvaos.evaluate.measures import ALL, Rules
from hsvaos.evaluate.persons import match_persons
from hsvaos.kernels.device import quiet_start
from train.second_judge import SEARCHED_SHARE, most_expected

WANTED_PRECISION = 0.95
BOX_DOUBT = 0.2
"""Of the number of wrong boxes, one-sided. With .05, on 26 tuning flights, one box in 228 was wrong
on the twenty flights of the paper's experiment, and a fifth of the right ones were lost."""

SCORES = tuple(np.arange(0.30, 0.751, 0.005).round(3).tolist())
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


class BoxRow(NamedTuple):
    """What one score makes of the boxes of all flights.

    Attributes:
        score: From which a box is reported.
        right: Boxes on people whom enough rays reach.
        wrong: Boxes on nobody.
        precision: Share of right ones in a search, if as many are wrong as there may well be.
    """

    score: float
    right: int
    wrong: int
    precision: float


def box_rows(flights: Sequence[Measured], scores: Sequence[float] = SCORES) -> list[BoxRow]:
    """Return what each score makes of the boxes in the judged views of flights.

    Args:
        flights: What was found in each.
        scores: The scores.
    """
    results = [flight.result(1.0) for flight in flights]
    rows = []
    for score in scores:
        counts = evaluate_flights(results, Rules(score=score)).boxes(ALL, 0.25)
        right = SEARCHED_SHARE * counts.tp
        precision = right / (right + most_expected(counts.fp, BOX_DOUBT))
        rows.append(BoxRow(score, counts.tp, counts.fp, precision))
    return rows


def chosen_for_boxes(rows: Sequence[BoxRow], wanted: float = WANTED_PRECISION) -> float:
    """Return the least score with the precision that is wanted; the most precise if none has it.

    Args:
        rows: By `box_rows`.
        wanted: Precision, 0..1.
    """
    good = [row for row in rows if row.precision >= wanted]
    if good:
        return min(row.score for row in good)
    return max(rows, key=lambda row: row.precision).score


def brought_to(model: Path, threshold: float, of_boxes: float, of_persons: float) -> None:
    """Shift a second look's scores so that one lies at a threshold, and write that of persons.

    Args:
        model: ONNX file, as `train.second_net.export_second` writes it.
        threshold: That of the first network, 0..1.
        of_boxes: Score that goes there.
        of_persons: Score from which a find counts for a person, before.

    Raises:
        ValueError: If the network does not end in a constant and a sigmoid.
    """
    network = onnx.load(str(model))
    made = {name: node for node in network.graph.node for name in node.output}
    sigmoid = made.get("scores")
    added = None if sigmoid is None else made.get(sigmoid.input[0])
    if sigmoid is None or sigmoid.op_type != "Sigmoid" or added is None or added.op_type != "Add":
        raise ValueError(f"{model}: expected scores that are the sigmoid of logits and a shift")
    constant = made[added.input[1]].attribute[0].t
    by = _logit(threshold) - _logit(of_boxes)
    shift = onnx.numpy_helper.to_array(constant) + np.float32(by)
    constant.CopyFrom(onnx.numpy_helper.from_array(shift.astype(np.float32), constant.name))
    for entry in network.metadata_props:
        if entry.key == "training":
            entry.value = json.dumps(json.loads(entry.value) | {"shift": round(float(shift), 4)})
    part = model.with_suffix(".part")
    onnx.save(network, str(part))
    with_person_score(part, 1.0 / (1.0 + np.exp(-_logit(of_persons) - by)))
    part.replace(model)


def _logit(score: float) -> float:
    return float(np.log(score / (1.0 - score)))


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
    part = model.with_name(f"{model.name}.new")
    onnx.save(network, str(part))
    part.replace(model)


def _kept_file(kept: Path, folder: Path) -> Path:
    return kept / f"{folder.name}.pickle"


def _measured(folder: Path, kept: Path) -> Measured:
    """Return what our method finds in a flight, from what is kept if that is there."""
    path = _kept_file(kept, folder)
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
        "--model", type=Path, help=f"network to bring to them, such as {PACKAGED_SECOND_LOOK.name}"
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
    boxes = box_rows(flights)
    for box in boxes:
        print(f"{box.score:.3f}: {box.right} boxes right, {box.wrong} wrong, {box.precision:.3f}")
    of_persons, of_boxes = chosen(rows), chosen_for_boxes(boxes)
    print(f"chosen: {of_persons:.3f} for persons, {of_boxes:.3f} for boxes")
    if asked.model is not None:
        brought_to(asked.model, Detector().score, of_boxes, of_persons)
        for folder in folders:  # found with the scores before
            _kept_file(kept, folder).unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
