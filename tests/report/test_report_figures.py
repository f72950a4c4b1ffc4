import colorsys

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.report import figures
from hsvaos.report.draw import (
    LEGEND_HEIGHT,
    draw_boxes,
    draw_rings,
    draw_scale_and_north,
    length_label,
    nice_length,
    with_legend,
)
from hsvaos.report.places import box_around, places_of


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 300.0))
def test_stretch_keeps_hue_and_hides_what_was_not_sampled(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    image = (rng.beta(1, 4, (12, 15, 3)) * scale).astype(np.float32)
    footprint = (rng.random((12, 15)) < 0.8).astype(np.float32)
    footprint[0, 0] = 1.0
    low, high = figures.stretch_limits(image, footprint > 0)
    picture = figures.stretch(image, footprint)
    np.testing.assert_array_equal(picture[..., 3], np.where(footprint > 0, 255, 0))
    assert picture[footprint == 0].max(initial=0) == 0
    # Only channels below black are clipped; everywhere else hue must survive to rounding.
    whole = (footprint > 0) & (image.min(-1) >= low) & (np.ptp(picture[..., :3], axis=-1) >= 60)
    for before, after in zip(image[whole] - low, picture[whole][:, :3], strict=True):
        hue = [360 * colorsys.rgb_to_hsv(*(float(v) for v in c))[0] for c in (before, after)]
        assert abs((hue[1] - hue[0] + 180) % 360 - 180) < 2.0
    assert high >= low


def test_stretch_uses_the_range_and_survives_extremes() -> None:
    ramp = np.linspace(10, 30, 4000, dtype=np.float32).reshape(40, 100)
    grey = figures.stretch(ramp)[..., 0].astype(int)
    assert grey.min() == 0
    assert grey.max() == 255
    assert (np.diff(grey.ravel()) >= 0).all()
    flat = figures.stretch(np.full((4, 4, 1), 7.0, np.float32), np.ones((4, 4)))
    assert np.unique(flat[..., :3]).tolist() == [128]  # neither black nor noise
    nothing = figures.stretch(np.zeros((4, 4, 3)), np.zeros((4, 4)))
    assert nothing.max() == 0
    bad = figures.stretch(np.array([[np.nan, 1.0, 2.0]], np.float32))
    assert bad.shape == (1, 3, 4)
    with pytest.raises(ValueError, match=r"got \(2, 2, 4\)"):
        figures.stretch(np.zeros((2, 2, 4)))


def test_stretch_lifts_a_dark_picture_with_one_bright_target() -> None:
    image = np.random.default_rng(0).uniform(5, 25, (100, 100, 1)).astype(np.float32)
    image[40:45, 40:45] = 255.0
    grey = figures.stretch(image)[..., 0]
    assert np.median(grey) > 50
    assert grey[40:45, 40:45].min() > 250


def test_colour_map_is_opencvs_and_transparent_where_not_valid() -> None:
    values = np.array([[0.0, 5.0, 10.0, 20.0]], np.float32)
    picture = figures.colour_map(values, values < 20, 0.0, 10.0, "viridis")
    table = cv2.applyColorMap(np.array([[0, 127, 255]], np.uint8), cv2.COLORMAP_VIRIDIS)
    np.testing.assert_array_equal(picture[0, :3, :3], table[0, :, ::-1])
    assert picture[0, :, 3].tolist() == [255, 255, 255, 0]
    with pytest.raises(ValueError, match="inferno, viridis, turbo, got 'jet'"):
        figures.colour_map(values, values < 20, 0.0, 1.0, "jet")


def test_fit_grows_no_dark_rim_around_holes() -> None:
    picture = np.full((60, 90, 4), (200, 100, 50, 255), np.uint8)
    picture[10:33, 20:41] = 0
    small = figures.fit(picture, 30)
    assert small.shape == (20, 30, 4)
    seen = small[..., 3] > 8
    assert 0 < seen.sum() < seen.size
    assert np.abs(small[seen][:, :3].astype(int) - (200, 100, 50)).max() <= 1
    assert figures.fit(picture, 90) is picture


def test_shrink_averages_only_what_was_seen() -> None:
    values = np.zeros((60, 90, 2), np.float32)
    valid = np.zeros((60, 90), bool)
    valid[:, :40] = np.random.default_rng(3).random((60, 40)) > 0.5
    values[valid] = (7.0, -2.0)
    small, coverage = figures.shrink(values, valid, 30)
    assert small.shape == (20, 30, 2)
    np.testing.assert_allclose(small[coverage > 0.05], [[7.0, -2.0]] * (coverage > 0.05).sum())
    assert coverage.mean() == pytest.approx(valid.mean(), abs=1e-3)
    assert coverage[:, 14:].max() == 0
    same, whole = figures.shrink(values[..., 0], valid, 90)
    np.testing.assert_array_equal(same[..., 0], values[..., 0])
    faded = figures.faded(figures.stretch(same, whole), whole * 0.5)
    assert set(np.unique(faded[..., 3])) == {0, 128}


def test_encode_keeps_png_exactly_and_refuses_what_cannot_be() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (9, 7, 4), dtype=np.uint8)
    back = cv2.imdecode(np.frombuffer(figures.encode(picture), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(cv2.cvtColor(back, cv2.COLOR_BGRA2RGBA), picture)


def test_photos_are_shown_as_taken_and_thermal_ones_stretched() -> None:
    photo = np.random.default_rng(4).integers(90, 110, (20, 30, 3), dtype=np.uint8)
    np.testing.assert_array_equal(figures.photo_picture(photo)[..., :3], photo)
    for thermal in (photo[..., 0], photo[..., :1].astype(np.uint16)):
        shown = figures.photo_picture(thermal)
        assert shown.shape == (20, 30, 4)
        assert np.ptp(shown[..., 0]) == 255


def test_masked_photo_shows_kept_pixels_as_they_are() -> None:
    photo = figures.photo_picture(np.full((2, 2, 3), 180, np.uint8))
    shown = figures.masked_photo(photo, np.array([[255, 0], [0, 255]], np.uint8))
    assert (shown[0, 0, :3] == 180).all()
    assert (shown[0, 1, :3] < 60).all()


@pytest.mark.parametrize("ground", [0, 128, 255])
def test_boxes_are_readable_on_any_ground(ground: int) -> None:
    picture = np.full((80, 120, 4), (ground, ground, ground, 255), np.uint8)
    before = picture.copy()
    boxes = np.array([[40, 40, 60, 70], [-20, -30, 10, 300]], np.float32)
    found = Detections(boxes, np.array([0.5, 12.0], np.float32), np.zeros(2, np.int64))
    drawn = draw_boxes(picture, found)
    np.testing.assert_array_equal(picture, before)
    line = drawn[55, 36:45, :3].astype(int)
    contrast = np.abs(line - ground).max(axis=-1)
    assert contrast.max() > 100
    assert (drawn[50:60, 45:55, :3] == ground).all()  # the find itself stays free


def test_who_has_no_box_gets_a_ring() -> None:
    camera = Camera.from_fov(120, 80, 60.0)
    down = [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, -20], [0, 0, 0, 1]]
    view = VirtualCamera(camera, np.array(down, dtype=float))
    ahead, beside = view.project([[2.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    persons = [Person(n, e, 0, None, None, 0.2, 0.7, 1) for n, e in ((2, 0), (0, 3), (0, 90))]
    places = places_of(view, persons)
    np.testing.assert_allclose(places[:2], [ahead, beside])
    assert np.isnan(places[2]).all()
    boxes = np.array([[0, 0, 5, 5], [*(ahead - 6), *(ahead + 6)], [*(ahead - 9), *(ahead + 9)]])
    assert box_around(places, boxes).tolist() == [1, -1, -1]
    assert box_around(places, boxes[:0]).tolist() == [-1, -1, -1]
    assert box_around(places_of(view, []), boxes).tolist() == []
    picture = np.zeros((80, 120, 4), np.uint8)
    drawn = draw_rings(picture, places[1:2])
    assert not picture.any()
    x, y = np.rint(beside).astype(int)
    assert drawn[y, x - 16, 0] > 200
    assert not drawn[y - 8 : y + 8, x - 8 : x + 8].any()  # who lies there stays free
    np.testing.assert_array_equal(draw_rings(picture, places[:0]), picture)


def test_scale_bar_has_the_length_it_says() -> None:
    picture = np.zeros((300, 400, 4), np.uint8)
    drawn = draw_scale_and_north(picture, 0.1)  # 40 m wide: a quarter is 10 m
    white = np.flatnonzero((drawn[284, :, :3] == 255).all(axis=-1))
    assert white.max() - white.min() == pytest.approx(100, abs=6)
    tiny = np.zeros((20, 20, 4), np.uint8)
    np.testing.assert_array_equal(draw_scale_and_north(tiny, 0.1), tiny)


@given(st.floats(1e-3, 1e6))
def test_nice_length_is_the_longest_round_one(longest: float) -> None:
    nice = nice_length(longest)
    assert longest / 2.51 < nice <= longest * (1 + 1e-6)
    mantissa = nice / 10 ** np.floor(np.log10(nice) + 1e-9)
    assert min(abs(mantissa - m) for m in (1, 2, 5)) < 1e-6


def test_length_label_reads_naturally() -> None:
    assert [length_label(v) for v in (0.05, 2.0, 2000.0)] == ["5 cm", "2 m", "2 km"]


def test_legend_goes_below_and_spans_the_colours() -> None:
    picture = np.random.default_rng(2).integers(0, 256, (30, 200, 4), dtype=np.uint8)
    shown = with_legend(picture, "inferno", 0.0, 3.5, "rarity")
    assert shown.shape == (30 + LEGEND_HEIGHT, 200, 4)
    np.testing.assert_array_equal(shown[:30], picture)
    ends = figures.colour_map(np.array([[0.0, 1.0]]), np.ones((1, 2), bool), 0, 1)[0]
    np.testing.assert_array_equal(shown[40, [8, 191]], ends)
    assert with_legend(picture[:, :5], "inferno", 0.0, 1.0, "x").shape == (30 + LEGEND_HEIGHT, 5, 4)
