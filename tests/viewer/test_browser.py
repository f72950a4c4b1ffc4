"""The viewer in headless Chromium, on the demo flight."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER
from hsvaos.settings import Settings
from hsvaos.viewer.app import App
from hsvaos.viewer.geometry import browser_view
from hsvaos.viewer.picture import integral_picture
from hsvaos.viewer.plain import PlainApp
from hsvaos.viewer.request import Focus, Request
from hsvaos.viewer.session import Session
from hsvaos.viewer.tab import Tab

pytestmark = pytest.mark.slow

SIZE = (1000, 640)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SOFTWARE_GL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    pytest.importorskip("viser", reason="viser is not installed: pip install 'hsvaos[viewer]'")
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine")
    with playwright.sync_playwright() as started:
        made = started.chromium.launch(
            executable_path=CHROMIUM, args=[*SOFTWARE_GL, "--no-sandbox"]
        )
        yield made
        made.close()


@pytest.fixture(scope="module")
def flight_session() -> Session:
    return Session.open(hsvaos.open_flight(FOLDER))


@pytest.fixture
def app(flight_session: Session) -> Iterator[App]:
    made = App(flight_session, port=0)
    yield made
    made.close()


@pytest.fixture
def page(app: App, browser: Any) -> Iterator[Any]:
    made = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]}, accept_downloads=True)
    foreign: list[str] = []
    made.on("request", lambda r: foreign.append(r.url) if app.url not in r.url else None)
    made.goto(app.url)
    yield made
    made.close()
    assert foreign == []  # works without the internet


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.05)


def tab_of(app: App, page: Any, number: int = 0) -> Tab:
    until(lambda: len(app.tabs) > number)
    tab = app.tabs[number]
    settled(tab)
    page.wait_for_timeout(500)
    return tab


def settled(tab: Tab) -> None:
    """Wait until the picture stands still, in full."""
    until(lambda: tab.last is not None and not tab.live.busy(tab))
    until(lambda: "coarse" not in tab.controls.status.content)


def box(page: Any, label: str) -> Any:
    """The number box beside a slider."""
    row = page.locator("div", has_text=label).filter(has=page.locator("input[inputmode]"))
    return row.last.locator("input[inputmode]").first


def on_screen(page: Any) -> np.ndarray:
    """The part of the screen without panel and notices, RGB."""
    content = np.frombuffer(page.screenshot(), np.uint8)
    picture = cv2.cvtColor(cv2.imdecode(content, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    return picture[SIZE[1] // 3 :, : SIZE[0] // 2]


def by_the_api(session: Session, request: Request, down_m: float) -> np.ndarray:
    """The same part of the picture that Integrator renders at a depth."""
    integrator = session.weights.integrator("plain", request.mask)
    image, footprint = integrator.integrate(request.view, hsvaos.FocalPlane(down_m))
    picture = integral_picture(image.numpy(), footprint.numpy(), request.look)
    whole = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)
    return whole[SIZE[1] // 3 :, : SIZE[0] // 2]


def unlike(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference of two pictures in grey levels; blurred, as software WebGL halves pixels."""
    soft = [cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 2.0) for picture in (a, b)]
    return float(np.abs(soft[0] - soft[1]).mean())


def test_the_depth_slider_changes_the_picture_to_the_one_of_the_api(app: App, page: Any) -> None:
    tab = tab_of(app, page)
    tab.controls.show_outline.value = tab.controls.show_finds.value = False
    tab.controls.layer.value = "Integral, plain"
    settled(tab)
    page.wait_for_timeout(1500)
    first = on_screen(page)
    request = tab.last
    assert request is not None
    start = request.focus.down_m
    assert unlike(first, by_the_api(tab.session, request, start)) < 4.0

    place = page.get_by_role("slider").first.bounding_box()
    x, y = place["x"] + 0.5 * place["width"], place["y"] + 0.5 * place["height"]
    page.mouse.move(x, y)  # dragged: arrow keys turn the browser's camera too
    page.mouse.down()
    page.mouse.move(x - 20.0, y, steps=5)
    page.mouse.up()
    until(lambda: tab.last is not None and tab.last.focus.down_m < start - 1.0)
    settled(tab)
    page.wait_for_timeout(1500)
    second = on_screen(page)
    asked = tab.last
    assert asked is not None
    np.testing.assert_allclose(
        asked.view.world_from_camera, request.view.world_from_camera, atol=1e-6
    )
    assert unlike(second, by_the_api(tab.session, asked, asked.focus.down_m)) < 4.0
    assert unlike(second, by_the_api(tab.session, asked, start)) > 6.0
    assert unlike(second, first) > 6.0


def test_number_box_and_keys_move_the_depth(app: App, page: Any) -> None:
    tab = tab_of(app, page)
    number = box(page, "Depth [m]")
    number.fill("-2.5")
    number.press("Enter")
    until(lambda: tab.last is not None and tab.last.focus == Focus(-2.5))
    number.fill("9999999")  # absurd: held within the slider
    number.press("Tab")
    until(lambda: tab.last is not None and tab.last.focus.down_m != -2.5)
    assert tab.last is not None
    assert tab.last.focus.down_m <= tab.controls.depth.max
    number.fill("-2.5")
    number.press("Enter")
    page.evaluate("document.activeElement.blur()")
    until(lambda: tab.last is not None and tab.last.focus == Focus(-2.5))
    page.wait_for_timeout(500)  # values wait 50 ms and more in the browser, and keys overtake them
    page.keyboard.press("PageDown")
    until(lambda: tab.last is not None and tab.last.focus.down_m == pytest.approx(-2.4))
    page.wait_for_timeout(500)
    page.keyboard.press("Shift+PageUp")
    until(lambda: tab.last is not None and tab.last.focus.down_m == pytest.approx(-3.4))
    settled(tab)


def test_a_click_on_a_photo_goes_there(app: App, page: Any) -> None:
    tab = tab_of(app, page)
    page.get_by_text("Overview").click()
    until(lambda: tab.last is not None and tab.last.view.is_ortho)
    settled(tab)
    page.wait_for_timeout(1500)
    started = tab.controls.photo.value
    view = browser_view_of(tab)
    away = np.linalg.norm(tab.session.places - tab.client.camera.position, axis=1)
    pose = tab.session.flight.poses[int(np.argmin(away))]  # nothing stands before the nearest
    for part in (0.5, 0.7, 0.9, 0.3, 1.1):
        u, v = view.project(pose[:3, 3] + part * tab.scene.frustum_m * pose[:3, 2])
        page.mouse.click(float(u) + 0.5, float(v) + 0.5)
        page.wait_for_timeout(800)
        if tab.controls.layer.value == "Nearest photo":
            break
    assert tab.controls.layer.value == "Nearest photo"
    index = tab.controls.photo.value
    assert index != started
    pose = tab.session.flight.poses[index]
    until(lambda: tab.last is not None and not tab.last.view.is_ortho)
    until(lambda: np.allclose(tab.client.camera.position, pose[:3, 3], atol=1e-3))
    settled(tab)
    assert tab.last is not None
    assert tab.session.nearest(tab.last.view) == index


def browser_view_of(tab: Tab) -> hsvaos.VirtualCamera:
    camera = tab.client.camera
    return browser_view(camera.wxyz, camera.position, camera.fov, SIZE)


def test_settings_are_saved(app: App, page: Any, tmp_path: Path) -> None:
    tab = tab_of(app, page)
    tab.controls.depth.value = -1.25
    tab.controls.sigmas.value = 1.5
    settled(tab)
    page.get_by_role("tab", name="Save").click()
    with page.expect_download() as started:
        page.get_by_text("Settings (TOML)").click()
    path = tmp_path / "settings.toml"
    started.value.save_as(path)
    settings = Settings.from_file(path)
    assert settings.focus.down_m == -1.25
    assert settings.mask.sigmas == 1.5
    with page.expect_download() as started:
        page.get_by_text("Picture (PNG)").click()
    started.value.save_as(tmp_path / "picture.png")
    picture = cv2.imread(str(tmp_path / "picture.png"))
    assert tab.last is not None
    assert np.abs(picture[..., ::-1].astype(int) - tab.session.render(tab.last).rgb).max() == 0


def test_hues_autofocus_and_eyedropper(app: App, page: Any) -> None:
    tab = tab_of(app, page)
    page.get_by_text("Autofocus").first.click()
    until(lambda: tab.controls.curve.visible)
    settled(tab)
    page.get_by_role("tab", name="Mask").click()
    page.wait_for_timeout(1500)
    before = tab.controls.cuts.value
    low = page.locator(".multi-slider-thumb:visible").first.bounding_box()
    page.mouse.move(low["x"] + low["width"] / 2, low["y"] + low["height"] / 2)
    page.mouse.down()
    page.wait_for_timeout(500)  # the page listens to movements only after that
    page.mouse.move(low["x"] - 20, low["y"] + low["height"] / 2, steps=5)
    page.wait_for_timeout(200)
    page.mouse.up()
    until(lambda: tab.controls.cuts.value[0] < before[0] - 10.0)
    until(lambda: tab.controls.by_hand.value)
    until(lambda: tab.last is not None and tab.last.mask.hue_from_deg is not None)
    page.get_by_text("Eyedropper").click()
    page.wait_for_timeout(500)
    page.mouse.click(SIZE[0] * 0.4, SIZE[1] * 0.6)
    until(lambda: len(tab.kept) == 1)
    until(lambda: tab.last is not None and tab.last.mask.keep_colours == tab.kept)
    settled(tab)


def test_the_relief_is_found_when_asked_for(app: App, page: Any) -> None:
    tab = tab_of(app, page)
    tab.controls.depth.value = tab.session.ground_m - 0.5
    settled(tab)
    page.get_by_text("Follow the relief").click()
    until(lambda: tab.last is not None and tab.last.focus == Focus(-0.5, terrain=True), 180.0)
    assert tab.session.terrain is not None
    assert "relief of the ground: " in tab.controls.finds.content
    settled(tab)
    page.get_by_text("Follow the relief").click()
    until(lambda: tab.last is not None and not tab.last.focus.terrain)
    assert tab.last is not None
    assert tab.last.focus.down_m == pytest.approx(tab.session.ground_m - 0.5)
    settled(tab)


def test_settings_that_ask_for_the_relief_begin_with_it(browser: Any) -> None:
    asked = hsvaos.Settings().with_values(focus={"down_m": -0.5, "relief": True})
    app = App(Session.open(hsvaos.open_flight(FOLDER), asked), port=0)
    page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    page.goto(app.url)
    tab = tab_of(app, page)
    until(lambda: tab.last is not None and tab.last.focus.terrain, 180.0)
    assert tab.controls.terrain is not None
    assert tab.controls.terrain.value
    assert "relief of the ground: " in tab.controls.finds.content
    settled(tab)
    page.close()
    app.close()


def test_tabs_are_each_their_own_and_leave_nothing(
    app: App, page: Any, browser: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    first = tab_of(app, page)
    other = browser.new_page(viewport={"width": 600, "height": 400})
    other.goto(app.url)
    second = tab_of(app, other, 1)
    first.controls.depth.value = -4.0
    second.controls.depth.value = -1.0
    settled(first)
    settled(second)
    assert first.last is not None
    assert second.last is not None
    assert (first.last.focus.down_m, second.last.focus.down_m) == (-4.0, -1.0)
    assert first.last.view.size != second.last.view.size

    for i in range(30):  # closed in the middle of a picture
        second.controls.depth.value = -1.0 - 0.1 * i
    other.close()
    until(lambda: app.tabs == (first,))
    assert second.gone
    until(lambda: not app.live.busy(second))
    first.controls.depth.value = -2.0
    settled(first)
    assert first.last.focus.down_m == -2.0
    text = capfd.readouterr()
    assert "Traceback" not in text.err + text.out
    assert "closed connection" not in text.err


def test_bare_values_from_the_wire_are_refused_and_named(app: App, page: Any) -> None:
    tab = tab_of(app, page)
    shown = tab.last
    assert shown is not None
    tab.controls.pitch._impl.value = 1e300  # as a broken client might send
    tab.update()
    assert "focus.pitch_deg must be at least -60" in tab.controls.status.content
    assert tab.last is shown
    tab.controls.pitch._impl.value = 0.0
    tab.controls.depth.value = -3.0
    settled(tab)
    assert tab.last is not shown
    assert tab.last.focus == Focus(-3.0)


def test_the_plain_page_follows_the_relief_and_comes_back(browser: Any) -> None:
    small = Settings().with_values(photos={"scale": 0.5}, focus={"relief": True})
    plain = PlainApp(Session.open(hsvaos.open_flight(FOLDER), small), port=0)
    page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    try:
        page.goto(plain.url)
        notes = page.locator("#notes")
        until(lambda: "relief of the ground" in notes.inner_text(), 120.0)
        depth, follows = page.locator("input[name=down]"), page.locator("#relief")
        assert follows.is_checked()
        assert float(depth.input_value()) == 0.0
        first = float(depth.get_attribute("min"))
        follows.uncheck()
        assert float(depth.input_value()) == pytest.approx(plain.session.start.down_m, abs=0.01)
        assert float(depth.get_attribute("min")) == pytest.approx(
            plain.session.depth_range(False)[0], abs=0.01
        )
        page.keyboard.press("PageDown")
        lower = float(depth.input_value())
        follows.check()
        assert float(depth.get_attribute("min")) == first
        follows.uncheck()
        assert float(depth.input_value()) == lower  # the plane is where it was
        assert notes.inner_text().count("relief of the ground") == 1

        def fails(*_: object) -> str:
            raise ValueError("the photos are gone")

        plain.session.terrain = plain.session._relief = None
        plain.session.find_relief = fails  # type: ignore[method-assign]
        follows.check()
        until(lambda: "the photos are gone" in notes.inner_text())
        assert not follows.is_checked()
        assert float(depth.input_value()) == lower
    finally:
        page.close()
        plain.close()
