"""What cameras write into photos: Exif (JEITA CP-3451) and XMP (ISO 16684), the parts needed."""

from __future__ import annotations

import html
import math
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from hsvaos.flight import FlightError
from hsvaos.formats.header import JPEG_START, TIFF_STARTS, jpeg_segments
from hsvaos.formats.tiff import Directory, TiffTags

_EXIF_START = b"Exif\0\0"
_XMP_START = b"http://ns.adobe.com/xap/1.0/\0"

_START_BYTES = 1 << 18
"""Read first; holds the tags of most JPEG photos."""

# Looking back keeps a search through a long word, such as an embedded preview, linear.
_ATTRIBUTE = re.compile(r"""(?<![\w.-])[\w.-]+:([\w.-]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_ELEMENT = re.compile(r"<([\w.-]+):([\w.-]+)[^<>]*>([^<>]*)</\1:\2\s*>")


@dataclass(frozen=True)
class PhotoTags:
    """What a photo says about itself; None where it is silent.

    Args:
        make: Maker of the camera.
        model: Its model.
        time_s: Local clock time of exposure, seconds since 1970 as if it were UTC.
        focal_mm: Focal length [mm].
        focal_35mm: Focal length of equal field on 36 x 24 mm film [mm].
        lat_deg: Latitude [deg], from the GPS tags.
        lon_deg: Longitude [deg].
        height_m: Height above sea level [m].
        xmp: Values of the XMP packet by local name ("GimbalYawDegree"), as text.
    """

    make: str | None = None
    model: str | None = None
    time_s: float | None = None
    focal_mm: float | None = None
    focal_35mm: float | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    height_m: float | None = None
    xmp: dict[str, str] = field(default_factory=dict)

    def xmp_number(self, *names: str) -> float | None:
        """Return the first of the XMP values that is a finite number, or None."""
        for name in names:
            try:
                value = float(self.xmp.get(name, ""))
            except ValueError:
                continue
            if math.isfinite(value):
                return value
        return None


def read_tags(path: Path) -> PhotoTags:
    """Return the tags of a JPEG or TIFF photo; empty ones for other images.

    Raises:
        FlightError: If the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_START_BYTES)
            segments = list(jpeg_segments(data)) if data.startswith(JPEG_START) else []
            # A TIFF may keep its tags anywhere, a JPEG before its picture (marker 0xda).
            if data.startswith(TIFF_STARTS) or (segments and segments[-1][0] != 0xDA):
                data += file.read()
    except OSError as error:
        raise FlightError(f"{path}: cannot be read ({error.strerror})") from None
    exif, packet = b"", b""
    if segments:
        for marker, start, end in jpeg_segments(data):
            content = data[start:end] if marker == 0xE1 else b""
            if content.startswith(_EXIF_START) and not exif:
                exif = content[len(_EXIF_START) :]
            elif content.startswith(_XMP_START) and not packet:
                packet = content[len(_XMP_START) :]
    elif data.startswith(TIFF_STARTS):
        exif = data
    if not exif:
        return PhotoTags(xmp=xmp_values(packet))
    try:
        tags = TiffTags(exif)
    except ValueError:
        return PhotoTags(xmp=xmp_values(packet))
    first = tags.directory(tags.first)
    if not packet and 700 in first and isinstance(first[700][0], bytes):
        packet = first[700][0]
    elif not packet and 700 in first:  # some writers store the packet as plain numbers
        packet = bytes(int(value) & 0xFF for value in first[700])
    return _from_directories(tags, first, xmp_values(packet))


def xmp_values(packet: bytes) -> dict[str, str]:
    """Return the simple values of an XMP packet by local name, attributes and elements alike.

    Makers' packets are not always well-formed XML, therefore no XML parser is used.

    Args:
        packet: The packet, UTF-8.
    """
    text = packet.decode("utf-8", "replace")
    values: dict[str, str] = {}
    for match in _ATTRIBUTE.finditer(text):
        values.setdefault(match[1], html.unescape(match[2] if match[2] is not None else match[3]))
    for match in _ELEMENT.finditer(text):
        values.setdefault(match[2], html.unescape(match[3]).strip())
    return values


def _from_directories(tags: TiffTags, first: Directory, xmp: dict[str, str]) -> PhotoTags:
    def below(tag: int) -> Directory:
        offset = tags.numbers(first, tag)
        return tags.directory(int(offset[0])) if offset else {}

    exif, gps = below(0x8769), below(0x8825)

    def positive(tag: int) -> float | None:
        values = tags.numbers(exif, tag)
        return values[0] if values and values[0] > 0.0 else None

    height = tags.numbers(gps, 6)
    below_sea = gps.get(5, (0,))[0] in (1, b"\x01")
    return PhotoTags(
        make=tags.text(first, 0x010F),
        model=tags.text(first, 0x0110),
        time_s=_time_s(tags.text(exif, 0x9003), tags.text(exif, 0x9291)),
        focal_mm=positive(0x920A),
        focal_35mm=positive(0xA405),
        lat_deg=_degrees(tags.numbers(gps, 2), tags.text(gps, 1), 90.0),
        lon_deg=_degrees(tags.numbers(gps, 4), tags.text(gps, 3), 180.0),
        height_m=(-height[0] if below_sea else height[0]) if height else None,
        xmp=xmp,
    )


def _degrees(parts: tuple[float, ...], side: str | None, most: float) -> float | None:
    if not 1 <= len(parts) <= 3:
        return None
    value = sum(part / 60.0**i for i, part in enumerate(parts))
    if value > most:
        return None
    return -value if side is not None and side.upper() in ("S", "W") else value


def _time_s(text: str | None, fraction: str | None) -> float | None:
    try:
        time = datetime.strptime(text or "", "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    digits = fraction if fraction is not None and fraction.isdigit() else "0"
    return time.timestamp() + float("0." + digits)
