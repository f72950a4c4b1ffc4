"""Heights follow agreement, and are smooth where there is none."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos.relief.agreement import Agreement
from hsvaos.relief.contrast import MOST, ground_contrast
from hsvaos.relief.fit import fit_heights

OFFSETS = np.linspace(-1.3, 1.3, 27)


def agreement_at(depth: np.ndarray, where: np.ndarray, chance: float = 1e-6) -> Agreement:
    """Agreement that peaks at a depth where there is some."""
    away = (OFFSETS[:, None, None] - depth) / 0.12
    agreed = (0.01 * np.exp(-0.5 * away**2) * where).astype(np.float32)
    power = np.broadcast_to(0.02 * where, agreed.shape).astype(np.float32)
    return Agreement(OFFSETS, agreed, power, np.full(depth.shape, chance, np.float32), 0.4)


@given(depth=st.floats(-0.9, 0.9))
@settings(max_examples=20, deadline=None)
def test_a_level_ground_is_level(depth: float) -> None:
    shape = (40, 50)
    heights, sure = fit_heights(agreement_at(np.full(shape, depth), np.ones(shape)))
    np.testing.assert_allclose(heights, depth, atol=0.02)
    assert (sure > 0.9).all()


def test_ground_between_is_drawn_through() -> None:
    rows, columns = np.mgrid[:60, :60]
    depth = 0.01 * (rows - 30.0)
    seen = (np.abs(columns - 30) > 8).astype(float)
    heights, sure = fit_heights(agreement_at(depth, seen))
    np.testing.assert_allclose(heights[10:50, 10:50], depth[10:50, 10:50], atol=0.05)
    assert sure[30, 30] < 0.5


def test_nothing_seen_is_the_plane() -> None:
    shape = (30, 30)
    heights, sure = fit_heights(agreement_at(np.full(shape, 0.4), np.zeros(shape)))
    assert not heights.any()
    assert not sure.any()


def test_chance_alone_moves_nothing_far() -> None:
    rng = np.random.default_rng(1)
    shape = (27, 60, 60)
    noise = rng.normal(0.0, 1e-3, shape).astype(np.float32)
    power = np.full(shape, 0.02, np.float32)
    one_point = np.full(shape[1:], 1e-6 * 16, np.float32)  # a cell is a mean of 16 points
    heights, _ = fit_heights(Agreement(OFFSETS, noise, power, one_point, 0.4))
    assert np.abs(heights).mean() < 0.02


def test_contrast_is_that_of_the_ground_alone() -> None:
    rng = np.random.default_rng(2)
    photo = rng.integers(60, 120, (80, 100, 3)).astype(np.uint8)
    ground = np.full((80, 100), 255, np.uint8)
    ground[:, 40:] = 0
    bright = photo.copy()
    bright[:, 44:] = 255  # a crown in the sun
    one = np.ones(3)
    plain, beside = (ground_contrast(p, ground, one, 255.0) for p in (photo, bright))
    np.testing.assert_allclose(plain[:, :38], beside[:, :38], atol=0.02)
    assert np.abs(plain).max() <= MOST
    # twice the light with half the gain is the same ground
    halves = ground_contrast(photo // 2 * 2, ground, 0.5 * one, 255.0)
    same = ground_contrast(photo // 2, ground, one, 255.0)
    np.testing.assert_allclose(halves, same, atol=1e-4)
