"""Rarity weights and levelling against the twins and OpenCV's Lab."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import reference
from hsvaos.kernels.levels import channel_quantiles, level_gains
from hsvaos.kernels.rarity import (
    apply_rarity,
    rarity_model,
    rarity_weights,
)
from hsvaos.rarity_model import model_from_counts
from tests.kernels.strategies import dtypes, random_images, seeds


def clear_of_edges(images: np.ndarray) -> np.ndarray:
    """Pixels whose colour lies in one bin for sure, in float32 as in float64."""
    place = reference.rarity_coordinates(images)
    return (np.abs(place - np.round(place)) > 2e-3).all(axis=-1)


@given(seed=seeds)
def test_twin_of_lab_equals_opencv(seed: int) -> None:
    image = random_images(seed, "uint8")[0]
    theirs = cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)
    np.testing.assert_allclose(reference.rgb_to_lab(image), theirs, atol=0.5)  # splines


@given(seed=seeds, dtype=dtypes)
def test_histogram_equals_twin(device: str, seed: int, dtype: str) -> None:
    images = random_images(seed, dtype)
    rng = np.random.default_rng(seed)
    valid = rng.random(images.shape[:3]) > 0.3
    clear = clear_of_edges(images)
    model = rarity_model(images, valid=valid & clear, device=device)
    bins = reference.rarity_bins(images)[valid & clear]
    np.testing.assert_array_equal(model.counts.ravel(), np.bincount(bins, minlength=16000))


@given(seed=seeds, dtype=dtypes)
def test_weights_equal_twin(device: str, seed: int, dtype: str) -> None:
    images = random_images(seed, dtype)
    weights, model = rarity_weights(images, dtype="float32", device=device)
    table = reference.rarity_table(model.counts, model.threshold, model.exponent, 1.0)
    expected = table.ravel()[reference.rarity_bins(images)]
    clear = clear_of_edges(images)
    np.testing.assert_allclose(weights[clear], expected[clear], atol=1e-4, rtol=1e-3)
    eight_bit = apply_rarity(images, model, device=device)
    assert np.abs(eight_bit - np.maximum(255.0 * weights, 2.0)).max() <= 0.501


@given(seed=seeds, dtype=dtypes)
def test_bins_kept_give_the_weights_of_bins_found_again(device: str, seed: int, dtype: str) -> None:
    images = random_images(seed, dtype)
    rng = np.random.default_rng(seed)
    if dtype == "float32":
        images[rng.random(images.shape[:3]) > 0.8] = np.nan
    if rng.random() < 0.3:
        images = np.ascontiguousarray(images[..., 1])
    valid = rng.choice([0, 100, 255], images.shape[:3]).astype(np.uint8)
    more = {"valid": valid, "gains": rng.uniform(0.5, 2.0, (len(images), 3)), "device": device}
    out = np.full(images.shape[:3], 7.0, np.float32)
    weights, model = rarity_weights(images, dtype="float32", out=out, **more)
    assert weights is out
    np.testing.assert_array_equal(out, apply_rarity(images, model, dtype="float32", **more))
    measured = rarity_model(images, **more)
    np.testing.assert_array_equal(model.counts, measured.counts)


@given(seed=seeds, sigma=st.floats(0.5, 3.0))
def test_table_equals_twin(seed: int, sigma: float) -> None:
    counts = np.random.default_rng(seed).poisson(0.2, (10, 40, 40)) * 50
    model = model_from_counts(counts, 2e-4, 1.5, sigma)
    twin = reference.rarity_table(counts, 2e-4, 1.5, sigma)
    np.testing.assert_allclose(model.weights, twin, atol=2e-3)
    assert model.weights.max() <= 1.0


def test_rare_colour_counts_and_the_forest_does_not(device: str) -> None:
    rng = np.random.default_rng(0)
    images = np.empty((4, 200, 200, 3), np.uint8)
    images[...] = rng.normal((60, 110, 50), 8, images.shape).clip(0, 255)
    images[2, 5:9, 5:9] = (200, 30, 40)
    weights, _ = rarity_weights(images, device=device)
    assert (weights[2, 5:9, 5:9] == 255).all()
    assert np.median(weights) < 20


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_grey_flight_weighs_rare_levels(device: str, dtype: str) -> None:
    rng = np.random.default_rng(0)
    warm = rng.normal(0.4, 0.02, (3, 64, 64)).clip(0, 1)
    warm[1, 20:24, 20:24] = 0.91
    white = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    images = (warm * white).astype(dtype)
    weights, model = rarity_weights(images, device=device)
    assert model.is_grey
    assert (weights[1, 20:24, 20:24] == 255).all()
    assert np.median(weights) < 60
    levels = np.floor(reference.unit(images) * 255.0 + 0.5).astype(int)
    assert np.abs(np.bincount(levels.ravel(), minlength=256) - model.counts).sum() <= 4


def test_user_mask_multiplies_in(device: str) -> None:
    images = random_images(3, "uint8")
    valid = np.full(images.shape[1:3], 255, np.uint8)
    valid[:, :2] = 0
    weights, _ = rarity_weights(images, valid=valid, device=device)
    assert (weights[:, :, :2] == 0).all()
    assert (weights[:, :, 2:] > 0).all()


@given(seed=seeds, dtype=dtypes)
def test_quantiles_equal_twin(device: str, seed: int, dtype: str) -> None:
    images = random_images(seed, dtype)
    quantiles = channel_quantiles(images, device=device)
    for image, ours in zip(images, quantiles, strict=True):
        twin = reference.channel_quantiles(image, (0.25, 0.5, 0.75))
        np.testing.assert_allclose(ours, twin, atol=1.01 / 1023)


def test_a_tinted_frame_is_levelled(device: str) -> None:
    rng = np.random.default_rng(0)
    images = rng.uniform(0.1, 0.5, (5, 40, 40, 3)).astype(np.float32)
    tint = np.array([1.6, 1.2, 0.7], np.float32)
    images[3] *= tint
    gains = level_gains(channel_quantiles(images, device=device))
    np.testing.assert_allclose(gains[3], 1.0 / tint, rtol=0.06)
    np.testing.assert_allclose(gains[[0, 1, 2, 4]], 1.0, atol=0.06)
    untinted, tinted = (rarity_weights(x, device=device)[0] for x in (images, images))
    np.testing.assert_array_equal(untinted, tinted)


def test_bad_input() -> None:
    images = random_images(0, "uint8")
    with pytest.raises(ValueError, match="threshold"):
        rarity_weights(images, threshold=0.0)
    with pytest.raises(ValueError, match="exponent"):
        rarity_weights(images, exponent=-1.0)
    with pytest.raises(ValueError, match="gains"):
        rarity_weights(images, gains=np.ones(3))
    with pytest.raises(TypeError, match="uint16"):
        rarity_weights(images, dtype="uint16")
    _, model = rarity_weights(images)
    with pytest.raises(ValueError, match="grey"):
        apply_rarity(images[..., 0], model)
