"""Which classes of a network are people."""

from __future__ import annotations

import ast
import json
from typing import Any

PERSON_NAMES = frozenset(
    {"person", "persons", "people", "human", "humans", "pedestrian", "pedestrians"}
)
"""Names of classes that are people, in lower case."""

_COCO_PERSON = {80: 0, 91: 1}
"""Class that is the person, by number of classes: COCO's 80 counted through, or its 91 ids."""


def class_names(text: str, where: str) -> dict[int, str]:
    """Read the class names in a network's metadata, such as "{0: 'person', 1: 'bicycle'}".

    Args:
        text: A Python or JSON dictionary of names by number, or a list of names.
        where: What to call the network in messages.

    Raises:
        ValueError: If it is neither.
    """
    value: Any = None
    for read in (ast.literal_eval, json.loads):
        try:
            value = read(text)
            break
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            continue
    if isinstance(value, list | tuple):
        value = dict(enumerate(value))
    try:
        names = {int(number): name for number, name in value.items()}
    except (AttributeError, TypeError, ValueError):
        names = {}
    if not names or not all(isinstance(name, str) for name in names.values()):
        raise ValueError(
            f"{where}: expected class names such as {{0: 'person'}} in the metadata, "
            f"got {text!r:.80}"
        )
    return names


def person_classes(
    names: dict[int, str] | None, count: int | None, asked: int | str | None, where: str
) -> tuple[int, ...]:
    """Return the numbers of the classes that are people.

    Args:
        names: Names of the classes, where known.
        count: Number of classes the network tells apart, where known.
        asked: Number or name of the class that the user says is a person, or None.
        where: What to call the network in messages.

    Raises:
        ValueError: If no class is a person, names and outputs disagree, or nothing tells.
        TypeError: If `asked` is neither a number nor a name.
    """
    if names is not None and count is not None and sorted(names) != list(range(count)):
        raise ValueError(
            f"{where}: its metadata name {len(names)} classes (numbers {min(names)} to "
            f"{max(names)}), its output has {count}"
        )
    if asked is not None:
        return (_asked(names, count, asked, where),)
    if names is not None:
        people = tuple(i for i, name in names.items() if name.strip().lower() in PERSON_NAMES)
        if not people:
            listed = ", ".join(list(names.values())[:8])
            raise ValueError(
                f"{where}: no class is a person; expected one of {', '.join(sorted(PERSON_NAMES))} "
                f"among {listed}{', ...' if len(names) > 8 else ''} (or name one as person_class)"
            )
        return people
    if count == 1:
        return (0,)
    if count in _COCO_PERSON:
        return (_COCO_PERSON[count],)
    if count is None:
        return (0,)
    raise ValueError(
        f"{where}: {count} classes without names; say which number is the person_class"
    )


def _asked(names: dict[int, str] | None, count: int | None, asked: int | str, where: str) -> int:
    if isinstance(asked, str):
        found = [i for i, name in (names or {}).items() if name == asked]
        if not found:
            known = ", ".join(list(names.values())[:8]) if names else "none in its metadata"
            raise ValueError(f"{where}: person_class {asked!r} is no class name; known: {known}")
        return found[0]
    if isinstance(asked, bool) or not isinstance(asked, int):
        raise TypeError(f"person_class must be a number or a name, got {asked!r}")
    if asked < 0 or (count is not None and asked >= count):
        raise ValueError(
            f"{where}: person_class must lie within 0 to {(count or 1) - 1}, got {asked}"
        )
    return asked
