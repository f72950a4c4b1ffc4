"""The viewer as a plain page, for browsers without WebGL: a picture, sliders, and no more."""

from __future__ import annotations

import json
import logging
import threading
from dataclasses import replace
from html import escape
from http import HTTPStatus
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from hsvaos.camera import VirtualCamera
from hsvaos.settings import MASKS
from hsvaos.viewer.answers import Answers, PageServer
from hsvaos.viewer.geometry import fitted
from hsvaos.viewer.live import Live
from hsvaos.viewer.picture import jpeg, png
from hsvaos.viewer.render import Picture
from hsvaos.viewer.request import LAYERS, Aperture, Focus, Look, Request
from hsvaos.viewer.saving import settings_toml
from hsvaos.viewer.session import Session
from hsvaos.viewer.weights import Wanted

_PAGE = Path(__file__).with_name("plain.html")
_WAIT_S = 60.0
_LONGEST_PX = 1280

_log = logging.getLogger("hsvaos")


class PlainApp(PageServer):
    """A small server of one page, its pictures and its settings.

    The page asks for one picture at a time and for the newest values, so a slow line gets fewer
    pictures, never late ones.

    Args:
        session: The flight.
        host: Address to listen at.
        port: Port to listen at; the next free one if it is taken.

    Raises:
        OSError: If the address or all ports from there cannot be used.
    """

    def __init__(self, session: Session, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.session, self.live = session, Live(session)
        self._lock, self._looking = threading.Lock(), False

        class Handler(_Handler):
            app = self

        super().__init__(Handler, host, port)

    def close(self) -> None:
        """Drop all work and stop the server."""
        self.live.close()
        super().close()

    def page(self) -> bytes:
        """Return the page."""
        session = self.session
        first, last = session.depth_range(session.start.terrain)
        mask = session.settings.mask
        text = Template(_PAGE.read_text(encoding="utf-8")).substitute(
            name=escape(session.flight.name),
            first=f"{first:.2f}",
            last=f"{last:.2f}",
            down=f"{session.start.down_m:.2f}",
            terrain=int(session.start.terrain),
            sigmas=mask.sigmas,
            photos=len(session.flight) - 1,
            photo=session.flight.centre_index,
            layers=_options(LAYERS, "masked"),
            masks=_options(MASKS, mask.method),
            notes="".join(f"<li>{escape(note)}</li>" for note in session.notes),
        )
        return text.encode("utf-8")

    def request(self, values: dict[str, str]) -> Request:
        """Return the request that a query stands for.

        Raises:
            ValueError: If a value makes no sense; the message says which.
        """
        count = len(self.session.flight)
        start = self.session.start
        index = _number(values, "photo", self.session.flight.centre_index, int)
        if not 0 <= index < count:
            raise ValueError(f"photo must lie in 0..{count - 1}, got {index}")
        view = self.session.flight.view(index)
        camera = self.session.flight.camera.without_distortion()
        longest = _number(values, "size", _LONGEST_PX, int)
        size = fitted((camera.width, camera.height), max(16, min(longest, _LONGEST_PX)))
        radius = _number(values, "radius", 0.0, float)
        base = self.session.settings.mask
        return Request(
            VirtualCamera(camera.scaled(*size), view.world_from_camera),
            Focus(
                _number(values, "down", start.down_m, float),
                _number(values, "pitch", start.pitch_deg, float),
                _number(values, "roll", start.roll_deg, float),
                terrain=bool(_number(values, "terrain", int(start.terrain), int)),
            ),
            Aperture(radius if radius else None),
            replace(
                base,
                method=values.get("mask", base.method),
                sigmas=_number(values, "sigmas", base.sigmas, float),
            ),
            Look(_number(values, "contrast", 1.0, float)),
            values.get("layer", "masked"),
            moving=values.get("moving") == "1",
        )

    def picture(self, request: Request, owner: str) -> Picture | None:
        """Return a picture; None where a newer request of the same page has come meanwhile.

        Raises:
            ValueError: If it cannot be shown.
        """
        done = threading.Event()
        outcome: list[Any] = []

        def settle(value: Any) -> None:
            outcome.append(value)
            done.set()

        self.live.once(owner, request, settle, settle, done.set)
        done.wait(_WAIT_S)
        if outcome and isinstance(outcome[0], Exception):
            raise outcome[0]
        picture: Picture | None = outcome[0] if outcome else None
        if picture is not None and picture.stand_in:
            self._look(request)
        return picture

    def _look(self, request: Request) -> None:
        """Look into all photos, in the background and once; the page asks again meanwhile."""
        with self._lock:
            if self._looking:
                return
            self._looking = True

        def job(wanted: Wanted) -> None:
            self.session.look(request.mask, wanted)
            self._looking = False

        def failed(error: Exception) -> None:
            self._looking = False
            _log.warning("the photos could not be looked into: %s", error)

        self.live.background(self, "look", job, failed)


class _Handler(Answers):
    """One request of a browser."""

    app: PlainApp

    def answer(self) -> None:
        """Answer with the page, a picture or the settings."""
        parts = urlsplit(self.path)
        values = dict(parse_qsl(parts.query))
        try:
            if parts.path == "/":
                self.send(self.app.page(), "text/html; charset=utf-8")
            elif parts.path == "/picture.jpg":
                self._picture(values)
            elif parts.path == "/picture.png":
                picture = self.app.session.render(self.app.request(values))
                self.send(png(picture.rgb), "image/png", save="hsvaos.png")
            elif parts.path == "/settings.toml":
                text = settings_toml(self.app.session, self.app.request(values))
                self.send(text.encode(), "application/toml", save="settings.toml")
            else:
                self.send(b"not found", "text/plain", HTTPStatus.NOT_FOUND)
        except (ValueError, TypeError) as error:
            text = " ".join(str(error).split())
            self.send(text.encode(), "text/plain; charset=utf-8", HTTPStatus.BAD_REQUEST)

    def _picture(self, values: dict[str, str]) -> None:
        picture = self.app.picture(self.app.request(values), values.get("tab", ""))
        if picture is None:
            self.send(b"", "text/plain", HTTPStatus.NO_CONTENT)
            return
        status = {
            "frames": picture.frames,
            "photos": len(self.app.session.flight),
            "ms": round(picture.ms),
            "device": self.app.session.device.alias,
            "full": picture.quality.full,
            "note": picture.note,
            "soon": picture.stand_in,
        }
        extra = {"X-Status": json.dumps(status)}
        self.send(jpeg(picture.rgb), "image/jpeg", extra=extra)


def _number(values: dict[str, str], name: str, default: Any, kind: type) -> Any:
    if name not in values:
        return default
    try:
        return kind(values[name])
    except ValueError:
        raise ValueError(f"{name} must be a number, got {values[name]!r:.40}") from None


def _options(names: tuple[str, ...], chosen: str) -> str:
    return "".join(
        f"<option{' selected' if name == chosen else ''}>{name}</option>" for name in names
    )
