"""Whole files or none: written under a temporary name, renamed when complete."""

from __future__ import annotations

import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hsvaos.flight import FlightError

_PROBE_BYTES = 64 * 1024
"""Enough that a full disk shows itself, little enough to cost nothing."""


@contextmanager
def atomic_path(final: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `final`, which takes the final name if the block succeeds.

    The temporary file lies in the same folder, because a rename is atomic only within a file
    system, and keeps the suffix, because many writers choose the format by it.

    Args:
        final: The name the file shall have; an older file of that name is replaced.

    Yields:
        The path to write to.

    Raises:
        OSError: If the file cannot be written or renamed; names the final path.
    """
    final = Path(final)
    temporary = final.with_name(f".{final.stem}.{secrets.token_hex(4)}.part{final.suffix}")
    try:
        yield temporary
        # Without this a power cut after the rename can leave an empty file under the final name.
        with temporary.open("rb+") as written:
            os.fsync(written.fileno())
        temporary.replace(final)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OSError(error.errno, f"cannot write the file: {reason}", str(final)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(final: str | Path, content: bytes) -> Path:
    """Write a file whole or not at all.

    Args:
        final: Where to.
        content: What.

    Returns:
        The path written.

    Raises:
        OSError: If the file cannot be written; names the path.
    """
    with atomic_path(final) as temporary:
        temporary.write_bytes(content)
    return Path(final)


def check_writable(folder: str | Path, names: tuple[str, ...] = ()) -> Path:
    """Make the output folder if missing and find out now whether files can be written into it.

    Meant to be called before long work, so that a wrong path costs no hour.

    Args:
        folder: The output folder.
        names: Files that will be written there; none of them may be a folder.

    Returns:
        The folder.

    Raises:
        FlightError: If the folder cannot be made or written to; names the path and why.
    """
    folder = Path(folder)
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            raise FlightError(f"{place}: expected a folder for the output, got a file")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(_PROBE_BYTES))
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        raise FlightError(
            f"{folder}: expected a folder that can be written to, got: {error.strerror or error}"
        ) from error
    for name in names:
        if (folder / name).is_dir():
            raise FlightError(f"{folder / name}: expected a file to write, got a folder")
    return folder
