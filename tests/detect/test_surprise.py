"""Surprise: what is rare in an integral image, by colour and by contrast."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import reference
from hsvaos.detect.surprise import MOST, surprise_of_colours, surprise_of_contrasts
from hsvaos.kernels.rarity import rarity_model
from hsvaos.rarity_model import CHROMA_BINS, LIGHTNESS_BINS, colour_bins

EVERYWHERE = np.ones((90, 110), dtype=bool)


def ground(seed=0):
    rng = np.random.default_rng(seed)
    return (rng.normal(1.0, 0.05, (90, 110, 1)) * (90.0, 80.0, 50.0)).astype(np.float32)


@pytest.mark.parametrize("among_alike", [False, True])
def test_a_rare_colour_surprises(among_alike):
    picture = ground()
    picture[40:46, 50:56] = (30.0, 60.0, 160.0)
    found = surprise_of_colours(picture, EVERYWHERE, among_alike=among_alike)
    assert found.dtype == np.float32
    assert found[40:46, 50:56].min() > 1.0
    assert np.median(found) < 0.5
    assert found.max() <= MOST


def test_a_rare_contrast_surprises():
    rng = np.random.default_rng(1)
    contrast = rng.standard_normal((3, 300, 400), dtype=np.float32)
    contrast[:, 40:44, 50:54] += np.array([9.0, -4.0, -3.0], np.float32)[:, None, None]
    for part in (contrast, contrast[:1]):
        found = surprise_of_contrasts(part, np.ones((300, 400), dtype=bool))
        assert found[40:44, 50:54].min() > 1.0
        assert np.median(found) < 0.6


@given(st.integers(0, 1000), st.floats(0.01, 50.0))
def test_bounds_and_unseen(seed, gain):
    rng = np.random.default_rng(seed)
    seen = rng.random((90, 110)) < 0.7
    picture = (rng.random((90, 110, 3)) * gain).astype(np.float32)
    contrast = rng.normal(0.0, gain, (3, 90, 110)).astype(np.float32)
    for found in (surprise_of_colours(picture, seen), surprise_of_contrasts(contrast, seen)):
        assert found.shape == seen.shape
        assert np.isfinite(found).all()
        assert (found >= 0.0).all()
        assert (found <= MOST).all()
        assert (found[~seen] == 0.0).all()


@pytest.mark.parametrize("value", [0.0, 7.0])
def test_flat_pictures_and_empty_ones(value):
    flat = np.full((90, 110, 3), value, dtype=np.float32)
    nobody = np.zeros((90, 110), dtype=bool)
    assert (surprise_of_colours(flat, EVERYWHERE) < 0.5).all()
    assert (surprise_of_contrasts(flat.transpose(2, 0, 1) * 0.0, EVERYWHERE) < 0.5).all()
    assert (surprise_of_colours(flat, nobody) == 0.0).all()
    assert (surprise_of_contrasts(flat.transpose(2, 0, 1), nobody) == 0.0).all()


def test_bins_are_those_of_the_rarity_kernel():
    rng = np.random.default_rng(3)
    image = rng.random((60, 70, 3)).astype(np.float32)
    counts = rarity_model(image[None]).counts
    bins = colour_bins(reference.rgb_to_lab(image).astype(np.float32))
    own = np.bincount(bins.ravel(), minlength=counts.size).reshape(
        LIGHTNESS_BINS, CHROMA_BINS, CHROMA_BINS
    )
    # the kernel's tables may put a colour into the next bin
    assert np.abs(own - counts).sum() < 0.005 * bins.size
