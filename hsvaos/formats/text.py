"""Text files of flights, read with errors that name the file and the line."""

from __future__ import annotations

import csv
import io
import json
import math
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from hsvaos.flight import FlightError


def read_text(path: Path) -> str:
    """Return a UTF-8 text file, without a byte order mark.

    Raises:
        FlightError: If the file is absent, may not be read or is not UTF-8.
    """
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FlightError(
            f"{path}: expected UTF-8 text, got the byte 0x{error.object[error.start]:02x} "
            f"at offset {error.start}"
        ) from None
    except FileNotFoundError:
        raise FlightError(f"{path}: no such file") from None
    except OSError as error:
        raise FlightError(f"{path}: cannot be read ({error.strerror})") from None


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        FlightError: If it cannot be read or is not JSON.
    """
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise FlightError(
            f"{path}: line {error.lineno}, column {error.colno}: malformed JSON ({error.msg})"
        ) from None
    except RecursionError:
        raise FlightError(f"{path}: malformed JSON (nested too deeply)") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises:
        FlightError: If it cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FlightError(f"{path}: malformed TOML: {error}") from None


class CsvRow:
    """One row of a CSV file, with the place it came from.

    Args:
        path: The file.
        line: Line number, from 1.
        values: Text by column name.
    """

    def __init__(self, path: Path, line: int, values: dict[str, str]) -> None:
        self.path, self.line, self.values = path, line, values

    def text(self, column: str) -> str:
        """Return the text of a column.

        Raises:
            FlightError: If it is empty.
        """
        value = self.values[column]
        if not value:
            raise FlightError(f"{self.path}: line {self.line}: column {column!r} is empty")
        return value

    def has(self, column: str) -> bool:
        """Whether the line says anything in a column, which the file need not have."""
        return bool(self.values.get(column))

    def number(self, column: str) -> float:
        """Return the number in a column; NaN where the file says NaN.

        Raises:
            FlightError: If it is not a number.
        """
        try:
            return float(self.values[column])
        except ValueError:
            raise FlightError(
                f"{self.path}: line {self.line}: column {column!r} must be a number, "
                f"got {self.values[column]!r}"
            ) from None

    def number_or_nan(self, column: str) -> float:
        """Return the number in a column that may be missing or empty (then NaN)."""
        return self.number(column) if self.values.get(column) else math.nan


def read_csv(
    path: Path, columns: Sequence[str], hint: Callable[[Sequence[str]], str] | None = None
) -> list[CsvRow]:
    """Return the rows of a CSV file that has at least the given columns.

    Lines that are empty or start with "#" are passed over.

    Args:
        path: File with one line of column names.
        columns: Names that must be among them.
        hint: Gives what to add to the message where some are missing, from the names that are
            there.

    Raises:
        FlightError: If the file cannot be read, a column is missing, or a row has another number
            of fields than the first line.
    """
    reader = csv.reader(io.StringIO(read_text(path), newline=""), skipinitialspace=True)
    header: list[str] | None = None
    rows = []
    try:
        for fields in reader:
            fields = [field.strip() for field in fields]
            if any("\n" in field or "\r" in field for field in fields):
                raise FlightError(f"{path}: line {reader.line_num}: a quoted field spans lines")
            if not any(fields) or fields[0].startswith("#"):
                continue
            if header is None:
                header = fields
                _check_header(path, header, columns, hint)
                continue
            if len(fields) != len(header):
                raise FlightError(
                    f"{path}: line {reader.line_num}: expected {len(header)} fields, "
                    f"got {len(fields)}"
                )
            rows.append(CsvRow(path, reader.line_num, dict(zip(header, fields, strict=True))))
    except csv.Error as error:
        raise FlightError(f"{path}: line {reader.line_num}: malformed CSV ({error})") from None
    if header is None:
        raise FlightError(f"{path}: expected the columns {', '.join(columns)}, got an empty file")
    return rows


def _check_header(
    path: Path,
    header: list[str],
    columns: Sequence[str],
    hint: Callable[[Sequence[str]], str] | None,
) -> None:
    missing = [name for name in columns if name not in header]
    if missing:
        raise FlightError(
            f"{path}: expected the columns {', '.join(columns)}; missing {', '.join(missing)}, "
            f"got {', '.join(header)[:200]}{hint(header) if hint else ''}"
        )
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise FlightError(f"{path}: the column {twice[0]!r} is there twice")


def write_csv(path: Path, rows: Iterable[Sequence[str]]) -> None:
    """Write a CSV file in UTF-8, names with commas or quotes quoted.

    Args:
        path: The file.
        rows: The column names first.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
