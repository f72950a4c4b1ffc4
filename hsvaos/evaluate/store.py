"""Results of flights on disk: written whole when a flight is done, reused where nothing changed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from hsvaos.evaluate.results import FlightResult
from hsvaos.flight import Flight
from hsvaos.report.atomic import write_bytes

_FORMAT = 1

_WHOLE = 4 * 2**20
"""Files up to this size count by content, larger ones and photos by size and time of change."""


@dataclass(frozen=True, eq=False)
class Stored:
    """A flight's result with what it was made from.

    Args:
        fingerprint: Of settings, inputs and code.
        result: What was found.
        notes: Of the run.
        seconds: That the run took [s].
    """

    fingerprint: str
    result: FlightResult
    notes: tuple[str, ...]
    seconds: float


def fingerprint(flight: Flight, files: Iterable[Path], choices: dict[str, Any]) -> str:
    """Return a digest of everything that a flight's result depends on.

    Args:
        flight: The flight; its photos, masks, logs and terrain count.
        files: Further files that count, such as truth.json and the poses.
        choices: Settings and the like, as JSON types.
    """
    digest = hashlib.sha256(f"{_FORMAT} {_code()}\n".encode())
    digest.update(json.dumps(choices, sort_keys=True).encode())
    photos = [frame.path for frame in flight.frames]
    masks = {frame.mask for frame in flight.frames} | {flight.mask, flight.terrain}
    logs = [Path(value) for value in flight.sensors.values() if isinstance(value, str | Path)]
    texts = [*files, *logs, *(path for path in masks if path is not None)]
    for path in sorted({*texts}):
        digest.update(_file(path, content=True))
    for path in photos:
        digest.update(_file(path, content=False))
    return digest.hexdigest()


def _file(path: Path, content: bool) -> bytes:
    try:
        state = path.stat()
        if content and state.st_size <= _WHOLE:
            inside = hashlib.sha256(path.read_bytes()).hexdigest()
            return f"{path.name} {inside}\n".encode()
    except OSError:  # the run will say so, or leave it out
        return f"{path.name} missing\n".encode()
    return f"{path.name} {state.st_size} {state.st_mtime_ns}\n".encode()


@cache
def _code() -> str:
    """Return a digest of the package itself, weights among it: other code may find others."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted([*package.rglob("*.py"), *package.rglob("*.onnx")]):
        digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def save(path: Path, stored: Stored) -> None:
    """Write a flight's result, whole or not at all.

    Raises:
        OSError: If it cannot be written; names the path.
    """
    content = {
        "fingerprint": stored.fingerprint,
        "seconds": stored.seconds,
        "notes": list(stored.notes),
        "result": stored.result.to_dict(),
    }
    text = json.dumps(content, ensure_ascii=False) + "\n"
    write_bytes(path, text.encode("utf-8"))


def load(path: Path, wanted: str) -> Stored | None:
    """Return a flight's result if it is there and was made from the same, else None.

    Args:
        path: The file.
        wanted: The fingerprint.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["fingerprint"] != wanted:
            return None
        result = FlightResult.from_dict(content["result"])
        return Stored(wanted, result, tuple(content["notes"]), float(content["seconds"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None  # damaged, or of another kind: made anew
