"""A live flight searched with all that `hsvaos.run` looks at."""

from __future__ import annotations

import numpy as np
import pytest

import hsvaos
from hsvaos import Camera, Detections, FocalPlane, LiveIntegrator, Settings, VirtualCamera
from hsvaos.demo import FOLDER
from hsvaos.detect.locate import ViewFinds
from hsvaos.kernels.device import bands, on_one_thread, resolve_device
from hsvaos.live.finds import LiveFinds
from hsvaos.live.result import LiveResult
from hsvaos.live.ring import Format
from hsvaos.live.search import SearchThread
from tests.kernels.test_integrate import looking_down
from tests.live.conftest import Strip


def test_a_search_of_the_whole_flight_finds_what_run_finds() -> None:
    flight = hsvaos.open_flight(FOLDER)
    ran = hsvaos.run(flight, Settings())
    expected = ran.main.detections
    assert len(expected) > 0
    photos = list(flight.images())
    live = LiveIntegrator(
        flight.camera,
        FocalPlane(flight.ground_down_m or 0.0),
        frames=len(flight),
        view=ran.main.view,
        mask="none",
        search=Settings(),
        detect_every=len(flight) - 1,
    )
    with live:
        for photo, pose in zip(photos, flight.poses, strict=True):
            live.push(photo, pose)
            assert live.drain(300.0)
        stats, persons = live.stats(), live.persons(flight.origin)
        live.push(photos[-1], flight.poses[-1])  # whose picture brings the finds
        assert live.drain(300.0)
        result = live.latest()
    assert (stats.detected, stats.detections_skipped) == (2, 0)  # of the first photo, and of all
    assert result is not None
    assert result.finds is not None
    assert result.finds.number == len(flight) - 1
    found = result.finds.detections
    assert len(found) == len(expected)
    np.testing.assert_allclose(found.boxes_xyxy, expected.boxes_xyxy, atol=0.5)
    np.testing.assert_allclose(found.scores, expected.scores, atol=0.02)
    # one photo alone has shown nobody there, so that the mean over both searches is lower
    nearest = min(
        np.hypot(a.north_m - b.north_m, a.east_m - b.east_m) for a in persons for b in ran.persons
    )
    assert nearest < 0.1


def searcher(strip: Strip, frames: int) -> SearchThread:
    settings = Settings().with_values(detect={"method": "rarity", "min_rays": 1.0})
    return SearchThread(Format(strip.camera), frames, settings, None, resolve_device("cpu"))


def picture(strip: Strip, number: int) -> LiveResult:
    width, height = strip.view.size
    image, rays = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
    return LiveResult(image, rays, number, 0.0, 0.0, 1, strip.view, None, None)


def test_photos_that_are_searched_stay_while_others_come(strip: Strip) -> None:
    search = searcher(strip, 4)
    for number in range(6):
        search.take(number, strip.images[number], strip.poses[number])
    search.offer(picture(strip, 5), strip.surface, 0.1)
    search.offer(picture(strip, 5), strip.surface, 0.1)  # while the first waits for the thread
    assert search.skipped == 1
    for number in range(6, 40):  # far more than there is room for
        search.take(number, strip.images[number % 12], strip.poses[number % 12])
    asked = search._asked
    assert asked is not None
    assert sorted(asked.slots) == [2, 3, 4, 5]
    for number, slot in asked.slots.items():
        np.testing.assert_array_equal(search._kept[slot], strip.images[number])
        np.testing.assert_array_equal(asked.poses[number], strip.poses[number])
    search.start()
    assert search.rest(120.0)
    assert search.error is None
    assert search.latest is not None
    assert search.latest.number == 5
    assert sorted(search._searched.tolist()) == [2, 3, 4, 5]
    search.offer(picture(strip, 39), strip.surface, 0.1)
    assert search.rest(120.0)
    assert sorted(search._searched.tolist()) == [36, 37, 38, 39]
    for place, number in enumerate(search._searched.tolist()):
        np.testing.assert_array_equal(search._images[place].numpy(), strip.images[number % 12])
    search.close()


def test_a_photo_is_looked_at_once(strip: Strip, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = Settings()
    search = SearchThread(Format(strip.camera), 3, settings, None, resolve_device("cpu"))
    net = search._net
    assert net is not None
    looked, of_photo = [], net.of_photo
    monkeypatch.setattr(net, "of_photo", lambda *a: looked.append(1) or of_photo(*a))
    search.start()
    for number in range(6):
        search.take(number, strip.images[number], strip.poses[number])
        search.offer(picture(strip, number), strip.surface, 0.1)
        assert search.rest(120.0)
        assert search.error is None
    search.close()
    assert len(looked) == 6
    assert len(search.times) == 6


def test_photos_from_other_heights_are_looked_at_alike(
    strip: Strip, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = SearchThread(Format(strip.camera), 3, Settings(), None, resolve_device("cpu"))
    net = search._net
    assert net is not None
    looked: list[float | None] = []
    of_photo = net.of_photo
    monkeypatch.setattr(net, "of_photo", lambda x, gsd: looked.append(gsd) or of_photo(x, gsd))
    search.start()
    for number in range(6):  # so coarse that they are resampled, by what their height says
        pose = strip.poses[number].copy()
        pose[2, 3] = -40.0 if number >= 4 else -20.0 - 0.5 * number
        search.take(number, strip.images[number], pose)
        search.offer(picture(strip, number), strip.surface, 0.1)
        assert search.rest(120.0)
        assert search.error is None
        assert search._said is not None
        held = search._searched != -1
        assert (search._said.ground[held] > 0).any(axis=(1, 2)).all()
    search.close()
    assert looked[:5] == [looked[0]] * 5  # one each, as the first: the median height is nearly its
    assert looked[5:] == [pytest.approx(2.0 * (looked[0] or 0.0))] * 3  # now it is not: all anew


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_grey_photos_are_searched_too(strip: Strip, dtype: str) -> None:
    valid = np.full((72, 96), 255, np.uint8)
    valid[:, :10] = 0
    cpu = resolve_device("cpu")
    search = SearchThread(Format(strip.camera, 1, dtype), 3, Settings(), valid, cpu)
    search.warm_up(strip.view, strip.surface)
    search.start()
    for number in range(4):
        grey = strip.images[number, ..., 1].astype(dtype)
        search.take(number, grey, strip.poses[number])
    search.offer(picture(strip, 3), strip.surface, 0.1)
    assert search.rest(120.0)
    assert search.error is None
    assert sorted(search._searched.tolist()) == [1, 2, 3]
    search.close()


def test_a_view_of_the_sky_holds_nobody(strip: Strip) -> None:
    search = searcher(strip, 2)
    search.start()
    up = strip.poses[0].copy()
    up[:3, :3] = up[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    search.take(0, strip.images[0], strip.poses[0])
    sky = picture(strip, 0)
    search.offer(
        LiveResult(
            sky.image,
            sky.footprint,
            0,
            0.0,
            0.0,
            1,
            VirtualCamera(strip.view.camera, up),
            None,
            None,
        ),
        strip.surface,
        0.1,
    )
    assert search.rest(120.0)
    assert search.error is None
    assert search.latest is not None
    assert len(search.latest.detections) == 0
    assert search.persons() == ()
    search.close()


def test_boxes_move_with_the_view() -> None:
    eye = Camera.from_fov(100, 100, 90.0)
    before = VirtualCamera(eye, looking_down(0.0, 0.0, 20.0))
    boxes = np.array([[40, 40, 50, 60], [5, 40, 15, 60], [70, 70, 80, 80]], np.float32)
    found = Detections(boxes, np.array([0.9, 0.8, 0.7], np.float32), np.zeros(3, np.int64))
    middles = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    rays = eye.back_project(middles) * 20.0
    places = rays @ before.world_from_camera[:3, :3].T + before.world_from_camera[:3, 3]
    places[2] = np.nan  # of a box that has no ground
    finds = LiveFinds(3, found, 1.0, ViewFinds(before, found, places, np.zeros((3, 2, 2))))
    assert finds.seen_from(before) is found
    later_pose = before.world_from_camera.copy()
    later_pose[:3, 3] += before.world_from_camera[:3, 0] * 6.0  # to the right of the picture
    later = finds.seen_from(VirtualCamera(eye, later_pose))
    shift = 6.0 * eye.fx / 20.0
    np.testing.assert_allclose(later.boxes_xyxy, [boxes[0] - [shift, 0, shift, 0]], atol=1e-3)
    np.testing.assert_allclose(later.scores, [0.9])
    assert LiveFinds(3, found, 1.0).seen_from(before) is found


def test_work_beside_other_work_keeps_to_its_thread() -> None:
    cpu = resolve_device("cpu")
    before = bands(10_000_000, cpu)
    with on_one_thread():
        assert bands(10_000_000, cpu) == [(0, 10_000_000)]
    assert bands(10_000_000, cpu) == before


def test_what_cannot_be_searched_is_refused(strip: Strip) -> None:
    nobody = Settings().with_values(detect={"enabled": False})
    with pytest.raises(ValueError, match=r"detect\.enabled"):
        LiveIntegrator(strip.camera, size=32, mask="none", search=nobody)

    class Eye:
        def detect(self, image: object, **_: object) -> Detections:
            return Detections.none()

    with pytest.raises(ValueError, match="one of them, got both"):
        LiveIntegrator(strip.camera, size=32, mask="none", search=Settings(), detector=Eye())


def test_without_a_search_there_are_no_persons(strip: Strip) -> None:
    with LiveIntegrator(strip.camera, size=32, mask="none") as live:
        live.push(strip.images[0], strip.poses[0])
        assert live.drain(60.0)
        assert live.persons() == ()
