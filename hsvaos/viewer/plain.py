"""The viewer as a plain page, for browsers without WebGL: a picture, sliders, and no more."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
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

_HIDDEN = '<input type="hidden" name="terrain" value="{on}">'
_CHECKBOX = (
    '<label title="Follow the relief of the ground: found once, by a look into all photos">'
    'Relief <input type="checkbox" id="relief" name="terrain" value="1"{checked}></label>'
)
_NO_RELIEF = "the settings ask for the relief of the ground, which is found in RGB photos only"

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
        self._lock, self._running = threading.Lock(), set[str]()
        self._step, self._failed = "", ""

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
        mask, notes = session.settings.mask, session.notes
        if session.settings.focus.relief is True and not session.start.terrain:
            notes = notes if session.may_find_relief else (*notes, _NO_RELIEF)
        terrain = _HIDDEN.format(on=int(session.start.terrain))
        if session.may_find_relief:
            asked = session.settings.focus.relief is True
            terrain = _CHECKBOX.format(checked=" checked" if asked else "")
        text = Template(_PAGE.read_text(encoding="utf-8")).substitute(
            name=escape(session.flight.name),
            first=f"{first:.2f}",
            last=f"{last:.2f}",
            down=f"{session.start.down_m:.2f}",
            terrain=terrain,
            relief_range=json.dumps(session.depth_range(True)),
            sigmas=mask.sigmas,
            photos=len(session.flight) - 1,
            photo=session.flight.centre_index,
            layers=_options(LAYERS, "masked"),
            masks=_options(MASKS, mask.method),
            notes="".join(f"<li>{escape(note)}</li>" for note in notes),
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
        if self._has_no_relief(request):
            return self._until_relief(request, owner)
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

    def at_rest(self, request: Request) -> Request:
        """Return a request that is to be saved, once what it needs was found.

        Raises:
            ValueError: If there is no relief of the ground where one is asked for.
        """
        if self._has_no_relief(request):
            note = self.session.find_relief(request.mask)
            if self.session.terrain is None:
                raise ValueError(note)
        return request

    def relief_state(self, request: Request) -> dict[str, Any] | None:
        """Return what came of the relief that a request asks for, None while it is looked for.

        What went wrong is told once: who asks again has it tried again.
        """
        if not request.focus.terrain:
            return None
        note, self._failed = self._failed or self.session.relief_note, ""
        if note is None:
            return None
        return {"found": self.session.terrain is not None, "note": note}

    def _has_no_relief(self, request: Request) -> bool:
        session = self.session
        return request.focus.terrain and session.terrain is None and session.may_find_relief

    def _until_relief(self, request: Request, owner: str) -> Picture | None:
        """Return the picture on the plane, and find the relief in the background."""
        start = self.session.start
        plane = replace(start, down_m=start.down_m + request.focus.down_m)
        picture = self.picture(replace(request, focus=plane), owner)
        if picture is None or self._failed:
            return picture
        if self.session.relief_note is not None:  # found meanwhile, or sought in vain
            return replace(picture, stand_in=self.session.terrain is not None)

        def tell(step: str, done: int, total: int) -> None:
            self._step = f"{step} {done} of {total}"

        def job(wanted: Wanted) -> None:
            self.session.find_relief(request.mask, wanted, tell)

        def failed(error: Exception) -> None:
            self._failed = str(error)

        self._once("relief", job, failed)
        note = f"finding the relief of the ground: {self._step}".rstrip(": ")
        return replace(picture, note=note, stand_in=True)

    def _look(self, request: Request) -> None:
        """Look into all photos; the page asks again meanwhile."""

        def job(wanted: Wanted) -> None:
            self.session.look(request.mask, wanted)

        def failed(error: Exception) -> None:
            _log.warning("the photos could not be looked into: %s", error)

        self._once("look", job, failed)

    def _once(
        self, kind: str, job: Callable[[Wanted], None], failed: Callable[[Exception], None]
    ) -> None:
        """Do something in the background, unless it is being done."""
        with self._lock:
            if kind in self._running:
                return
            self._running.add(kind)

        def done(wanted: Wanted) -> None:
            job(wanted)
            self._running.discard(kind)

        def gone_wrong(error: Exception) -> None:
            failed(error)
            self._running.discard(kind)

        self.live.background(self, kind, done, gone_wrong)


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
                picture = self.app.session.render(self.app.at_rest(self.app.request(values)))
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
        request = self.app.request(values)
        picture = self.app.picture(request, values.get("tab", ""))
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
            "relief": self.app.relief_state(request),
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
