"""Grey images go to the network for grey images, and it finds warm people of any size in pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from hsvaos import Detector
from hsvaos.detect.agree import agreed
from hsvaos.detect.detections import Detections
from hsvaos.detect.grey_input import GREY_CHANNELS, grey_input
from hsvaos.detect.view_input import ViewInput
from hsvaos.detect.yolo import PACKAGED, PACKAGED_GREY, PACKAGED_PICTURE
from train.drawn import draw_person


def forest_floor(seed: int, side: int = 400) -> np.ndarray:
    """A thermal integral image without people: soft patches of all sizes and some noise."""
    rng = np.random.default_rng(seed)
    image = np.full((side, side), 90.0, np.float32)
    for sigma, amount in ((2.0, 1.0), (8.0, 2.0), (40.0, 6.0)):
        noise = cv2.GaussianBlur(rng.standard_normal((side, side), np.float32), (0, 0), sigma)
        image += np.float32(amount / noise.std()) * noise
    return image + 0.4 * rng.standard_normal((side, side), np.float32)


def with_person(image: np.ndarray, x: int, y: int, length: int, warmth: float) -> np.ndarray:
    """Somebody as the recipe draws people, on ground that it does not draw."""
    half = int(1.1 * length)
    shape = draw_person(2 * half, 1.75 / length, np.random.default_rng(length))
    changed = image.copy()
    changed[y - half : y + half, x - half : x + half] += np.float32(warmth) * shape
    return changed


@pytest.mark.parametrize("length", [15, 22, 32, 44])
@pytest.mark.parametrize("warmth", [30.0, 90.0, -40.0])
def test_a_warm_or_cold_person_is_found_at_any_size(length: int, warmth: float) -> None:
    image = with_person(forest_floor(length), 180, 220, length, warmth)
    found = Detector().detect(image)
    assert len(found.scores) >= 1
    box = found.boxes_xyxy[0]
    assert abs(0.5 * (box[0] + box[2]) - 180) < 0.35 * length
    assert abs(0.5 * (box[1] + box[3]) - 220) < 0.35 * length
    assert len(found.scores) <= 2


def test_nobody_is_found_where_nobody_is() -> None:
    counts = [len(Detector().detect(forest_floor(seed)).scores) for seed in range(8)]
    assert sum(counts) <= 1


def test_one_threshold_holds_for_all_networks() -> None:
    for other in (PACKAGED_GREY, PACKAGED_PICTURE):
        assert Detector(other).score == pytest.approx(Detector(PACKAGED).score)


def test_colour_views_go_to_the_network_that_knows_as_much_as_is_known_of_them() -> None:
    rng = np.random.default_rng(3)
    grey = with_person(forest_floor(1), 200, 200, 30, 60.0)
    colour = np.dstack([grey, grey + 1.0, grey])
    rays = np.full(grey.shape, 30.0, np.float32)
    rarity = np.full(grey.shape, 0.02, np.float32)
    rarity[195:225, 195:215] = 0.3
    rarity += rng.uniform(0.0, 0.005, grey.shape).astype(np.float32)
    ours = Detector(score=0.05)
    views = {"footprints": [rays, rays], "rarities": [None, rarity], "plains": [None, colour]}
    lone, known = ours.detect_batch([colour, colour], **views)
    of_pictures = Detector(PACKAGED_PICTURE, score=0.05).detect(colour, footprint=rays)
    of_flights = Detector(PACKAGED.read_bytes(), score=0.05).detect(
        colour, footprint=rays, rarity=rarity, plain=colour
    )
    for found, expected in ((lone, of_pictures), (known, of_flights)):
        np.testing.assert_allclose(found.boxes_xyxy, expected.boxes_xyxy, atol=1e-3)
        np.testing.assert_allclose(found.scores, expected.scores, atol=1e-4)
    assert len(lone.scores)
    assert len(known.scores)
    assert lone.scores[0] != pytest.approx(known.scores[0], abs=1e-3)


def test_grey_views_go_to_their_network_and_coloured_ones_do_not() -> None:
    grey = with_person(forest_floor(1), 200, 200, 30, 60.0)
    colour = np.dstack([grey, grey + 1.0, grey])
    alone = Detector(PACKAGED_GREY, score=0.1)
    both = Detector(score=0.1)
    for view in (grey, grey[..., None], np.dstack([grey] * 3)):
        np.testing.assert_allclose(
            both.detect(view).boxes_xyxy, alone.detect(grey).boxes_xyxy, atol=1e-3
        )
    as_colour = Detector(PACKAGED_PICTURE, score=0.1).detect(colour)
    found = both.detect_batch([colour, grey, colour])
    for k in (0, 2):
        np.testing.assert_allclose(found[k].boxes_xyxy, as_colour.boxes_xyxy, atol=1e-2)
    np.testing.assert_allclose(found[1].scores, alone.detect(grey).scores, atol=1e-4)


def test_a_network_of_the_users_sees_every_image() -> None:
    grey = with_person(forest_floor(1), 200, 200, 30, 60.0)
    own = Detector(PACKAGED.read_bytes(), score=0.1)
    assert not own._others
    np.testing.assert_array_equal(
        own.detect(grey).scores, Detector(str(PACKAGED), score=0.1).detect(grey).scores
    )


def test_no_exposure_counts() -> None:
    image = with_person(forest_floor(2), 200, 200, 30, 60.0)
    image[:, :40] = np.nan
    first = grey_input(image)
    other = grey_input(7.0 * image + 300.0)
    np.testing.assert_allclose(other[:2], first[:2], atol=2e-3)
    changed = np.abs(other[2] - first[2]) > 2e-3  # where rounding leads into the next bin
    assert changed.mean() < 1e-3
    assert first.shape == (len(GREY_CHANNELS), 400, 400)
    assert (first[:, :, :40] == 0.0).all()
    rays = np.where(np.isfinite(image), 9.0, 0.0)
    np.testing.assert_array_equal(grey_input(np.nan_to_num(image), rays), first)


@pytest.mark.parametrize("shape", [(0, 5), (5,), (5, 5, 3)])
def test_what_is_no_grey_image(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"image must have shape \(H, W\)"):
        grey_input(np.zeros(shape))
    with pytest.raises(ValueError, match="footprint must have the image's size"):
        grey_input(np.zeros((5, 5)), np.zeros((5, 4)))


def test_ground_that_nobody_saw_stays_out() -> None:
    image = with_person(forest_floor(3), 200, 200, 30, 60.0)
    rays = np.full(image.shape, 40.0, np.float32)
    rays[:, 260:] = 0.0
    image[:, 260:] = np.nan
    found = Detector().detect(image, footprint=rays, rarity=rays / 100, plain=image)
    assert len(found.scores) == 1
    assert abs(found.boxes_xyxy[0, [0, 2]].mean() - 200) < 12


@pytest.mark.parametrize("gsd_m", [None, 0.05])
def test_grey_images_are_looked_at_at_two_sizes(gsd_m: float | None) -> None:
    image = with_person(forest_floor(6), 200, 200, 36, 40.0)
    detector = Detector(PACKAGED_GREY, score=0.05)
    views, distances = [ViewInput(image)], [gsd_m]
    full, small = (detector._found_at(scale, views, distances, 0.05)[0] for scale in (1.0, 0.7))
    for found in (full, small):  # in pixels of the image, whatever the size of the look
        assert found.boxes_xyxy[0, [0, 2]].mean() == pytest.approx(200, abs=12)
    expected = agreed(full, small, 0.25, 300).above(0.05)
    both = detector.detect(image, gsd_m=gsd_m)
    np.testing.assert_allclose(both.scores, expected.scores, atol=1e-4)
    np.testing.assert_allclose(both.boxes_xyxy, expected.boxes_xyxy, atol=0.05)


def test_soft_images_of_real_photos_show_people_too() -> None:
    """A warm blob, as people are in thermal integral images whose poses are a little wrong."""
    image = forest_floor(7)
    blob = np.zeros_like(image)
    cv2.ellipse(blob, (200, 200), (15, 18), 0.0, 0.0, 360.0, 60.0, -1)
    found = Detector().detect(image + cv2.GaussianBlur(blob, (0, 0), 4.0))
    assert len(found) >= 1
    assert found.boxes_xyxy[0, [0, 2]].mean() == pytest.approx(200, abs=8)


def test_what_two_looks_agree_on_is_surer_than_what_one_says() -> None:
    boxes = np.array([[10, 10, 30, 20], [50, 50, 70, 60], [90, 10, 99, 30]], np.float32)
    ids = np.zeros(2, np.int64)
    first = Detections(boxes[:2], np.array([0.6, 0.6], np.float32), ids)
    second = Detections(boxes[[0, 2]] + 1.0, np.array([0.6, 0.6], np.float32), ids)
    both = agreed(first, second, 0.25, 10)
    assert len(both) == 3
    np.testing.assert_array_equal(both.boxes_xyxy[0], boxes[0])  # the first one's box
    assert both.scores[0] > 0.6 > both.scores[1] > both.scores[2] > 0.5
    # what only the second one gives is doubted less: the first one's silence says nothing
    np.testing.assert_array_equal(both.boxes_xyxy[1:], [boxes[2] + 1.0, boxes[1]])
    assert len(agreed(first, Detections.none(), 0.25, 10)) == 2
    assert len(agreed(Detections.none(), Detections.none(), 0.25, 10)) == 0
    assert (np.diff(agreed(Detections.none(), second, 0.25, 10).scores) <= 0).all()


def test_a_known_grey_view_is_looked_at_by_both() -> None:
    image = with_person(forest_floor(5), 200, 200, 30, 60.0)
    rays = np.full(image.shape, 40.0, np.float32)
    known = {"footprint": rays, "rarity": rays / 400, "plain": image}
    colour = Detector(PACKAGED_PICTURE, score=0.05).detect(image, **known)
    grey = Detector(PACKAGED_GREY, score=0.05).detect(image, footprint=rays)
    expected = agreed(colour, grey, 0.25, 300).above(0.3)
    found = Detector(score=0.3).detect(image, **known)
    np.testing.assert_allclose(found.scores, expected.scores, atol=1e-4)
    np.testing.assert_allclose(found.boxes_xyxy, expected.boxes_xyxy, atol=0.05)
