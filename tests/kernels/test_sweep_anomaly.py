"""Focus measures and the RX detector against the twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import reference
from hsvaos.kernels.anomaly import rx_distances, rx_masks, rx_statistics
from hsvaos.kernels.sweep import MEASURES, best_focus, focus_measure
from tests.kernels.strategies import dtypes, random_images, seeds


@given(seed=seeds, measure=st.sampled_from(MEASURES), channels=st.sampled_from([1, 3]))
def test_focus_measure_equals_twin(device: str, seed: int, measure: str, channels: int) -> None:
    rng = np.random.default_rng(seed)
    stack = rng.random((2, 24, 30, channels)).astype(np.float32)
    footprint = (rng.random((2, 24, 30)) < 0.97).astype(np.float32) * 3
    ours = focus_measure(stack, footprint, measure, core_px=1, ring_px=5, device=device)
    for n in range(2):
        twin = reference.focus_measure(stack[n], footprint[n], measure, 1, 5)
        assert ours[n] == pytest.approx(twin, rel=1e-4)


def test_nothing_covered_measures_zero(device: str) -> None:
    zero = np.zeros((1, 30, 30, 1), np.float32)
    assert focus_measure(zero, zero[..., 0], device=device) == 0.0


def test_kurtosis_prefers_few_small_things_to_much_texture() -> None:
    rng = np.random.default_rng(0)
    crowns = rng.random((1, 80, 80, 1)).astype(np.float32)
    target = (0.3 * rng.random((1, 80, 80, 1))).astype(np.float32)
    target[0, 40:44, 40:44] = 1.0
    stack = np.concatenate([crowns, target])
    cover = np.ones(stack.shape[:3], np.float32)
    kurtosis = focus_measure(stack, cover)
    contrast = focus_measure(stack, cover, "contrast")
    assert kurtosis[1] > 2 * kurtosis[0]
    assert contrast[0] > contrast[1]


def test_best_focus_finds_the_prominent_peak_between_planes() -> None:
    downs = np.arange(0.0, 20.0)
    curve = 1.0 + 5.0 * np.exp(-(((downs - 12.3) / 1.5) ** 2)) + 20.0 * np.exp(-downs)
    down, prominence = best_focus(downs, curve)
    assert down == pytest.approx(12.3, abs=0.2)
    assert prominence == pytest.approx(4.8, abs=0.5)


def test_best_focus_without_a_peak_says_so() -> None:
    assert best_focus([1.0, 2.0, 3.0], [3.0, 2.0, 1.0]) == (1.0, 0.0)
    assert best_focus([1.0, 2.0], [0.0, 0.0]) == (1.0, 0.0)
    assert best_focus([0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 3.0, 2.0])[0] == pytest.approx(2.0)
    with pytest.raises(ValueError, match="equal length"):
        best_focus([1.0], [1.0, 2.0])


@given(seed=seeds, dtype=dtypes, colour=st.booleans())
def test_rx_distance_equals_twin(device: str, seed: int, dtype: str, colour: bool) -> None:
    images = random_images(seed, dtype, colour)
    ours = rx_distances(images, device=device)
    for n, image in enumerate(images):
        np.testing.assert_allclose(ours[n], reference.rx_distances(image), rtol=2e-3, atol=2e-3)


@given(seed=seeds, quantile=st.floats(0.5, 0.999))
def test_rx_mask_cuts_the_quantile(device: str, seed: int, quantile: float) -> None:
    images = random_images(seed, "float32")
    masks, thresholds = rx_masks(images, quantile, device=device)
    for n, image in enumerate(images):
        distances = reference.rx_distances(image)
        clear = np.abs(distances - thresholds[n]) > 5e-3 * np.maximum(distances, 1.0)
        np.testing.assert_array_equal(
            masks[n][clear], np.where(distances > thresholds[n], 255, 0)[clear]
        )
        exact = np.quantile(distances, quantile, method="inverted_cdf")
        assert thresholds[n] == pytest.approx(exact, rel=0.01, abs=2e-3)


def test_rx_leaves_masked_pixels_out(device: str) -> None:
    rng = np.random.default_rng(0)
    images = rng.random((1, 40, 40, 3)).astype(np.float32)
    images[0, :10] = 50.0
    valid = np.ones((40, 40), bool)
    valid[:10] = False
    mean, _ = rx_statistics(images, valid=valid, device=device)
    np.testing.assert_allclose(mean[0], images[0, 10:].mean(axis=(0, 1)), atol=1e-5)
    masks, _ = rx_masks(images, 0.9, valid=valid, device=device)
    assert (masks[0, :10] == 0).all()
    assert (masks[0, 10:] > 0).mean() == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("value", [0, 77])
def test_rx_of_a_flat_image_is_finite(device: str, value: int) -> None:
    distances = rx_distances(np.full((1, 8, 9, 3), value, np.uint8), device=device)
    np.testing.assert_allclose(distances, 0.0, atol=1e-6)


def test_bad_input() -> None:
    images = random_images(0, "uint8")
    with pytest.raises(ValueError, match="quantile"):
        rx_masks(images, 1.0)
    with pytest.raises(ValueError, match="measure must be one of"):
        focus_measure(np.zeros((1, 4, 4, 1), np.float32), np.zeros((1, 4, 4), np.float32), "x")
    with pytest.raises(ValueError, match="footprint"):
        focus_measure(np.zeros((1, 4, 4, 1), np.float32), np.zeros((1, 4, 5), np.float32))
