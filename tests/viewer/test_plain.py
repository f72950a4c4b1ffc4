"""The plain page: pictures, settings and errors over HTTP."""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Iterator
from urllib.parse import urlencode

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER
from hsvaos.settings import Settings
from hsvaos.viewer.picture import jpeg
from hsvaos.viewer.plain import PlainApp
from hsvaos.viewer.request import Focus
from hsvaos.viewer.session import Session


@pytest.fixture
def app(session: Session) -> Iterator[PlainApp]:
    made = PlainApp(session, port=0)
    yield made
    made.close()


def get(app: PlainApp, path: str, **values: object) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection(app.host, app.port, timeout=60)
    connection.request("GET", path + ("?" + urlencode(values) if values else ""))
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), content


def test_the_page_and_its_pictures(app: PlainApp) -> None:
    status, headers, page = get(app, "/")
    assert status == 200
    assert b'name="down"' in page
    assert b"$" not in page.split(b"<script>")[0]
    assert headers["Content-Type"].startswith("text/html")
    pictures = []
    for down in (-6.0, 0.0):
        status, headers, content = get(app, "/picture.jpg", down=down, tab="a", layer="plain")
        assert status == 200
        state = json.loads(headers["X-Status"])
        assert state["full"]
        assert state["frames"] == state["photos"] == 30
        pictures.append(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR))
    request = app.request({"down": "0.0", "layer": "plain"})
    assert request.focus == Focus(0.0)
    expected = app.session.render(request).rgb[..., ::-1]
    assert np.abs(pictures[1].astype(int) - expected).mean() < 4.0
    assert np.abs(pictures[0].astype(int) - expected).mean() > 8.0


def test_the_trees_vanish_once_all_photos_were_looked_into() -> None:
    photos = Settings().with_values(photos={"scale": 0.5})
    own = PlainApp(Session.open(hsvaos.open_flight(FOLDER), photos), port=0)
    try:
        pictures, states = [], []
        end = time.monotonic() + 120.0
        while (not states or states[-1]["soon"]) and time.monotonic() < end:
            _, headers, content = get(own, "/picture.jpg", tab="a", layer="ground", size=128)
            states.append(json.loads(headers["X-Status"]))
            pictures.append(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR))
            time.sleep(0.2)
        assert states[0]["soon"]
        assert "being looked into" in states[0]["note"]
        assert not states[-1]["soon"]
        assert states[-1]["note"] == ""
        apart = np.abs(pictures[0].astype(float) - pictures[-1].astype(float)).mean()
        assert apart > 5.0
    finally:
        own.close()


def test_the_relief_of_the_ground_is_found_once_and_followed() -> None:
    asked = Settings().with_values(photos={"scale": 0.5}, focus={"relief": True})
    own = PlainApp(Session.open(hsvaos.open_flight(FOLDER), asked), port=0)
    try:
        page = get(own, "/")[2].decode()
        assert 'name="terrain" value="1" checked>' in page
        states, pictures = [], []
        end = time.monotonic() + 120.0
        while (not states or states[-1]["soon"]) and time.monotonic() < end:
            values = {"tab": "a", "layer": "plain", "size": 256, "terrain": 1, "down": 0.0}
            status, headers, content = get(own, "/picture.jpg", **values)
            assert status == 200
            states.append(json.loads(headers["X-Status"]))
            pictures.append(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR))
            time.sleep(0.2)
        assert states[0]["soon"]
        assert states[0]["relief"] is None
        assert "finding the relief of the ground" in states[0]["note"]
        assert states[-1]["relief"]["found"]
        assert "about the focal plane" in states[-1]["relief"]["note"]
        request = own.request({"terrain": "1", "down": "0", "layer": "plain", "size": "256"})
        assert request.focus.terrain
        plane = own.request({"layer": "plain", "size": "256"})
        for picture, asked_for in ((pictures[0], plane), (pictures[-1], request)):
            sent = np.frombuffer(jpeg(own.session.render(asked_for).rgb), np.uint8)
            expected = cv2.imdecode(sent, cv2.IMREAD_COLOR).astype(int)
            assert np.abs(picture - expected).mean() < 0.5
        assert np.abs(pictures[0].astype(int) - pictures[-1]).mean() > 1.0
        toml = get(own, "/settings.toml", terrain=1, down=0.0)[2].decode()
        assert Settings.from_toml(toml).focus.relief is True
        state = json.loads(get(own, "/picture.jpg", layer="plain")[1]["X-Status"])
        assert (state["relief"], state["soon"]) == (None, False)
    finally:
        own.close()


def test_where_no_relief_is_found_the_page_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    small = Settings().with_values(photos={"scale": 0.25})
    own = PlainApp(Session.open(hsvaos.open_flight(FOLDER), small), port=0)
    try:
        assert 'value="1"></label>' in get(own, "/")[2].decode()  # nobody asked for it yet

        def fails(*_: object) -> str:
            raise ValueError("the photos are gone")

        monkeypatch.setattr(own.session, "find_relief", fails)
        end, state = time.monotonic() + 30.0, {"soon": True}
        while state["soon"] and time.monotonic() < end:
            state = json.loads(get(own, "/picture.jpg", terrain=1, down=0.5)[1]["X-Status"])
        assert state["relief"] == {"found": False, "note": "the photos are gone"}
        monkeypatch.undo()
        note = "too few rays of the ground agree"
        monkeypatch.setattr(own.session, "find_relief", lambda *_: note)
        status, _, content = get(own, "/picture.png", terrain=1, down=0.5)
        assert (status, content.decode()) == (400, note)
    finally:
        own.close()


def test_saved_settings_and_pictures(app: PlainApp) -> None:
    status, headers, content = get(app, "/settings.toml", down=-1.5, sigmas=1.25, radius=8)
    assert status == 200
    assert "attachment" in headers["Content-Disposition"]
    settings = Settings.from_toml(content.decode())
    assert (settings.focus.down_m, settings.mask.sigmas, settings.view.aperture_m) == (
        -1.5,
        1.25,
        8,
    )
    status, _, content = get(app, "/picture.png", down=-1.5)
    assert status == 200
    assert content.startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"down": "deep"}, "down must be a number, got 'deep'"),
        ({"down": "nan"}, "focus.down_m must be finite"),
        ({"down": "1e12"}, "focus.down_m must be at least"),
        ({"pitch": "89"}, "focus.pitch_deg must be at least -60"),
        ({"photo": "-4"}, "photo must lie in 0..29, got -4"),
        ({"sigmas": "0"}, "mask.sigmas must be a positive number"),
        ({"mask": "magic"}, "mask.method must be one of"),
        ({"layer": "x-ray"}, "layer must be one of"),
    ],
)
def test_absurd_values_are_named(app: PlainApp, values: dict[str, str], message: str) -> None:
    status, _, content = get(app, "/picture.jpg", **values)
    assert status == 400
    assert message in content.decode()


def test_where_no_relief_can_be_found_nobody_is_offered_one(
    app: PlainApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Session, "may_find_relief", False)
    assert b'type="checkbox"' not in get(app, "/")[2]
    status, _, content = get(app, "/picture.jpg", terrain=1)
    assert (status, "there is no terrain" in content.decode()) == (400, True)
    asked = app.session.settings.with_values(focus={"relief": True})
    monkeypatch.setattr(app.session, "settings", asked)
    assert b"found in RGB photos only" in get(app, "/")[2]


def test_other_paths_are_not_found(app: PlainApp) -> None:
    for path in ("/etc/passwd", "/../pyproject.toml", "/picture"):
        assert get(app, path)[0] == 404


def test_a_client_that_leaves_in_the_middle_of_a_picture(
    app: PlainApp, capfd: pytest.CaptureFixture[str]
) -> None:
    for _ in range(5):
        with socket.create_connection((app.host, app.port)) as line:
            line.sendall(b"GET /picture.png?photo=3 HTTP/1.1\r\nHost: x\r\n\r\n")
            line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    assert get(app, "/picture.jpg", down=0.0)[0] == 200
    assert capfd.readouterr().err == ""


def test_a_taken_port_moves_on(session: Session) -> None:
    first = PlainApp(session, port=0)
    second = PlainApp(session, port=first.port)
    try:
        assert second.port > first.port
        assert get(second, "/")[0] == 200
    finally:
        second.close()
        first.close()
    with pytest.raises(OSError, match="cannot listen at"):
        PlainApp(session, host="192.0.2.1", port=8080)
