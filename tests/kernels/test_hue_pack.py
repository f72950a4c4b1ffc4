"""The pass that cuts, brightens and packs at once does what the three kernels do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import Camera, FocalPlane, Integrator, VirtualCamera, hue_masks, reference
from hsvaos.kernels.color import brighten
from hsvaos.kernels.hue_mask import apply_hue_cut, measure_hue
from hsvaos.kernels.hue_pack import cut_and_pack
from hsvaos.kernels.packing import Packed
from tests.kernels.strategies import in_vectors_only, random_images, seeds
from tests.kernels.test_integrate import looking_down


def unpacked(packed: Packed, height: int, width: int) -> np.ndarray:
    """Bytes R, G, B, weight of every pixel, shape (N, H + 2, W + 2, 4)."""
    words = packed.words.numpy()[:, : packed.row * (height + 2)]
    rows = words.reshape(len(words), height + 2, packed.row)[:, :, : width + 2]
    return np.stack([rows >> shift & 255 for shift in (0, 8, 16, 24)], axis=-1)


@in_vectors_only
@given(
    seed=seeds, levelled=st.booleans(), masked=st.booleans(), gamma=st.sampled_from([0.3, 0.6, 1.0])
)
def test_one_pass_equals_cut_brighten_and_pack(
    seed: int, levelled: bool, masked: bool, gamma: float
) -> None:
    rng = np.random.default_rng(seed)
    images = random_images(seed, "uint8")
    count, height, width, _ = images.shape
    gains = rng.uniform(0.6, 1.6, (count, 3)) if levelled else None
    valid = (rng.random((height, width)) > 0.2) * np.uint8(255) if masked else None
    stats, _ = measure_hue(images, 1.0, valid=valid, gains=gains)
    amount = {"target_value": 0.7, "gamma": gamma, "max_gain": 2.5}
    masks, packed = cut_and_pack(images, stats, valid=valid, gains=gains, brightening=amount)
    expected = apply_hue_cut(images, stats, valid=valid, gains=gains)
    np.testing.assert_array_equal(masks.numpy(), expected)
    words = unpacked(packed, height, width)
    inner = words[:, 1:-1, 1:-1]
    np.testing.assert_array_equal(inner[..., 3], (expected > 0) * 255)
    twin = reference.brighten(images, expected, gains=gains, **amount)
    kept = expected > 0
    assert np.abs(inner[..., :3][kept] - twin.clip(0, 255)[kept]).max(initial=0.0) <= 0.51
    bright = brighten(images, expected, gains=gains, **amount)
    assert np.abs(inner[..., :3][kept].astype(int) - bright[kept]).max(initial=0) <= 1
    assert (inner[~kept] == 0).all()
    np.testing.assert_array_equal(words[:, 0], words[:, 1])  # the border repeats the edge
    np.testing.assert_array_equal(words[:, -1], words[:, -2])
    np.testing.assert_array_equal(words[:, :, 0], words[:, :, 1])
    np.testing.assert_array_equal(words[:, :, -1], words[:, :, -2])


@in_vectors_only
def test_an_integrator_takes_what_was_packed_and_memory_is_reused() -> None:
    rng = np.random.default_rng(4)
    images = rng.integers(0, 256, (3, 40, 50, 3), dtype=np.uint8)
    masks, stats = hue_masks(images, 0.5)
    made = cut_and_pack(images, stats)
    assert made is not None
    camera = Camera.from_fov(50, 40, 70)
    poses = [looking_down(n, 0, 20) for n in range(3)]
    view = VirtualCamera(camera, poses[1])
    fused = Integrator(camera, images, poses, made[0], packed=made[1])
    plain = Integrator(camera, images, poses, masks)
    for a, b in zip(
        fused.integrate(view, FocalPlane()), plain.integrate(view, FocalPlane()), strict=True
    ):
        np.testing.assert_array_equal(a, b)
    again = cut_and_pack(images, stats, out=made[0], photos=made[1])
    assert again is not None
    assert again[1] is made[1]
    with pytest.raises(ValueError, match="photos must hold"):
        cut_and_pack(images[:, :-1], stats, photos=made[1])


@in_vectors_only
def test_where_one_pass_does_not_apply_it_says_so() -> None:
    images = random_images(1, "uint8")
    stats, _ = measure_hue(images)
    soft = np.full(images.shape[1:3], 100, np.uint8)
    assert cut_and_pack(images, stats, valid=soft) is None
    assert cut_and_pack(images.astype(np.uint16) * 257, stats) is None
    with pytest.raises(ValueError, match="gamma"):
        cut_and_pack(
            images, stats, brightening={"target_value": 0.5, "gamma": 0.0, "max_gain": 2.0}
        )
