"""Size, channels and completeness of image files, told from their bytes without decoding.

OpenCV decodes a cut-off file half grey and says so on the standard error stream only; therefore
the structure is walked to its end marker here (JPEG: ITU-T T.81; PNG: ISO 15948; TIFF 6.0).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

from hsvaos.formats.tiff import TiffTags

PNG_START = b"\x89PNG\r\n\x1a\n"
JPEG_START = b"\xff\xd8\xff"
TIFF_STARTS = (b"II*\0", b"MM\0*")

_MARKER_IN_SCAN = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])", re.DOTALL)
"""A marker in compressed JPEG data that is neither a stuffed 0xff nor a restart."""
_FRAME_MARKERS = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}


class ImageHeader(NamedTuple):
    """What the start of an image file says.

    Args:
        width: Columns [px].
        height: Rows [px].
        channels: 1 for grey, 3 for colour; alpha not counted.
    """

    width: int
    height: int
    channels: int


def is_image(start: bytes) -> bool:
    """Whether a file that begins with these bytes is a JPEG, PNG or TIFF."""
    return start.startswith((PNG_START, JPEG_START, *TIFF_STARTS))


def read_header(data: bytes) -> ImageHeader | None:
    """Return size and channels, or None where the bytes do not say.

    Args:
        data: The file, or enough of its start.
    """
    try:
        if data.startswith(JPEG_START):
            return _jpeg_header(data)
        if data.startswith(PNG_START):
            width, height, _, colour = struct.unpack_from(">IIBB", data, 16)
            return ImageHeader(width, height, 1 if colour in (0, 4) else 3)
        if data.startswith(TIFF_STARTS):
            return _tiff_header(data)
    except (struct.error, ValueError):
        pass
    return None


def fault(data: bytes) -> str | None:
    """Return what keeps an image file from being whole, or None.

    Args:
        data: The whole file.
    """
    try:
        if data.startswith(JPEG_START):
            return None if _jpeg_ends(data) else "truncated JPEG: no end marker after its picture"
        if data.startswith(PNG_START):
            return _png_fault(data)
        if data.startswith(TIFF_STARTS):
            return None if _tiff_ends(data) else "truncated TIFF: its picture lies beyond the end"
    except (struct.error, ValueError):
        return "truncated image: its header ends too early"
    return None


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield marker, start and end of the content of each JPEG segment up to the first scan.

    The last one yielded is the start-of-scan segment, where there is one.
    """
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            return
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker == 0x01 or 0xD0 <= marker <= 0xD9:  # markers without content
            at += 2
            continue
        (length,) = struct.unpack_from(">H", data, at + 2)
        yield marker, at + 4, at + 2 + length
        if marker == 0xDA:
            return
        at += 2 + length


def _jpeg_header(data: bytes) -> ImageHeader | None:
    for marker, start, _ in jpeg_segments(data):
        if marker in _FRAME_MARKERS:
            height, width, components = struct.unpack_from(">HHB", data, start + 1)
            return ImageHeader(width, height, 1 if components == 1 else 3)
    return None


def _jpeg_ends(data: bytes) -> bool:
    at = -1
    for marker, _, end in jpeg_segments(data):
        if marker == 0xDA:
            at = end
    while at >= 0:
        found = _MARKER_IN_SCAN.search(data, at)
        if found is None:
            return False
        if found[1] == b"\xd9":
            return True
        # Another scan or table of a progressive picture: step over its content.
        if found.end() + 2 > len(data):
            return False
        at = found.end() + int(struct.unpack_from(">H", data, found.end())[0])
    return False


def _png_fault(data: bytes) -> str | None:
    view, at = memoryview(data), len(PNG_START)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, end = data[at + 4 : at + 8], at + 8 + int(length)
        if end + 4 > len(data):
            break
        # OpenCV draws what it can of a damaged picture, too.
        if zlib.crc32(view[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return f"damaged PNG: wrong checksum of its chunk {kind.decode('ascii', 'replace')}"
        if kind == b"IEND":
            return None
        at = end + 4
    return "truncated PNG: no IEND chunk"


def _tiff_header(data: bytes) -> ImageHeader | None:
    tags = TiffTags(data)
    first = tags.directory(tags.first)
    width, height = tags.numbers(first, 256), tags.numbers(first, 257)
    samples = tags.numbers(first, 277) or (1.0,)
    palette = tags.numbers(first, 262) == (3.0,)
    if not width or not height:
        return None
    return ImageHeader(int(width[0]), int(height[0]), 3 if samples[0] >= 3 or palette else 1)


def _tiff_ends(data: bytes) -> bool:
    tags = TiffTags(data)
    first = tags.directory(tags.first)
    for offsets_tag, counts_tag in ((273, 279), (324, 325)):  # strips, tiles
        offsets, counts = tags.numbers(first, offsets_tag), tags.numbers(first, counts_tag)
        if offsets and counts:
            pairs = zip(offsets, counts, strict=False)
            return all(offset + count <= len(data) for offset, count in pairs)
    return False
