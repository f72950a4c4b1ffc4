"""The tag directories of TIFF files, which are also those of Exif (TIFF 6.0; Exif 2.32)."""

from __future__ import annotations

import math
import struct
from typing import Any

_CODES = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 6: "b", 7: "s", 8: "h", 9: "i", 10: "ii"}
_CODES |= {11: "f", 12: "d", 13: "I"}
"""struct code of one value, by TIFF field type; 2 and 7 are bytes, 5 and 10 fractions."""

Directory = dict[int, tuple[Any, ...]]
"""Values by tag; text and opaque bytes come as one `bytes`."""


class TiffTags:
    """Reader of tag directories in a classic TIFF structure.

    Args:
        data: The structure, from its byte order mark on.

    Raises:
        ValueError: If it does not start like a TIFF.
    """

    def __init__(self, data: bytes) -> None:
        order = {b"II": "<", b"MM": ">"}.get(data[:2])
        if order is None or len(data) < 8 or struct.unpack_from(order + "H", data, 2)[0] != 42:
            raise ValueError("no TIFF header")
        self.data, self.order = data, order
        self.first = int(struct.unpack_from(order + "I", data, 4)[0])

    def directory(self, offset: int) -> Directory:
        """Return the tags of the directory at an offset; tags that lead nowhere are left out."""
        found: Directory = {}
        if not 0 < offset <= len(self.data) - 2:
            return found
        (count,) = struct.unpack_from(self.order + "H", self.data, offset)
        for i in range(count):
            at = offset + 2 + 12 * i
            if at + 12 > len(self.data):
                break
            tag, kind, number = struct.unpack_from(self.order + "HHI", self.data, at)
            values = self._values(at + 8, kind, number)
            if values is not None:
                found[tag] = values
        return found

    def _values(self, at: int, kind: int, number: int) -> tuple[Any, ...] | None:
        code = _CODES.get(kind)
        if code is None:
            return None
        size = struct.calcsize(self.order + code) * number
        if size > 4:
            (at,) = struct.unpack_from(self.order + "I", self.data, at)
        if at + size > len(self.data):
            return None
        if code == "s":
            return (self.data[at : at + size],)
        if len(code) == 1:
            return struct.unpack_from(f"{self.order}{number}{code}", self.data, at)
        parts = struct.unpack_from(f"{self.order}{2 * number}{code[0]}", self.data, at)
        pairs = zip(parts[::2], parts[1::2], strict=True)
        return tuple(top / bottom if bottom else math.nan for top, bottom in pairs)

    def text(self, directory: Directory, tag: int) -> str | None:
        """Return a tag as text, or None."""
        values = directory.get(tag)
        if not values or not isinstance(values[0], bytes):
            return None
        return values[0].split(b"\0")[0].decode("utf-8", "replace").strip() or None

    def numbers(self, directory: Directory, tag: int) -> tuple[float, ...]:
        """Return a tag as numbers; empty where it is absent, text or not finite."""
        values = directory.get(tag, ())
        if any(isinstance(value, bytes) or not math.isfinite(value) for value in values):
            return ()
        return tuple(float(value) for value in values)
