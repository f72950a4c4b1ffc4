"""Running sums against their twin, and that nothing is left of what was taken out."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.kernels.running import MOST_PHOTOS, WEIGHT_STEPS, RunningSums
from hsvaos.reference_running import running_mean
from tests.kernels.strategies import seeds


class Pictures:
    """Views of single photos with holes, and sums of them on a device."""

    def __init__(self, seed: int, channels: int, white: float, device: str, count: int = 6) -> None:
        rng = np.random.default_rng(seed)
        shape = (count, 7, 9)
        self.images = (rng.random((*shape, channels)) * white).astype(np.float32)
        self.footprints = (rng.random(shape) ** 4).astype(np.float32)
        self.footprints[rng.random(shape) < 0.4] = 0.0
        self.images[self.footprints == 0.0] = 0.0
        self.device = wp.get_device(device)
        self.sums = RunningSums(63, channels, white, self.device)
        self.image = wp.empty((7, 9, channels), dtype=float, device=device)
        self.footprint = wp.empty((7, 9), dtype=float, device=device)

    def add(self, i: int, sign: int = 1) -> None:
        image = wp.array(self.images[i], dtype=float, device=self.device)
        footprint = wp.array(self.footprints[i], dtype=float, device=self.device)
        self.sums.add(image, footprint, sign)

    def mean(self) -> tuple[np.ndarray, np.ndarray]:
        self.sums.mean(self.image, self.footprint)
        return self.image.numpy().copy(), self.footprint.numpy().copy()


@given(seed=seeds, channels=st.sampled_from([1, 3]), white=st.sampled_from([1.0, 255.0, 65535.0]))
def test_sums_equal_their_twin(device: str, seed: int, channels: int, white: float) -> None:
    pictures = Pictures(seed, channels, white, device)
    for i in range(6):
        pictures.add(i)
    image, footprint = pictures.mean()
    expected, weights = running_mean(pictures.images, pictures.footprints)
    np.testing.assert_allclose(footprint, weights, rtol=1e-6, atol=1e-11)
    seen = weights > 1e-6
    np.testing.assert_allclose(image[seen], expected[seen], rtol=1e-5, atol=1e-6 * white)
    assert (image[weights == 0.0] == 0.0).all()


@given(seed=seeds, turns=st.lists(st.integers(0, 5), max_size=40))
def test_what_was_taken_out_leaves_no_trace(device: str, seed: int, turns: list[int]) -> None:
    pictures = Pictures(seed, 3, 255.0, device)
    inside: set[int] = set()
    for i in turns:
        pictures.add(i, -1 if i in inside else 1)
        inside ^= {i}
    image, footprint = pictures.mean()
    pictures.sums.clear()
    for i in sorted(inside):
        pictures.add(i)
    fresh, weights = pictures.mean()
    np.testing.assert_array_equal(image, fresh)
    np.testing.assert_array_equal(footprint, weights)


@pytest.mark.parametrize("white", [255.0, 65535.0])
def test_the_greatest_sum_is_still_exact(white: float) -> None:
    assert MOST_PHOTOS * WEIGHT_STEPS <= 2.0**53
    pictures = Pictures(0, 3, white, "cpu", count=1)
    pictures.images[:], pictures.footprints[:] = white, 1.0
    for _ in range(MOST_PHOTOS):
        pictures.add(0)
    for _ in range(MOST_PHOTOS - 1):
        pictures.add(0, -1)
    image, footprint = pictures.mean()
    assert (image == white).all()
    assert (footprint == 1.0).all()
