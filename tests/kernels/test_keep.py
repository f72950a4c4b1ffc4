"""Colours to keep, against the twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import reference
from hsvaos.kernels.keep import keep_colours
from tests.kernels.strategies import dtypes, random_images, seeds


@given(seed=seeds, dtype=dtypes, distance=st.floats(1.0, 40.0), scalar=st.booleans())
def test_kept_colours_equal_twin(
    device: str, seed: int, dtype: str, distance: float, scalar: bool
) -> None:
    images = random_images(seed, dtype)
    rng = np.random.default_rng(seed)
    valid = rng.integers(0, 256, images.shape[:3]).astype(np.uint8)
    colours = rng.random((2, 3)).astype(np.float32)
    weights = np.full(images.shape[:3], 7, np.float32 if scalar else np.uint8)
    unlike = np.min([reference.colour_distance(images, colour) for colour in colours], axis=0)
    kept = keep_colours(images, weights.copy(), colours, distance, valid=valid, device=device)
    full = valid / np.float32(255.0) if scalar else valid
    clear = np.abs(unlike - distance) > 0.02
    expected = np.where(unlike <= distance, full, weights)
    np.testing.assert_allclose(kept[clear], expected[clear], rtol=1e-6)


def test_nothing_is_kept_without_colours(device: str) -> None:
    images = random_images(1, "uint8")
    weights = np.zeros(images.shape[:3], np.uint8)
    keep_colours(images, weights, [], 5.0, device=device)
    assert not weights.any()


def test_bad_arguments_are_named() -> None:
    images = random_images(1, "uint8")
    weights = np.zeros(images.shape[:3], np.uint8)
    with pytest.raises(ValueError, match="distance must be a positive number"):
        keep_colours(images, weights, [[1, 0, 0]], 0.0)
    with pytest.raises(ValueError, match="weights must have shape"):
        keep_colours(images, weights[:1], [[1, 0, 0]], 1.0)
    with pytest.raises(ValueError, match="images must be RGB"):
        keep_colours(images[..., 0], weights, [[1, 0, 0]], 1.0)
    with pytest.raises(TypeError, match="weights must be uint8 or float32"):
        keep_colours(images, weights.astype(np.uint16), [[1, 0, 0]], 1.0)
