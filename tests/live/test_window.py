"""After any sequence of photos and views the window shows what a fresh Integrator shows."""

from __future__ import annotations

import tracemalloc
from collections import deque
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import FocalPlane, Integrator, VirtualCamera
from hsvaos.kernels.color import brighten
from hsvaos.kernels.device import set_threads
from hsvaos.kernels.hue_mask import apply_hue_cut, measure_hue
from hsvaos.kernels.rarity import rarity_weights
from hsvaos.live.ring import Format, Out
from hsvaos.live.window import Window
from hsvaos.settings import MaskSettings
from tests.kernels.strategies import random_camera, random_pose, rotation, seeds
from tests.kernels.test_tiles import decibel

SIZE = (37, 29)


class Twin:
    """What the window should hold: its photos, poses and the weights they came with."""

    def __init__(self, window: Window) -> None:
        self.window = window
        self.photos: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=window.frames)
        self.raw: deque[np.ndarray] = deque(maxlen=window.frames)

    def add(self, image: np.ndarray, pose: np.ndarray, valid: np.ndarray | None) -> None:
        mask = self.window.mask
        self.raw.append(image)
        if mask.method == "none":
            weights = np.full(image.shape[:2], 255, np.uint8) if valid is None else valid
        elif mask.method == "rarity":
            kept = {"threshold": mask.rarity_threshold, "valid": valid}
            weights = rarity_weights(np.stack(self.raw), **kept)[0][-1]
        else:
            how = (mask.sigmas, mask.statistics, mask.scope)
            stats = measure_hue(np.stack(self.raw), *how, valid=valid)[0][-1:]
            weights = apply_hue_cut(image[None], stats, valid=valid)[0]
            if mask.brighten:
                image = brighten(image[None], weights[None], target_value=mask.target_value)[0]
        self.photos.append((image, pose, weights))

    def picture(self, view: VirtualCamera, surface: Any) -> tuple[np.ndarray, np.ndarray]:
        images, poses, weights = (np.stack(part) for part in zip(*self.photos, strict=True))
        camera = self.window.format.camera
        return Integrator(camera, images, poses, weights).integrate(view, surface)


def random_window(
    rng: np.random.Generator, method: str, channels: int, device: str, packed: bool | None
) -> tuple[Window, np.ndarray | None]:
    camera = random_camera(rng, 45, 33, rng.random() < 0.3)
    valid = None
    if rng.random() < 0.5:
        valid = (rng.random((33, 45)) > 0.1) * np.uint8(255)
    mask = MaskSettings(
        method=method,
        sigmas=0.7,
        statistics=str(rng.choice(["circular", "linear"])),
        scope=str(rng.choice(["image", "flight"])),
        brighten=bool(rng.random() < 0.5),
        rarity_threshold=2e-3,
    )
    frames = int(rng.integers(1, 6))
    made = Window(Format(camera, channels), frames, SIZE, mask, valid, device, packed)
    return made, valid


def views(rng: np.random.Generator) -> VirtualCamera:
    return VirtualCamera(random_camera(rng, *SIZE, False), random_pose(rng))


@pytest.mark.parametrize("packed", [True, False])
@given(
    seed=seeds,
    method=st.sampled_from(["hue", "rarity", "none"]),
    grey=st.booleans(),
    turns=st.lists(st.sampled_from(["rest", "rest", "rest", "view", "surface"]), max_size=14),
)
def test_the_window_equals_a_fresh_integrator(
    device: str, packed: bool, seed: int, method: str, grey: bool, turns: list[str]
) -> None:
    if packed and device != "cpu":
        pytest.skip("photos are packed on the CPU only")
    rng = np.random.default_rng(seed)
    channels = 1 if grey and method == "none" else 3
    window, valid = random_window(rng, method, channels, device, packed)
    twin = Twin(window)
    out = Out.empty(SIZE, channels, window.device)
    view, surface = views(rng), FocalPlane(0.5)
    for turn in ["rest", *turns]:
        if turn == "view":
            view = views(rng)
        elif turn == "surface":
            surface = FocalPlane(rng.uniform(-2.0, 2.0))
        image = rng.integers(0, 256, window.format.shape, dtype=np.uint8)
        pose = random_pose(rng)
        twin.add(image, pose, valid)
        window.step(image, pose, view, surface, out)
        expected, cover = twin.picture(view, surface)
        seen = out.footprint.numpy()
        same = np.abs(seen - cover) <= 2e-3 * np.maximum(cover, 1.0)
        assert same.mean() > 0.97  # a border may fall on either side of a pixel
        certain = same & (cover > 0.05)
        shown = out.image.numpy().reshape(*cover.shape, channels)
        assert (shown[seen == 0.0] == 0.0).all()
        if certain.any():
            fresh = expected.reshape(shown.shape)
            assert decibel(shown[certain], fresh[certain], 255.0) > 60.0


@pytest.mark.parametrize("packed", [True, False])
def test_nothing_drifts_over_thousands_of_photos(device: str, packed: bool) -> None:
    """Two windows of the same last photos, one after thousands of others: equal to the last bit."""
    if packed and device != "cpu":
        pytest.skip("photos are packed on the CPU only")
    rng = np.random.default_rng(5)
    camera = random_camera(rng, 45, 33, False)
    view, surface = views(rng), FocalPlane(0.0)
    images = rng.integers(0, 256, (7, 33, 45, 3), dtype=np.uint8)
    poses = [random_pose(rng) for _ in range(11)]
    mask = MaskSettings(method="rarity")

    def fly(first: int, last: int) -> list[np.ndarray]:
        window = Window(Format(camera), 5, SIZE, mask, None, device, packed)
        out = Out.empty(SIZE, 3, window.device)
        for i in range(first, last):
            window.step(images[i % 7], poses[i % 11], view, surface, out)
        return [out.image.numpy(), out.footprint.numpy()]

    # the weights of a photo depend on the four before it: ten are enough to know all
    for long, short in zip(fly(0, 3000), fly(2985, 3000), strict=True):
        np.testing.assert_array_equal(long, short)


def test_a_step_takes_no_memory_of_the_size_of_a_photo() -> None:
    rng = np.random.default_rng(1)
    camera = random_camera(rng, 800, 600, False)
    images = rng.integers(0, 256, (3, 600, 800, 3), dtype=np.uint8)
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = rotation(rng, 0.1), -20.0
    view, surface = VirtualCamera(random_camera(rng, 400, 300, False), pose), FocalPlane(0.0)
    for method in ("hue", "none"):
        window = Window(Format(camera), 4, (400, 300), MaskSettings(method=method))
        out = Out.empty((400, 300), 3, window.device)
        set_threads(1)
        try:
            for i in range(8):
                window.step(images[i % 3], pose, view, surface, out)
            tracemalloc.start()
            for i in range(8):
                moved = view if i < 4 else VirtualCamera(view.camera, pose)
                window.step(images[i % 3], pose, moved, surface, out)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
            set_threads(0)
        assert peak < images[0].nbytes / 10


def test_what_makes_no_sense_is_refused() -> None:
    rng = np.random.default_rng(2)
    camera = random_camera(rng, 45, 33, False)
    with pytest.raises(ValueError, match="frames must lie in"):
        Window(Format(camera), 0, SIZE, MaskSettings())
    with pytest.raises(ValueError, match="must be one of hue, rarity, none"):
        Window(Format(camera), 3, SIZE, MaskSettings(method="anomaly"))
    with pytest.raises(ValueError, match="needs RGB"):
        Window(Format(camera, 1), 3, SIZE, MaskSettings())
    with pytest.raises(ValueError, match="keep_colours"):
        Window(Format(camera), 3, SIZE, MaskSettings(keep_colours=("#ff0000",)))
    with pytest.raises(ValueError, match="valid must be"):
        Window(Format(camera), 3, SIZE, MaskSettings(), np.ones((3, 3), bool))
    with pytest.raises(ValueError, match="uint16"):
        Format(camera, 3, "uint16")
    window = Window(Format(camera), 3, SIZE, MaskSettings())
    out, view = Out.empty(SIZE, 3, window.device), views(rng)
    good = np.zeros((33, 45, 3), np.uint8)
    for image, pose, seen, message in (
        (good[1:], np.eye(4), view, "image must have shape"),
        (good, 2.0 * np.eye(4), view, "world_from_camera must"),
        (good, np.eye(4), VirtualCamera(camera, np.eye(4)), "the window's size"),
    ):
        with pytest.raises(ValueError, match=message):
            window.step(image, pose, seen, FocalPlane(), out)
    assert len(window) == 0  # nothing of what was refused stays
