"""The worker: newest first, nothing stale, errors told, nobody forgotten."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from hsvaos.settings import MaskSettings
from hsvaos.viewer.live import Live, Worker
from hsvaos.viewer.render import Picture
from hsvaos.viewer.request import Focus, Request
from hsvaos.viewer.session import Session

WAIT_S = 30.0


def fail(error: Exception) -> None:
    raise AssertionError(f"not expected: {error}")


def idle(live: Live, owner: str) -> None:
    end = time.monotonic() + WAIT_S
    while live.busy(owner):
        assert time.monotonic() < end
        time.sleep(0.01)


def test_only_the_newest_job_of_an_owner_is_done() -> None:
    worker = Worker("test")
    started, go = threading.Event(), threading.Event()
    done: list[str] = []

    def first(wanted: object) -> None:
        started.set()
        go.wait(WAIT_S)
        done.append(f"first {wanted()}")  # type: ignore[operator]

    worker.submit("me", "picture", first, fail)
    assert started.wait(WAIT_S)
    for i in range(5):
        worker.submit("me", "picture", lambda _, i=i: done.append(f"mine {i}"), fail)
    worker.submit("you", "picture", lambda _: done.append("yours"), fail)
    last = threading.Event()
    worker.submit("you", "other", lambda _: last.set(), fail)
    go.set()
    assert last.wait(WAIT_S)
    assert done == ["first False", "mine 4", "yours"]
    worker.close()


def test_errors_are_told_and_the_thread_goes_on() -> None:
    worker = Worker("test")
    told: list[Exception] = []
    done = threading.Event()

    def broken(_: object) -> None:
        raise ValueError("no such depth")

    def broken_report(error: Exception) -> None:
        told.append(error)
        raise RuntimeError("the tab was closed")

    worker.submit("a", "x", broken, told.append)
    worker.submit("b", "x", broken, broken_report)
    worker.submit("c", "x", lambda _: done.set(), fail)
    assert done.wait(WAIT_S)
    assert [str(error) for error in told] == ["no such depth"] * 2
    worker.close()
    worker.submit("d", "x", broken, fail)  # after the end nothing happens


def test_follow_ups_do_not_drop_newer_jobs() -> None:
    worker = Worker("test")
    done: list[str] = []
    finished = threading.Event()

    def job(wanted: object) -> None:
        worker.submit("me", "p", lambda _: finished.set(), fail)
        worker.submit(
            "me",
            "p",
            lambda _: done.append("stale"),
            fail,
            only_if=wanted,  # type: ignore[arg-type]
        )

    worker.submit("me", "p", job, fail)
    assert finished.wait(WAIT_S)
    worker.close()
    assert done == []


def test_coarse_while_moving_then_full_and_never_stale(
    session: Session, request_: Request, live: Live
) -> None:
    live.pace.ns_a_ray = 200.0  # a slow machine
    live.pace.measured = lambda rays, ms: None  # type: ignore[method-assign]
    shown: list[Picture] = []
    asked = replace(request_, moving=True)
    rng = np.random.default_rng(3)
    for down in rng.uniform(-8.0, 3.0, 40):
        asked = replace(asked, focus=Focus(float(down)))
        live.show("tab", asked, shown.append, fail)
        time.sleep(0.005)
    idle(live, "tab")
    assert shown[-1].request is asked
    assert shown[-1].quality.full
    assert any(not picture.quality.full for picture in shown)
    np.testing.assert_array_equal(shown[-1].rgb, session.render(asked).rgb)
    assert len(shown) <= 42


def test_pictures_come_although_events_come_faster(
    session: Session, request_: Request, live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = session.render

    def slow(*arguments: object) -> Picture:
        time.sleep(0.03)
        return original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(session, "render", slow)
    shown: list[Picture] = []
    for i in range(100):
        asked = replace(request_, focus=Focus(-0.01 * i), moving=True)
        live.show("tab", asked, shown.append, fail)
        time.sleep(0.01)
    while_moving = len(shown)
    idle(live, "tab")
    assert while_moving >= 5
    assert shown[-1].request is asked


def test_masks_not_made_yet_are_previewed(request_: Request, live: Live) -> None:
    shown: list[Picture] = []
    asked = replace(request_, moving=True, mask=MaskSettings(sigmas=1.2345))
    live.show("tab", asked, shown.append, fail)
    idle(live, "tab")
    assert [picture.quality.full for picture in shown] == [False, True]
    small, large = (np.asarray(picture.rgb, float).mean(axis=(0, 1)) for picture in shown)
    assert np.abs(small - large).max() < 40.0


def test_an_owner_who_left_gets_nothing_more(request_: Request, live: Live) -> None:
    entered, go = threading.Event(), threading.Event()
    shown: list[Picture] = []

    def deliver(picture: Picture) -> None:
        shown.append(picture)
        entered.set()
        go.wait(WAIT_S)

    live.pace.ns_a_ray = 1e4
    live.show("tab", replace(request_, moving=True), deliver, fail)
    assert entered.wait(WAIT_S)
    live.background("tab", "film", lambda _: shown.append(None), fail, delay_s=0.05)  # type: ignore[arg-type]
    live.forget("tab")  # closed in the middle of a picture
    go.set()
    time.sleep(0.5)
    assert len(shown) == 1
    assert not live.busy("tab")


def test_several_owners_take_turns(session: Session, request_: Request, live: Live) -> None:
    shown: dict[str, Picture] = {}
    requests = {f"tab {i}": replace(request_, focus=Focus(-float(i))) for i in range(4)}
    for owner, asked in requests.items():
        live.show(owner, asked, lambda p, owner=owner: shown.update({owner: p}), fail)
    for owner in requests:
        idle(live, owner)
    for owner, asked in requests.items():
        np.testing.assert_array_equal(shown[owner].rgb, session.render(asked).rgb)


@pytest.mark.parametrize("focus", [Focus(terrain=True)])
def test_a_request_that_raises_is_reported(request_: Request, live: Live, focus: Focus) -> None:
    told: list[Exception] = []
    shown: list[Picture] = []
    live.show("tab", replace(request_, focus=focus), shown.append, told.append)
    idle(live, "tab")
    live.show("tab", request_, shown.append, told.append)
    idle(live, "tab")
    assert len(told) == 1
    assert "there is no terrain" in str(told[0])
    assert len(shown) == 1
