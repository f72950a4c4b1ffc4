"""Evaluations as Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields

from hsvaos.evaluate.measures import ALL, DetectionRow, Evaluation, PersonRow, Rules

_BOX_HEAD = (
    "group", "IoU", "boxes", "AP coco101", "AP VOC11", "AP all", "TP", "FP", "FN", "precision",
    "recall",
)  # fmt: skip
_PERSON_HEAD = (
    "group", "people", "found", "recall", "false alarms", "precision", "a flight", "a hectare",
    "AP all", "error median m", "error p90 m",
)  # fmt: skip


def cell(value: float | int | str | None, digits: int = 3) -> str:
    """Return a value as tables show it: "-" for None, whole numbers whole, others rounded."""
    if value is None:
        return "-"
    return f"{value:.{digits}f}" if isinstance(value, float) else str(value)


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; text to the left, numbers to the right.

    Args:
        head: Names of the columns.
        rows: Cells as text. A column is one of numbers if every cell of it starts like one.
    """
    body = [[text.replace("|", "\\|") for text in row] for row in rows]

    def number(column: int) -> bool:
        return all(row[column][:1] in "-0123456789" for row in body)

    rule = ["---:" if body and number(k) else "---" for k in range(len(head))]
    return "\n".join(f"| {' | '.join(row)} |" for row in (list(head), rule, *body)) + "\n"


def box_table(evaluation: Evaluation) -> str:
    """Return the boxes of every group at every threshold as a Markdown table."""
    return markdown_table(_BOX_HEAD, map(_box_cells, evaluation.detection))


def person_table(evaluation: Evaluation) -> str:
    """Return the persons of every group as a Markdown table."""
    return markdown_table(_PERSON_HEAD, map(_person_cells, evaluation.persons))


def flight_table(evaluation: Evaluation) -> str:
    """Return the flights one by one as a Markdown table."""
    aps = [f"AP {iou:.2f}" for iou in evaluation.rules.ious]
    head = (
        "flight", "views", "boxes", *aps, "people", "unreached", "found", "false alarms", "ha",
        "error median m",
    )  # fmt: skip
    return markdown_table(
        head,
        (
            (
                row.flight,
                *map(cell, (row.views, row.boxes, *row.ap_coco101)),
                *map(cell, (row.people, row.unreached, row.found, row.false_alarms)),
                *map(cell, (row.area_ha, row.error_median_m)),
            )
            for row in evaluation.flights
        ),
    )


def comparison_table(methods: Mapping[str, Evaluation], group: str = ALL) -> str:
    """Return methods side by side, a row for each, as a Markdown table.

    Precision and recall of boxes are those at the middle threshold of the rules, .25 by default.

    Args:
        methods: Evaluations by name of the method, all by the same rules.
        group: Whom to compare by: `measures.ALL`, an occlusion class, ...

    Raises:
        ValueError: If there is no method, the rules differ or one has nobody of the group.
    """
    evaluations = list(methods.values())
    if not evaluations:
        raise ValueError("expected at least one method to compare, got none")
    ious = evaluations[0].rules.ious
    if any(evaluation.rules.ious != ious for evaluation in evaluations):
        raise ValueError("methods must be evaluated at the same thresholds to be compared")
    middle = ious[len(ious) // 2]
    rows = []
    for name, evaluation in methods.items():
        persons = [row for row in evaluation.persons if row.group == group]
        if not persons:
            raise ValueError(f"{name} has nobody of the group {group!r}")
        box, person = evaluation.boxes(group, middle), persons[0]
        rows.append(
            (
                name,
                *(cell(evaluation.boxes(group, iou).ap_coco101) for iou in ious),
                *map(cell, (box.tp, box.fp, box.fn, box.precision, box.recall)),
                *map(cell, (person.recall, person.per_flight, person.per_ha)),
                *map(cell, (person.error_median_m, person.error_p90_m)),
            )
        )
    head = (
        "method", *(f"AP {iou:.2f}" for iou in ious), "TP", "FP", "FN",
        f"precision {middle:.2f}", f"recall {middle:.2f}", "person recall", "false a flight",
        "false a hectare", "error median m", "error p90 m",
    )  # fmt: skip
    return markdown_table(head, rows)


def markdown_report(evaluation: Evaluation, title: str, notes: Sequence[str] = ()) -> str:
    """Return an evaluation as a Markdown page.

    Args:
        evaluation: The figures.
        title: Heading.
        notes: Lines on how they came about.
    """
    parts = [f"# {title}\n"]
    if notes:
        parts.append("\n".join(f"- {note}" for note in notes) + "\n")
    parts += [
        f"## Boxes in views\n\n{_box_rules(evaluation.rules)}\n",
        box_table(evaluation),
        f"## Persons on the ground\n\n{_person_rules(evaluation)}\n",
        person_table(evaluation),
        "## Flight by flight\n\nThose who are reached only; AP coco101 at each IoU.\n",
        flight_table(evaluation),
    ]
    return "\n".join(parts)


def _box_rules(rules: Rules) -> str:
    score = "every find" if rules.score is None else f"finds of score {rules.score:g} or more"
    return (
        "COCO's matching: from the strongest find down, each takes the true box it overlaps most. "
        f"TP, FP, FN count {score}; average precision counts all. `all` and the occlusion classes "
        f"hold people whom at least {rules.min_rays:g} unoccluded rays a point reach on average; "
        "the others are `unreached`. Finds of people of other groups count neither way, nor does "
        f"any find where somebody lies who is unreached or has less than {rules.min_inside:.0%} of "
        f"the box in the picture (COCO's crowds). The strongest {rules.most} finds of a view count."
    )


def _person_rules(evaluation: Evaluation) -> str:
    rules, flights = evaluation.rules, len(evaluation.flights)
    score = "" if rules.person_score is None else f" of score {rules.person_score:g} or more"
    return (
        f"Persons{score} merged over the views, matched one to one within {rules.radius_m:g} m of "
        f"the middle of who lies there. {flights} flight{'s' if flights != 1 else ''}, "
        f"{evaluation.area_ha:.3f} ha of ground seen. False alarms count in every group."
    )


def evaluation_csv(evaluation: Evaluation) -> str:
    """Return the figures as CSV: a row for each group and threshold, with the group's persons.

    The names of columns are those of `DetectionRow`, and of `PersonRow` after "person_"; what is
    not defined is empty.
    """
    persons = {row.group: row for row in evaluation.persons}
    names = [entry.name for entry in fields(PersonRow) if entry.name != "group"]
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        [entry.name for entry in fields(DetectionRow)] + [f"person_{name}" for name in names]
    )
    for row in evaluation.detection:
        own = asdict(persons[row.group])
        values = [*asdict(row).values(), *(own[name] for name in names)]
        writer.writerow([f"{v:.6g}" if isinstance(v, float) else v for v in values])
    return stream.getvalue()


def _box_cells(row: DetectionRow) -> tuple[str, ...]:
    return (
        row.group,
        f"{row.iou:.2f}",
        *map(cell, (row.boxes, row.ap_coco101, row.ap_voc11, row.ap_all)),
        *map(cell, (row.tp, row.fp, row.fn, row.precision, row.recall)),
    )


def _person_cells(row: PersonRow) -> tuple[str, ...]:
    return (
        row.group,
        *map(cell, (row.people, row.found, row.recall, row.false_alarms, row.precision)),
        *map(cell, (row.per_flight, row.per_ha, row.ap_all)),
        *map(cell, (row.error_median_m, row.error_p90_m)),
    )
