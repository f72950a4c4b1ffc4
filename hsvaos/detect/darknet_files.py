"""Files of Darknet: the network as text (.cfg), and its numbers (.weights)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

_BATCH_NORM_EPSILON = 1e-5


@dataclass(frozen=True)
class Section:
    """One section of a .cfg file, that is, one layer.

    Args:
        kind: Such as "convolutional".
        where: File and line, for messages.
        values: Text by key.
    """

    kind: str
    where: str
    values: dict[str, str] = field(default_factory=dict)

    def number(self, key: str, default: int | None = None) -> int:
        """Return a whole number.

        Raises:
            ValueError: If it is none, or not there and without default.
        """
        values = self.numbers(key, None if default is None else [default])
        if len(values) != 1:
            raise ValueError(f"{self.where}: [{self.kind}] {key}: expected one number")
        return int(values[0])

    def numbers(self, key: str, default: list[int] | None = None) -> list[float]:
        """Return numbers that are separated by commas.

        Raises:
            ValueError: If they are none, or not there and without default.
        """
        text = self.values.get(key)
        if text is None:
            if default is None:
                raise ValueError(f"{self.where}: [{self.kind}] has no {key}")
            return [float(value) for value in default]
        try:
            return [float(part) for part in text.split(",") if part.strip()]
        except ValueError:
            raise ValueError(
                f"{self.where}: [{self.kind}] {key}: expected numbers, got {text!r}"
            ) from None


def read_cfg(path: str | Path) -> list[Section]:
    """Read a .cfg file.

    Args:
        path: The file.

    Returns:
        Its sections; the first one is [net].

    Raises:
        ValueError: If it cannot be read or is no such file.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected a Darknet cfg file, got: {error}") from None
    sections: list[Section] = []
    for number, line in enumerate(lines, start=1):
        text = line.split("#")[0].split(";")[0].strip()
        where = f"{path}:{number}"
        if text.startswith("[") and text.endswith("]"):
            sections.append(Section(text[1:-1].strip().lower(), where))
        elif "=" in text and sections:
            key, _, value = text.partition("=")
            sections[-1].values[key.strip()] = value.strip()
        elif text:
            raise ValueError(f"{where}: expected [section] or key=value, got {text!r:.60}")
    if not sections or sections[0].kind not in ("net", "network"):
        raise ValueError(f"{path}: expected a Darknet cfg file that begins with [net]")
    return sections


class Weights:
    """The numbers of a .weights file, taken layer by layer.

    Args:
        path: The file.

    Raises:
        ValueError: If it cannot be read or is too short for a header.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        try:
            data = self._path.read_bytes()
        except OSError as error:
            raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
        if len(data) < 20:
            raise ValueError(f"{path}: expected Darknet weights, got {len(data)} bytes")
        major, minor = np.frombuffer(data, "<i4", 2)
        # three versions, then how many pictures were seen: 8 bytes since version 0.2
        header = 20 if int(major) * 10 + int(minor) >= 2 else 16
        usable = len(data) - (len(data) - header) % 4
        self._numbers = np.frombuffer(data[header:usable], "<f4")
        self._at = 0

    def take(self, *shape: int) -> Array:
        """Return the next numbers in a shape.

        Raises:
            ValueError: If there are not so many left.
        """
        count = int(np.prod(shape))
        part = self._numbers[self._at : self._at + count]
        if len(part) < count:
            raise ValueError(
                f"{self._path}: too short for this cfg: {len(self._numbers)} numbers, at least "
                f"{self._at + count} needed"
            )
        self._at += count
        return part.reshape(shape).astype(np.float32)

    def convolution(
        self, filters: int, channels: int, size: int, normalised: bool
    ) -> tuple[Array, Array]:
        """Return kernel and bias of the next convolution, its batch normalisation folded in.

        Args:
            filters: Channels that come out.
            channels: Channels that each filter sees.
            size: Side of the kernel [px].
            normalised: Whether the layer has batch normalisation.

        Returns:
            Shapes (filters, channels, size, size) and (filters,).
        """
        bias: Any = self.take(filters)
        if not normalised:
            return self.take(filters, channels, size, size), bias
        scale, mean, variance = (self.take(filters).astype(np.float64) for _ in range(3))
        factor = scale / np.sqrt(variance + _BATCH_NORM_EPSILON)
        kernel = self.take(filters, channels, size, size) * factor[:, None, None, None]
        return kernel.astype(np.float32), np.asarray(bias - mean * factor, np.float32)

    def check_end(self) -> None:
        """Make sure that all numbers were taken.

        Raises:
            ValueError: If some are left: cfg and weights do not belong together.
        """
        left = len(self._numbers) - self._at
        if left:
            raise ValueError(
                f"{self._path}: {left} of {len(self._numbers)} numbers are left over; do cfg and "
                f"weights belong together?"
            )
