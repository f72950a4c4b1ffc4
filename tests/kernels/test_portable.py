"""The kernels that CUDA runs: on the CPU they do what its own forms do, and NVRTC compiles them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from hsvaos import Camera, FocalPlane, FocalTerrain, Integrator, VirtualCamera
from hsvaos.kernels import device as devices
from hsvaos.kernels.anomaly import rx_masks
from hsvaos.kernels.color import brighten, hsv_to_rgb, rgb_to_hsv
from hsvaos.kernels.hue_mask import apply_hue_cut, hue_masks, measure_hue
from hsvaos.kernels.keep import keep_colours
from hsvaos.kernels.levels import channel_quantiles
from hsvaos.kernels.rarity import rarity_weights
from hsvaos.kernels.sweep import focus_measure
from hsvaos.live.ring import Format, Out
from hsvaos.live.window import Window
from hsvaos.settings import MaskSettings
from tests.kernels.strategies import random_pose

CAMERA = Camera.from_fov(48, 40, 70.0)
LENS = Camera(48, 40, 34.0, 34.0, 23.5, 19.5, (-0.1, 0.02, 0.001, -0.001, 0.0))
COUNT = 5
Arrays = list[np.ndarray]


def scene(dtype: str = "uint8", colour: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smooth photos, masks and poses: a step of rounding shall not be a step of colour."""
    rng = np.random.default_rng(3)
    waves = np.linspace(0.0, 6.0, 48) + np.linspace(0.0, 4.0, 40)[:, None]
    shift = rng.uniform(0, 6, (COUNT, 1, 1, 3))
    values = 0.5 + 0.4 * np.sin(waves[None, :, :, None] + shift)
    white = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    images = (values[..., : 3 if colour else 1] * white).astype(dtype)
    poses = np.stack([random_pose(rng, reach=3.0) for _ in range(COUNT)])
    masks = (rng.random((COUNT, 40, 48)) < 0.7) * np.uint8(255)
    return images if colour else images[..., 0], masks, poses


def view_from(poses: np.ndarray) -> VirtualCamera:
    return VirtualCamera(Camera.from_fov(40, 36, 50.0), poses[2])


def terrain() -> FocalTerrain:
    axis = np.arange(-60.0, 61.0, 3.0)
    return FocalTerrain.from_arrays(axis, axis, np.sin(axis / 9)[:, None] * np.cos(axis / 7))


def integral(dtype: str, colour: bool, camera: Camera, soft: bool = False) -> Arrays:
    images, masks, poses = scene(dtype, colour)
    if soft:
        masks = masks // 2 + np.arange(48, dtype=np.uint8)
    integrator = Integrator(
        camera, images, poses, masks, gains=np.linspace(0.8, 1.2, 15).reshape(5, 3)
    )
    one = integrator.integrate(view_from(poses), terrain(), 8.0)
    return [*one, *integrator.sweep(view_from(poses), np.linspace(-2.0, 1.0, 9))]


def coherence() -> Arrays:
    images, masks, poses = scene()
    return list(Integrator(CAMERA, images, poses, masks).coherence(view_from(poses), FocalPlane()))


def hue() -> Arrays:
    images, masks, _ = scene()
    stats, _ = measure_hue(images, 0.5, valid=masks)
    cut = apply_hue_cut(images, stats, valid=masks)
    return [cut, hue_masks(images)[0], brighten(images, cut, target_value=0.6)]


def colours() -> Arrays:
    hsv = rgb_to_hsv(scene()[0])
    return [hsv[..., 1:], hsv_to_rgb(hsv), channel_quantiles(scene()[0])]


def weights() -> Arrays:
    images, masks, _ = scene()
    rare, model = rarity_weights(images)
    kept = keep_colours(images, masks, np.array([[60.0, 40.0, 30.0]]), 30.0)
    return [rare, model.probability, kept, rx_masks(images, 0.9)[0]]


def chunks() -> Arrays:
    """Photos of more than two chunks of pixels, the last of them not whole."""
    images = np.random.default_rng(5).integers(0, 256, (1, 251, 307, 3), dtype=np.uint8)
    valid = (np.arange(307) % 7 > 0).astype(np.uint8) * 255
    valid = np.broadcast_to(valid, (251, 307)).copy()
    stats, histogram = measure_hue(images, 1.0, valid=valid)
    cut = apply_hue_cut(images, stats, valid=valid)
    rare, model = rarity_weights(images, valid=valid)
    floats, _ = rarity_weights(images, valid=valid, dtype="float32")
    levels = channel_quantiles(images, valid=valid)
    hsv = rgb_to_hsv(images)
    hue = [stats[0].mean_deg, stats[0].sigma_deg, histogram.sum()]  # bins' edges are common hues
    return [np.array(hue), cut, rare, model.counts, floats, levels, hsv[..., 1:], hsv[..., 0]]


def focus() -> Arrays:
    stack = np.random.default_rng(4).random((2, 36, 40, 3)).astype(np.float32)
    return [focus_measure(stack, np.ones(stack.shape[:3], np.float32), core_px=1, ring_px=4)]


def live(method: str) -> Arrays:
    images, _, poses = scene()
    view = view_from(poses)
    window = Window(Format(CAMERA), 3, (40, 36), MaskSettings(method=method))
    out = Out.empty((40, 36), 3, window.device)
    for image, pose in zip(images, poses, strict=True):
        window.step(image, pose, view, FocalPlane(), out)
    return [array.copy() for array in out.numpy()]


WORK: dict[str, Callable[[], Arrays]] = {
    "integrals of RGB bytes": lambda: integral("uint8", True, CAMERA),
    "integrals of RGB bytes, soft weights": lambda: integral("uint8", True, CAMERA, soft=True),
    "integrals of RGB words": lambda: integral("uint16", True, CAMERA),
    "integrals of RGB floats": lambda: integral("float32", True, CAMERA),
    "integrals of grey bytes": lambda: integral("uint8", False, CAMERA),
    "integrals through a lens": lambda: integral("uint8", True, LENS),
    "coherence": coherence,
    "hue": hue,
    "colours": colours,
    "weights": weights,
    "photos of several chunks": chunks,
    "focus": focus,
    "live, hue cut": lambda: live("hue"),
    "live, rarity": lambda: live("rarity"),
}


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Modules, by name, of the kernels that are launched meanwhile: all those for every device."""
    monkeypatch.setenv("HSVAOS_PORTABLE", "1")
    modules: dict[str, Any] = {}
    load = devices.load

    def remember(kernel: Any, device: Any) -> None:
        modules[str(kernel.module.name)] = kernel.module
        load(kernel, device)

    monkeypatch.setattr(devices, "load", remember)
    return modules


@pytest.mark.parametrize("name", WORK)
def test_what_cuda_runs_equals_the_vector_forms_and_compiles(
    name: str, launched: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    portable = WORK[name]()
    monkeypatch.delenv("HSVAOS_PORTABLE")
    modules = dict(launched)
    assert modules
    for ours, vectors in zip(portable, WORK[name](), strict=True):
        ours, vectors = np.asarray(ours, np.float64), np.asarray(vectors, np.float64)
        scale = max(np.abs(vectors).max(), 1e-6)
        close = np.isclose(ours, vectors, rtol=2e-3, atol=2e-3 * scale)
        # a pixel on the border of a photo or of a hue may fall either way
        assert close.mean() > 0.995
    targets = wp.get_cuda_supported_archs()
    if not targets:
        pytest.skip("this build of Warp cannot compile for CUDA")
    for module in modules.values():
        wp.compile_aot_module(module, arch=min(targets), module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == len(modules)
