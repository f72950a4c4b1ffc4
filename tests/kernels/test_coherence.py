"""Coherence of rays against the float64 twin, and what it means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos import Camera, FocalPlane, VirtualCamera
from hsvaos.kernels.integrate import Integrator
from hsvaos.reference_coherence import coherence
from tests.kernels.strategies import dtypes, random_camera, random_pose, seeds


@settings(max_examples=25)
@given(seed=seeds, dtype=dtypes, colour=st.booleans(), weighted=st.booleans())
def test_coherence_equals_twin(
    device: str, seed: int, dtype: str, colour: bool, weighted: bool
) -> None:
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, 36, 28, rng.random() < 0.5)
    count = int(rng.integers(1, 24))
    white = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    # few colours, so that rays do agree
    palette = rng.random((4, 3) if colour else 4)
    images = palette[rng.integers(0, 4, (count, 28, 36))] + rng.normal(
        0.0, 0.03, (count, 28, 36, 3) if colour else (count, 28, 36)
    )
    images = (np.clip(images, 0.0, 1.0) * white).astype(dtype)
    poses = np.stack([random_pose(rng) for _ in range(count)])
    weights = None
    if weighted:
        weights = rng.integers(2, 256, (count, 28, 36), dtype=np.uint8)
        weights[rng.random(weights.shape) < 0.4] = 2  # below what counts
        weights[rng.random(weights.shape) < 0.1] = 0
        if rng.random() < 0.5:
            weights = weights.astype(np.uint16) * np.uint16(257)
    gains = None if rng.random() < 0.5 else rng.uniform(0.8, 1.2, (count, 3))
    view = VirtualCamera.ortho(4.0, -4.0, 0.7, 12, 11)
    surface = FocalPlane(float(rng.uniform(-1.0, 1.0)))
    integrator = Integrator(camera, images, poses, weights, device=device, gains=gains)
    image, ours = integrator.coherence(view, surface)
    twin_image, twin, certain = coherence(camera, images, poses, view, surface, weights, gains)
    assert ours.dtype == image.dtype == np.float32
    assert image.shape == twin_image.shape
    assert np.abs(ours - twin)[certain].max(initial=0.0) < 2e-3
    assert np.abs(image - twin_image)[certain].max(initial=0.0) < 4e-3 * white


def _overhead(count: int, colours: np.ndarray) -> tuple[Camera, np.ndarray, np.ndarray]:
    camera = Camera.from_fov(16, 16, 60.0)
    images = np.broadcast_to(colours[:, None, None], (count, 16, 16, 3)).astype(np.uint8)
    pose = np.eye(4)
    pose[2, 3] = -20.0
    return camera, np.ascontiguousarray(images), np.repeat(pose[None], count, axis=0)


def test_agreement_outweighs_chance(device: str) -> None:
    chance = np.array([[200, 20, 20], [20, 20, 200], [20, 200, 20], [220, 220, 20]])
    agreed = np.array([[200, 20, 20], [198, 22, 20], [202, 21, 22], [200, 18, 19]])
    view = VirtualCamera.ortho(1.0, -1.0, 0.2, 8, 8)
    values = []
    for colours in (chance, agreed):
        camera, images, poses = _overhead(4, colours)
        image, value = Integrator(camera, images, poses, device=device).coherence(
            view, FocalPlane()
        )
        values.append(value)
    assert values[0] == pytest.approx(0.5, abs=1e-3)  # one ray of four
    assert (values[1] > 0.95).all()
    assert image[0, 0] == pytest.approx(agreed.mean(axis=0), abs=1.0)


def test_light_rays_count_only_as_rays(device: str) -> None:
    camera, images, poses = _overhead(4, np.array([[200, 20, 20]] * 4))
    weights = np.full((4, 16, 16), 2, dtype=np.uint8)
    view = VirtualCamera.ortho(1.0, -1.0, 0.2, 8, 8)
    integrator = Integrator(camera, images, poses, weights, device=device)
    image, value = integrator.coherence(view, FocalPlane())
    assert (value == 0.0).all()
    assert (image == 0.0).all()
    weights[0] = 255
    _, value = Integrator(camera, images, poses, weights, device=device).coherence(
        view, FocalPlane()
    )
    assert value == pytest.approx(0.5, abs=1e-3)


def test_written_in_place_and_checked(device: str) -> None:
    camera, images, poses = _overhead(2, np.array([[200, 20, 20]] * 2))
    integrator = Integrator(camera, images, poses, device=device)
    view = VirtualCamera.ortho(1.0, -1.0, 0.2, 8, 6)
    out = (np.zeros((6, 8, 3), np.float32), np.zeros((6, 8), np.float32))
    if device == "cpu":
        assert integrator.coherence(view, FocalPlane(), out=out) is out
        assert (out[1] > 0.9).all()
    with pytest.raises(ValueError, match="frames"):
        integrator.coherence(view, FocalPlane(), frames=[7])
    with pytest.raises(TypeError, match="surface"):
        integrator.coherence(view, None)  # type: ignore[arg-type]
