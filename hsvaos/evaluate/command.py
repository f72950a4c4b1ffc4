"""The command `hsvaos evaluate`: flights with truth in, tables and a curve out; resumable."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from rich.table import Table

from hsvaos.evaluate.evaluation import evaluate_flights
from hsvaos.evaluate.figures import curve_picture, lines_of
from hsvaos.evaluate.measures import Evaluation, Rules
from hsvaos.evaluate.operating import persons_from, widened
from hsvaos.evaluate.poses import FROM_LOG, open_posed, own_file
from hsvaos.evaluate.results import FlightResult
from hsvaos.evaluate.store import Stored, fingerprint, load, save
from hsvaos.evaluate.tables import cell, evaluation_csv, markdown_report
from hsvaos.evaluate.truth import read_people, read_truth, truth_file
from hsvaos.finding import operating_scores
from hsvaos.flight import Flight, FlightError
from hsvaos.formats.open import open_flight
from hsvaos.photos import with_poses
from hsvaos.pipeline import run
from hsvaos.report.atomic import check_writable, write_bytes
from hsvaos.report.figures import encode
from hsvaos.settings import Settings

if TYPE_CHECKING:
    from hsvaos.console import Console

FILE_NAMES = ("evaluation.md", "evaluation.csv", "evaluation.json", "pr_curve.png", "settings.toml")
"""Files that the command writes, beside the results of flights in `flights`."""


@dataclass(frozen=True)
class Work:
    """What to evaluate, and how.

    Args:
        paths: Flights with truth.json.
        out: Folder for the outcome.
        settings: Of the runs; every stored pose becomes a view.
        rules: What counts; where `score` is None, the score from which a run reports a find.
        poses: See `open_posed` and `own_file`.
        device: Where to run.
        fresh: Whether to run flights again whose results are there.
    """

    paths: tuple[Path, ...]
    out: Path
    settings: Settings
    rules: Rules
    poses: Path | None = None
    device: str = "cpu"
    fresh: bool = False


@dataclass(frozen=True, eq=False)
class _Job:
    """One flight: opened, its truth read, its result's place known."""

    name: str
    path: Path
    flight: Flight
    settings: Settings
    file: Path
    fingerprint: str


def evaluate_paths(work: Work, console: Console) -> dict[str, Any]:
    """Run flights, judge what was found, and write tables and a curve.

    Whatever is wrong with a flight or the folder is said before the first run.

    Args:
        work: What to evaluate, and how.
        console: Where to tell of it.

    Returns:
        The outcome as JSON types: out, files, flights (name, seconds, whether kept, notes) and
        evaluation.

    Raises:
        FlightError: If a flight, its truth or the folder cannot be used.
        ValueError: If a setting makes no sense.
    """
    if not work.settings.detect.enabled:
        raise ValueError("detect.enabled must be true to evaluate finds, got False")
    if work.rules.score is not None:
        work = replace(work, settings=work.settings.with_score(work.rules.score))
    rules = replace(work.rules, score=operating_scores(work.settings.detect).of_boxes)
    check_writable(work.out, FILE_NAMES)
    check_writable(work.out / "flights")
    jobs = _jobs(work)
    stored: list[Stored] = []
    told: list[dict[str, Any]] = []
    for number, job in enumerate(jobs, start=1):
        head = f"flight {number} of {len(jobs)}, {job.name}"
        kept = None if work.fresh else load(job.file, job.fingerprint)
        if kept is not None:
            console.say(f"{head}: kept, same settings and inputs (--fresh runs it again)")
        else:
            console.say(f"{head}: {len(job.flight)} photos")
        try:
            one = kept or _run(job, work.device, console)
        except KeyboardInterrupt:
            if stored:
                console.say(f"{len(stored)} of {len(jobs)} flights are kept; run again to go on")
            raise
        console.notes(f"{job.name}: {note}" for note in one.notes)
        stored.append(one)
        told.append(
            {
                "name": job.name,
                "seconds": round(one.seconds, 1),
                "kept": kept is not None,
                "notes": list(one.notes),
            }
        )
    evaluation = evaluate_flights([one.result for one in stored], rules)
    _write(evaluation, work, told)
    console.show(summary(evaluation), f"look at {work.out / 'evaluation.md'}")
    return {
        "out": str(work.out),
        "files": list(FILE_NAMES),
        "flights": told,
        "evaluation": json.loads(evaluation.to_json()),
    }


def _jobs(work: Work) -> list[_Job]:
    names = _names(work.paths)
    return [_job(path, name, work) for path, name in zip(work.paths, names, strict=True)]


def _job(path: Path, name: str, work: Work) -> _Job:
    alone, poses = len(work.paths) == 1, work.poses
    if poses is not None and poses != Path(FROM_LOG):
        poses = own_file(path, poses, alone, "poses")
    flight = open_posed(path, poses)
    truth = truth_file(flight)
    read_people(truth)
    settings = work.settings.with_values(view={"frame": "all"})
    files = [truth, *([poses] if poses is not None and poses != Path(FROM_LOG) else [])]
    if settings.focus.terrain is not None:
        terrain = own_file(path, Path(settings.focus.terrain), alone, "terrain")
        settings = settings.with_focus({"terrain": str(terrain)})
        files.append(terrain)
    choices = {
        "settings": settings.to_toml(),
        "device": work.device,
        "poses": _listed(flight),
        "own poses": _listed(open_flight(path)),  # they say who is reached
    }
    file = work.out / "flights" / f"{name.replace('/', '_')}.json"
    digest = fingerprint(flight, files, choices)
    return _Job(name, path, flight, settings, file, digest)


def _listed(flight: Flight) -> list[Any]:
    poses = (frame.world_from_camera for frame in flight.frames)
    return [None if pose is None else pose.tolist() for pose in poses]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return names for flights: of their folders, with those above where needed to differ."""
    folders = [path.resolve().parent if path.is_file() else path.resolve() for path in paths]
    twice = [str(path) for path, f in zip(paths, folders, strict=True) if folders.count(f) > 1]
    if twice:
        raise FlightError(f"each flight must be given once, got {' and '.join(twice)}")
    names = [folder.name or "flight" for folder in folders]
    depth = 1
    while len({name.replace("/", "_") for name in names}) < len(names):
        depth += 1
        names = ["/".join(folder.parts[-depth:]) for folder in folders]
    return names


def _run(job: _Job, device: str, console: Console) -> Stored:
    start = perf_counter()
    with console.progress() as progress:
        flight = with_poses(job.flight, progress)
        result = run(flight, widened(job.settings), device=device, progress=progress)
    own = open_flight(job.path)
    people = read_truth(own if own.has_poses else flight)
    result = replace(result, persons=persons_from(result, job.settings, device))
    found = FlightResult.from_run(result, people, job.name)
    stored = Stored(job.fingerprint, found, result.notes, perf_counter() - start)
    save(job.file, stored)
    return stored


def _write(evaluation: Evaluation, work: Work, told: Sequence[dict[str, Any]]) -> None:
    count = len(told)
    title = f"Evaluation of {_flights(count)}"
    where = {None: "the flights' own", Path(FROM_LOG): "from the sensor logs"}
    lines = [
        f"Mask: {work.settings.mask.method}. Poses: {where.get(work.poses, str(work.poses))}. "
        "Views: every stored pose. All settings: settings.toml.",
        *(f"{one['name']}: {note}" for one in told for note in one["notes"]),
    ]
    page = markdown_report(evaluation, title, lines) + "\n![Precision over recall](pr_curve.png)\n"
    views = sum(row.views for row in evaluation.flights)
    picture = curve_picture(lines_of(evaluation), f"Boxes in {views} views")
    contents = {
        "evaluation.md": page.encode("utf-8"),
        "evaluation.csv": evaluation_csv(evaluation).encode("utf-8"),
        "evaluation.json": evaluation.to_json().encode("utf-8"),
        "pr_curve.png": encode(picture),
        "settings.toml": work.settings.to_toml().encode("utf-8"),
    }
    for name, content in contents.items():
        write_bytes(work.out / name, content)


def _flights(count: int) -> str:
    return f"{count} flight{'' if count == 1 else 's'}"


def summary(evaluation: Evaluation) -> Table:
    """Return the table that the command prints: a row for each group of people."""
    ious = evaluation.rules.ious
    table = Table(
        title=f"{_flights(len(evaluation.flights))}, {evaluation.area_ha:.2f} ha",
        title_justify="left",
    )
    table.add_column("group")
    heads = [f"AP {iou:.2f}" for iou in ious]
    for head in (*heads, "people", "found", "false", "error m"):
        table.add_column(head, justify="right")
    for row in evaluation.persons:
        aps = [cell(evaluation.boxes(row.group, iou).ap_coco101) for iou in ious]
        persons = map(cell, (row.people, row.found, row.false_alarms, row.error_median_m))
        table.add_row(row.group, *aps, *persons)
    return table
