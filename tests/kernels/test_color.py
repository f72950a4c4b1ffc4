"""HSV conversion and brightening against OpenCV and the NumPy twin."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given

from hsvaos import reference
from hsvaos.kernels.color import brighten, hsv_to_rgb, rgb_to_hsv
from tests.kernels.strategies import dtypes, random_images, seeds


def hue_error(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs((a - b + 180.0) % 360.0 - 180.0)


@given(seed=seeds, dtype=dtypes)
def test_hsv_equals_twin(device: str, seed: int, dtype: str) -> None:
    images = random_images(seed, dtype)
    hsv = rgb_to_hsv(images, device=device)
    twin = reference.rgb_to_hsv(images)
    assert hsv.dtype == np.float32
    assert hsv.shape == images.shape
    # the error of hue is that of float32 over the chroma
    chroma = twin[..., 1] * twin[..., 2]
    assert (hue_error(hsv[..., 0], twin[..., 0]) * chroma).max() < 1e-4
    np.testing.assert_allclose(hsv[..., 1:], twin[..., 1:], atol=2e-6)
    assert (hsv[..., 0] >= 0.0).all()
    assert (hsv[..., 0] < 360.0).all()


@given(seed=seeds)
def test_hsv_equals_opencv(device: str, seed: int) -> None:
    images = random_images(seed, "uint8")
    hsv = rgb_to_hsv(images, device=device)
    for image, ours in zip(images, hsv, strict=True):
        theirs = cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2HSV)
        assert hue_error(ours[..., 0], theirs[..., 0]).max() < 2e-3
        # OpenCV divides by V + FLT_EPSILON, which near black is not V
        value = np.maximum(theirs[..., 2], 1.0 / 255.0)
        theirs[..., 1] *= (value + np.finfo(np.float32).eps) / value
        np.testing.assert_allclose(ours[..., 1:], theirs[..., 1:], atol=1e-5)
        eight_bit = cv2.cvtColor(image, cv2.COLOR_RGB2HSV).astype(float)
        # OpenCV: 8-bit hue has steps of 2 deg, and its table of quotients adds up to 0.31
        assert hue_error(ours[..., 0], 2.0 * eight_bit[..., 0]).max() <= 1.32
        assert np.abs(255.0 * ours[..., 1] - eight_bit[..., 1]).max() <= 1.01
        assert np.abs(255.0 * ours[..., 2] - eight_bit[..., 2]).max() <= 0.01


@given(seed=seeds, dtype=dtypes)
def test_round_trip(device: str, seed: int, dtype: str) -> None:
    images = random_images(seed, dtype)
    back = hsv_to_rgb(rgb_to_hsv(images, device=device), dtype=dtype, device=device)
    error = np.abs(back.astype(float) - images.astype(float)).max()
    assert error <= {"uint8": 0.0, "uint16": 1.0, "float32": 1e-6}[dtype]


@given(seed=seeds)
def test_hsv_to_rgb_equals_twin(device: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    hsv = rng.random((1, 9, 7, 3)).astype(np.float32)
    hsv[..., 0] = hsv[..., 0] * 1440 - 720  # hue wraps
    np.testing.assert_allclose(hsv_to_rgb(hsv, device=device), reference.hsv_to_rgb(hsv), atol=1e-5)


@given(seed=seeds, dtype=dtypes)
def test_brighten_equals_twin_and_leaves_hue(device: str, seed: int, dtype: str) -> None:
    for colour in (True, False):
        images = random_images(seed, dtype, colour)
        keep = np.random.default_rng(seed).random(images.shape[:3]) > 0.4
        ours = brighten(images, keep, target_value=0.6, gamma=0.4, max_gain=3.0, device=device)
        twin = reference.brighten(images, keep, 0.6, 0.4, 3.0)
        tolerance = 1e-5 if dtype == "float32" else 0.51
        assert np.abs(ours - twin).max() <= tolerance
        gains = np.random.default_rng(seed).uniform(0.5, 1.0, (len(images), 3))
        levelled = brighten(images, keep, target_value=0.6, gains=gains, device=device)
        twin = reference.brighten(images, keep, 0.6, 0.6, 3.0, gains)
        assert np.abs(levelled - twin).max() <= tolerance
        assert (ours[~keep] == images[~keep]).all()
        if colour and dtype == "float32":
            before, after = rgb_to_hsv(images), rgb_to_hsv(ours)
            chroma = before[..., 1] * before[..., 2]
            assert (hue_error(before[..., 0], after[..., 0]) * chroma).max() < 1e-3
            np.testing.assert_allclose(after[..., 1], before[..., 1], atol=1e-5)


def test_brighten_in_place(device: str) -> None:
    images = random_images(1, "uint8")
    expected = brighten(images, device=device)
    if device == "cpu":
        assert brighten(images, out=images) is images
        np.testing.assert_array_equal(images, expected)


def test_bad_input() -> None:
    image = np.zeros((1, 4, 5, 3), np.uint8)
    with pytest.raises(TypeError, match="uint8, uint16 or float32, got float64"):
        rgb_to_hsv(image.astype(float))
    with pytest.raises(ValueError, match="shape"):
        rgb_to_hsv(image[0, 0])
    with pytest.raises(ValueError, match="RGB"):
        rgb_to_hsv(image[..., 0])
    with pytest.raises(ValueError, match="gamma"):
        brighten(image, gamma=0.0)
    with pytest.raises(ValueError, match="out must have shape"):
        rgb_to_hsv(image, out=np.zeros((1, 4, 4, 3), np.float32))
    with pytest.raises(ValueError, match="has: cpu"):
        rgb_to_hsv(image, device="cuda:99")
