"""The newest of a stream of pictures as a page: no extra needed, and no work without a browser."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape
from http import HTTPStatus
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from hsvaos.viewer.answers import Answers, PageServer
from hsvaos.viewer.picture import Rgb, jpeg

_PAGE = Path(__file__).with_name("stream.html")
_PATIENCE_S = 10.0
_LOOK_EVERY_S = 0.02


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture of the stream.

    Args:
        rgb: Shape (H, W, 3), uint8.
        status: What the page says of it.
    """

    rgb: Rgb
    status: dict[str, Any] = field(default_factory=dict)


class Stream(PageServer):
    """A small server of one page that shows the newest picture.

    The page asks for the next picture when it has one, so that a slow line gets fewer, never late
    ones.

    Args:
        name: What to call the stream.
        newest: Returns the number of the newest picture; -1 before the first one.
        draw: Returns the newest picture; called by the threads of the browsers only.
        host: Address to listen at.
        port: Port to listen at; the next free one if it is taken.

    Raises:
        OSError: If the address or all ports from there cannot be used.
    """

    def __init__(
        self,
        name: str,
        newest: Callable[[], int],
        draw: Callable[[], Shown | None],
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        self._name, self._newest, self._draw = name, newest, draw
        self._closed = threading.Event()

        class Handler(_Handler):
            stream = self

        super().__init__(Handler, host, port)

    def page(self) -> bytes:
        """Return the page."""
        text = Template(_PAGE.read_text(encoding="utf-8")).substitute(name=escape(self._name))
        return text.encode("utf-8")

    def after(self, number: int) -> tuple[int, Shown] | None:
        """Wait for a picture of another number; None if none comes for a while."""
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end and not self._closed.wait(_LOOK_EVERY_S):
            newest = self._newest()
            if newest not in (number, -1):
                shown = self._draw()
                return None if shown is None else (newest, shown)
        return None

    def close(self) -> None:
        """Stop the server."""
        self._closed.set()
        super().close()


class _Handler(Answers):
    """One request of a browser."""

    stream: Stream

    def answer(self) -> None:
        """Answer with the page or the next picture."""
        parts = urlsplit(self.path)
        if parts.path == "/":
            self.send(self.stream.page(), "text/html; charset=utf-8")
        elif parts.path == "/picture.jpg":
            self._picture(dict(parse_qsl(parts.query)).get("after", "-1"))
        else:
            self.send(b"not found", "text/plain", HTTPStatus.NOT_FOUND)

    def _picture(self, after: str) -> None:
        try:
            number = int(after)
        except ValueError:
            text = f"after must be a number, got {after!r:.40}"
            self.send(text.encode(), "text/plain; charset=utf-8", HTTPStatus.BAD_REQUEST)
            return
        found = self.stream.after(number)
        if found is None:
            self.send(b"", "text/plain", HTTPStatus.NO_CONTENT)
            return
        status = json.dumps({"number": found[0], **found[1].status})
        self.send(jpeg(found[1].rgb), "image/jpeg", extra={"X-Status": status})
