"""Inputs at the edge of what is allowed: no NaN comes through, and no scale is guessed."""

from __future__ import annotations

import numpy as np
import pytest

from hsvaos import Camera, FocalPlane, Integrator, VirtualCamera, hue_masks, rarity_weights

POSE = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, -20], [0, 0, 0, 1]], float)
CAMERA = Camera.from_fov(16, 12, 70)
VIEW = VirtualCamera(CAMERA, POSE)


@pytest.mark.parametrize("statistics", ["circular", "linear"])
def test_forest_of_one_single_hue_is_cut(device: str, statistics: str) -> None:
    images = np.zeros((1, 20, 20, 3), np.uint8)
    images[...] = (34, 139, 34)
    masks, (stats,) = hue_masks(images, statistics=statistics, device=device)
    assert stats.informative
    assert (masks == 0).all()


def test_valid_masks_of_one_and_of_255_mean_the_same(device: str) -> None:
    images = np.random.default_rng(0).integers(0, 256, (2, 12, 16, 3), dtype=np.uint8)
    keep = np.random.default_rng(1).random((12, 16)) > 0.3
    for function in (hue_masks, rarity_weights):
        expected, _ = function(images, valid=keep, device=device)
        for mask in (keep * np.uint8(1), keep * np.uint8(255)):
            np.testing.assert_array_equal(function(images, valid=mask, device=device)[0], expected)


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("weighted", [True, False])
def test_pixels_that_are_no_numbers_are_not_there(
    device: str, colour: bool, weighted: bool
) -> None:
    rng = np.random.default_rng(0)
    images = rng.random((2, 12, 16, 3) if colour else (2, 12, 16)).astype(np.float32)
    weights = np.full((2, 12, 16), 0.5, np.float32) if weighted else None
    broken = images.copy()
    broken[0, 3, 3] = np.nan
    broken[1, 5:7, 5:7] = np.inf
    image, footprint = Integrator(CAMERA, broken, [POSE] * 2, weights, device=device).integrate(
        VIEW, FocalPlane()
    )
    assert np.isfinite(image).all()
    full = 1.0 if weighted else 2.0
    assert footprint[3, 3] == pytest.approx(full / 2, abs=0.01)
    assert footprint[0, 0] == pytest.approx(full, abs=0.01)
    whole, _ = Integrator(CAMERA, images, [POSE] * 2, weights, device=device).integrate(
        VIEW, FocalPlane()
    )
    np.testing.assert_allclose(image[8:], whole[8:], atol=1e-5)


def test_one_bad_pixel_does_not_blind_the_statistics(device: str) -> None:
    rng = np.random.default_rng(0)
    images = np.empty((1, 40, 40, 3), np.float32)
    images[...] = (0.2, 0.5, 0.2)
    images += rng.normal(0, 0.02, images.shape).astype(np.float32)
    _, (clean,) = hue_masks(images, device=device)
    images[0, 4, 4] = np.nan
    masks, (stats,) = hue_masks(images, device=device)
    assert stats.mean_deg == pytest.approx(clean.mean_deg, abs=0.1)
    assert masks[0, 4, 4] == 0
    weights, _ = rarity_weights(images, dtype="float32", device=device)
    assert weights[0, 4, 4] == 0
    assert np.isfinite(weights).all()


def test_float_images_of_0_to_255_are_refused(device: str) -> None:
    images = np.random.default_rng(0).uniform(0, 255, (1, 20, 20, 3)).astype(np.float32)
    for function in (hue_masks, rarity_weights):
        with pytest.raises(ValueError, match="from 0 to 1, got values up to"):
            function(images, device=device)


def test_rarity_of_a_flight_of_one_colour_is_no_mask(device: str) -> None:
    images = np.full((3, 12, 16, 3), 90, np.uint8)
    weights, _ = rarity_weights(images, device=device)
    _, footprint = Integrator(CAMERA, images, [POSE] * 3, weights, device=device).integrate(
        VIEW, FocalPlane()
    )
    assert footprint.max() < 0.1


def test_what_is_no_image_and_no_weight_is_refused() -> None:
    images = np.zeros((2, 12, 16, 3), np.uint8)
    with pytest.raises(ValueError, match="alike in shape and type"):
        Integrator(CAMERA, [images[0], images[1].astype(np.float32)], [POSE] * 2)
    with pytest.raises(ValueError, match=r"images\[None\]"):
        Integrator(CAMERA, np.zeros((20, 30, 3), np.uint8), [POSE])
    with pytest.raises(ValueError, match="negative or NaN"):
        Integrator(CAMERA, images, [POSE] * 2, np.full((2, 12, 16), -0.5, np.float32))
    with pytest.raises(TypeError, match="uint8, uint16 or float32, got float64"):
        Integrator(CAMERA, images, [POSE] * 2, np.ones((2, 12, 16)))
    integrator = Integrator(CAMERA, images, [POSE] * 2)
    with pytest.raises(TypeError, match="view must be a VirtualCamera"):
        integrator.integrate(None, FocalPlane())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="pair of arrays"):
        integrator.integrate(VIEW, FocalPlane(), out=(np.zeros((12, 16, 3), np.float32), None))
