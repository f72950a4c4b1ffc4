"""Finds on ground that hardly any photo has seen."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.detect.few_rays import ENOUGH_RAYS, doubted

BOXES = np.array([[0.0, 0.0, 4.0, 4.0], [10.0, 2.0, 14.0, 6.0]])


def rays(first, second, most=40.0):
    plane = np.full((8, 20), most, dtype=np.float32)
    plane[:, :8], plane[:, 8:16] = first, second
    return plane


def odds(score):
    return score / (1.0 - score)


@pytest.mark.parametrize("count", [1.0, 2.0, 4.0])
def test_odds_fall_with_the_rays(count):
    found = doubted(BOXES, np.array([0.7, 0.7]), rays(count, 20.0))
    assert odds(found[0]) == pytest.approx(odds(0.7) * count / ENOUGH_RAYS, rel=1e-5)
    assert found[1] == np.float32(0.7)


def test_half_of_the_most_rays_is_enough():
    found = doubted(BOXES, np.array([0.7, 0.7]), rays(2.0, 1.0, most=4.0))
    assert found[0] == np.float32(0.7)
    assert odds(found[1]) == pytest.approx(0.5 * odds(0.7), rel=1e-5)


def test_nothing_seen_and_nothing_found():
    unseen = doubted(BOXES, np.array([0.7, 1.0]), rays(0.0, 0.0, most=0.0))
    assert np.array_equal(unseen, np.array([0.7, 1.0], np.float32))
    assert doubted(BOXES[:0], np.zeros(0), rays(1.0, 1.0)).shape == (0,)
    assert doubted(BOXES, np.array([0.7, 0.7]), rays(np.nan, 9.0))[0] == 0.0


@given(st.floats(0.0, 1.0), st.floats(0.0, 60.0), st.floats(-9.0, 30.0))
def test_scores_never_rise_and_stay_scores(score, count, left):
    boxes = np.array([[left, -3.0, left + 5.0, 30.0]])
    found = doubted(boxes, np.array([score]), rays(count, count))
    assert 0.0 <= found[0] <= np.float32(score)
