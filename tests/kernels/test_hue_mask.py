"""Hue statistics and masks against the twin, circular laws, and hue that says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import reference
from hsvaos.hue_statistics import BINS, hue_statistics
from hsvaos.kernels.color import hsv_to_rgb
from hsvaos.kernels.hue_mask import apply_hue_cut, hue_histograms, hue_masks
from tests.kernels.strategies import dtypes, random_images, seeds

BAND_DEG = 0.02
"""Pixels whose hue lies this close to the edge of the cut may fall on either side."""


def forest(seed: int, mean: float = 110.0, sigma: float = 8.0, size: int = 64) -> np.ndarray:
    """Image of normally distributed hue, as the paper describes a forest."""
    rng = np.random.default_rng(seed)
    hsv = np.empty((1, size, size, 3), np.float32)
    hsv[..., 0] = rng.normal(mean, sigma, hsv.shape[:3])
    hsv[..., 1] = rng.uniform(0.4, 0.8, hsv.shape[:3])
    hsv[..., 2] = rng.uniform(0.3, 0.8, hsv.shape[:3])
    return hsv_to_rgb(hsv)


@given(seed=seeds, dtype=dtypes, statistics=st.sampled_from(["circular", "linear"]))
def test_histogram_equals_twin(device: str, seed: int, dtype: str, statistics: str) -> None:
    images = random_images(seed, dtype)
    rng = np.random.default_rng(seed)
    valid = rng.random(images.shape[:3]) > 0.3
    histograms, chroma = hue_histograms(images, statistics=statistics, valid=valid, device=device)
    for n in range(len(images)):
        twin, mean_chroma = reference.hue_histogram(images[n], BINS, statistics, valid[n])
        # a hue on the edge of a bin may be counted in either of the two
        ours, theirs = np.cumsum(histograms[n]), np.cumsum(twin)
        rounding = 1e-5 * images[n].size
        assert ours[-1] == pytest.approx(theirs[-1], abs=rounding)
        assert (ours[:-1] <= theirs[1:] + rounding).all()
        assert (ours[1:] >= theirs[:-1] - rounding).all()
        assert chroma[n] == pytest.approx(mean_chroma, abs=1e-4)


@given(seed=seeds, dtype=dtypes, statistics=st.sampled_from(["circular", "linear"]))
def test_mask_equals_twin_but_for_the_boundary(
    device: str, seed: int, dtype: str, statistics: str
) -> None:
    images = random_images(seed, dtype)
    valid = (np.random.default_rng(seed).random(images.shape[:3]) > 0.2).astype(np.uint8) * 255
    masks, stats = hue_masks(images, 1.0, statistics, valid=valid, device=device)
    for n, s in enumerate(stats):
        distance = reference.hue_distance(images[n], s.mean_deg, statistics)
        edge = s.half_width_deg
        expected = np.where((distance > edge) | (not s.informative), valid[n], 0)
        clear = (np.abs(distance - edge) > BAND_DEG) | (not s.informative)
        np.testing.assert_array_equal(masks[n][clear], expected[clear])


@given(seed=seeds, turn=st.floats(0.0, 360.0))
def test_circular_statistics_turn_with_the_hue(seed: int, turn: float) -> None:
    histogram = np.random.default_rng(seed).random(BINS) ** 8
    steps = round(turn / (360.0 / BINS))
    straight = hue_statistics(histogram, 0.5)
    turned = hue_statistics(np.roll(histogram, steps), 0.5)
    difference = turned.mean_deg - straight.mean_deg - steps * 360.0 / BINS
    assert abs((difference + 180.0) % 360.0 - 180.0) < 1e-6
    assert turned.sigma_deg == pytest.approx(straight.sigma_deg)


@pytest.mark.parametrize("mean", [0.0, 30.0, 110.0, 359.0])
def test_normal_hue_is_measured_across_the_wrap(device: str, mean: float) -> None:
    _, (stats,) = hue_masks(forest(1, mean), device=device)
    assert abs((stats.mean_deg - mean + 180) % 360 - 180) < 0.5
    assert stats.sigma_deg == pytest.approx(8.0, rel=0.05)
    assert stats.within == pytest.approx(0.9545, abs=0.02)


def test_trees_are_cut_and_a_red_jacket_stays(device: str) -> None:
    image = forest(2)
    image[0, 10:14, 10:14] = [0.8, 0.1, 0.15]
    masks, (stats,) = hue_masks(image, device=device)
    assert stats.informative
    assert (masks[0, 10:14, 10:14] == 255).all()
    assert (masks == 0).mean() > 0.93


@pytest.mark.parametrize("statistics", ["circular", "linear"])
def test_grey_images_are_kept_whole_and_said(device: str, statistics: str) -> None:
    rng = np.random.default_rng(0)
    grey = np.repeat(rng.integers(0, 256, (2, 30, 30, 1), dtype=np.uint8), 3, axis=-1)
    noisy = np.clip(grey.astype(int) + rng.integers(-1, 2, grey.shape), 0, 255).astype(np.uint8)
    masks, stats = hue_masks(np.concatenate([grey, noisy]), statistics=statistics, device=device)
    assert (masks == 255).all()
    assert not any(s.informative for s in stats)
    assert all(s.reason for s in stats)


def test_hue_spread_over_the_circle_is_kept_whole(device: str) -> None:
    masks, (stats,) = hue_masks(forest(3, sigma=100.0), device=device)
    assert not stats.informative
    assert "spread" in stats.reason
    assert (masks == 255).all()


def test_scopes(device: str) -> None:
    images = np.concatenate([forest(1, 90.0), forest(2, 130.0)])
    _, each = hue_masks(images, scope="image", device=device)
    _, flight = hue_masks(images, scope="flight", device=device)
    assert each[0].mean_deg == pytest.approx(90.0, abs=1.0)
    assert each[1].mean_deg == pytest.approx(130.0, abs=1.0)
    assert flight[0] == flight[1]
    assert flight[0].mean_deg == pytest.approx(110.0, abs=2.0)


def test_user_mask_is_left_out_of_the_statistics(device: str) -> None:
    image = forest(1)
    image[0, :32] = [0.9, 0.0, 0.0]
    valid = np.ones((64, 64), np.uint8) * 255
    valid[:32] = 0
    masks, (stats,) = hue_masks(image, valid=valid, device=device)
    assert stats.mean_deg == pytest.approx(110.0, abs=1.0)
    assert (masks[0, :32] == 0).all()


def test_result_does_not_depend_on_threads() -> None:
    from hsvaos.kernels.device import set_threads

    images = np.random.default_rng(5).integers(0, 256, (1, 300, 301, 3), dtype=np.uint8)
    try:
        results = []
        for threads in (1, 2, 3):
            set_threads(threads)
            results.append(hue_histograms(images)[0])
    finally:
        set_threads(0)
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_stats_of_another_run_can_be_applied(device: str) -> None:
    images = forest(1)
    masks, stats = hue_masks(images, device=device)
    np.testing.assert_array_equal(apply_hue_cut(images, stats, device=device), masks)


def test_bad_input() -> None:
    image = np.zeros((1, 4, 5, 3), np.uint8)
    with pytest.raises(ValueError, match="sigmas must be a positive"):
        hue_masks(image, 0.0)
    with pytest.raises(ValueError, match="circular"):
        hue_masks(image, statistics="median")
    with pytest.raises(ValueError, match="scope"):
        hue_masks(image, scope="world")
    with pytest.raises(ValueError, match="valid must have shape"):
        hue_masks(image, valid=np.zeros((3, 3), np.uint8))
