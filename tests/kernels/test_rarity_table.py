"""Bins looked up are those computed, for counts and weights alike."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import reference
from hsvaos.kernels.rarity import apply_rarity, byte_table, counts_shape, rarity_model
from hsvaos.kernels.rarity_table import BinTable
from tests.kernels.strategies import random_images, seeds
from tests.kernels.test_rarity import clear_of_edges


def certain(image: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Valid pixels whose colour lies in one bin for sure, laid flat, uint8."""
    return np.where(clear_of_edges(image)[0], valid, 0).astype(np.uint8).ravel()


@pytest.fixture(scope="module")
def table(device: str) -> BinTable:
    return BinTable(1600, wp.get_device(device))


@given(seed=seeds, masked=st.booleans())
def test_looked_up_equals_computed(device: str, table: BinTable, seed: int, masked: bool) -> None:
    image = random_images(seed, "uint8")[:1]
    size = image.shape[1] * image.shape[2]
    rng = np.random.default_rng(seed)
    valid = np.full(image.shape[1:3], 255, np.uint8)
    if masked:
        valid[rng.random(valid.shape) < 0.3] = 0
    place = wp.get_device(device)
    pixels = wp.array(image.reshape(size, 3), dtype=wp.vec3ub, device=place)
    use = wp.array(valid.ravel(), dtype=wp.uint8, device=place)
    counts = wp.zeros(counts_shape(size, 3, place), dtype=wp.int64, device=place)
    table.count(pixels, use, counts)
    total = counts.numpy().sum(axis=0)
    model = rarity_model(image, threshold=2e-3, valid=valid, device=device)
    np.testing.assert_array_equal(total, model.counts.ravel())
    sure = certain(image, valid)
    table.count(pixels, wp.array(sure, dtype=wp.uint8, device=place), counts)
    clear = counts.numpy().sum(axis=0) - total
    twin = reference.rarity_bins(image).ravel()[sure > 0]
    np.testing.assert_array_equal(clear, np.bincount(twin, minlength=len(total)))
    weights = wp.zeros(size, dtype=wp.uint8, device=place)
    table.weigh(use, wp.array(byte_table(model), dtype=wp.uint8, device=place), weights)
    expected = apply_rarity(image, model, valid=valid, device=device)
    np.testing.assert_array_equal(weights.numpy(), np.asarray(expected).ravel())
