"""The colours themselves, as the second look sees them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hsvaos.detect.levels import LEVEL_CHANNELS, level_planes

Plane = NDArray[np.float32]
SIZE = 20, 24


def a_view(seed: int) -> tuple[Plane, Plane, tuple[Plane, Plane], tuple[Plane, Plane]]:
    rng = np.random.default_rng(seed)

    def pair() -> tuple[Plane, Plane]:
        colour = rng.uniform(5.0, 250.0, (*SIZE, 3)).astype(np.float32)
        much = rng.uniform(0.1, 9.0, SIZE).astype(np.float32)
        return colour, much * (rng.uniform(size=SIZE) < 0.8)

    image, rays = pair()
    return image, rays, pair(), pair()


def scaled(view: tuple, factors: NDArray[np.float32]) -> tuple:
    image, rays, *pairs = view
    return image * factors, rays, *((colour * factors, much) for colour, much in pairs)


@given(st.integers(0, 1000), st.floats(1e-3, 1e3))
def test_no_exposure_and_no_unit_changes_them(seed: int, gain: float) -> None:
    view = a_view(seed)
    found = level_planes(*scaled(view, np.full(3, gain, np.float32)))
    assert found.shape == (len(LEVEL_CHANNELS), *SIZE)
    np.testing.assert_allclose(found, level_planes(*view), atol=2e-4)


def test_they_are_logarithms_of_lightness_and_of_ratios_of_colours() -> None:
    image = np.full((*SIZE, 3), 100.0, np.float32)
    rays = np.ones(SIZE, np.float32)
    other = image.copy()
    other[3, 4] = 400.0, 200.0, 100.0
    found = level_planes(image, rays, (other, rays), (image, rays))
    dark = 0.05
    red, green, blue = np.log(np.array([4.0, 2.0, 1.0]) + dark)
    want = (red + green + blue) / 6.0, red - green, blue - 0.5 * (red + green)
    np.testing.assert_allclose(found[3:6, 3, 4], want, atol=1e-5)
    common = found.copy()
    common[3:6, 3, 4] = common[3:6, 0, 0]
    np.testing.assert_allclose(common[[0, 3, 6]], np.log(1.0 + dark) / 2.0, atol=1e-5)
    np.testing.assert_allclose(common[[1, 2, 4, 5, 7, 8]], 0.0, atol=1e-6)


def test_grey_has_lightness_only() -> None:
    image, rays, pieces, ground = a_view(1)
    grey = [picture[..., 0] for picture in (image, pieces[0], ground[0])]
    found = level_planes(grey[0], rays, (grey[1], pieces[1]), (grey[2], ground[1]))
    np.testing.assert_allclose(found[[1, 2, 4, 5, 7, 8]], 0.0, atol=1e-6)
    assert np.ptp(found[6]) > 0.5


@pytest.mark.parametrize("number", [0, 1, 2])
def test_what_is_not_known_is_0_and_changes_nothing_else(number: int) -> None:
    image, rays, pieces, ground = a_view(2)
    pairs = [(image, rays), pieces, ground]
    want = level_planes(image, rays, pieces, ground)
    colour, much = (part.copy() for part in pairs[number])
    colour[much <= 0.0] = np.nan
    much[much <= 0.0] = np.nan
    pairs[number] = colour, much
    found = level_planes(*pairs[0], pairs[1], pairs[2])
    np.testing.assert_array_equal(found, want)
    hidden = ~(np.nan_to_num(much) > 0.0)
    assert hidden.any()
    assert not found[3 * number : 3 * number + 3, hidden].any()
    nothing = level_planes(np.full_like(image, np.nan), rays, (image, 0 * rays), (image, 0 * rays))
    assert not nothing.any()
