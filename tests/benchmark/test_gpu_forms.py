"""The forms of the gather that wait for a GPU do what the package's kernel does, and compile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import warp as wp

from bench.bench_integrate import Scene
from bench.gpu_forms import FORMS, shared_kernel, textures_kernel, words_kernel
from hsvaos import Integrator


@pytest.mark.parametrize("name", FORMS)
def test_a_form_equals_the_kernel(name: str) -> None:
    scene = Scene(5, 64, 48)
    image, footprint = FORMS[name](scene, wp.get_device("cpu"))()
    integrator = Integrator(scene.camera, scene.images, scene.poses, scene.weights)
    expected, cover = integrator.integrate(scene.view, scene.surface)
    assert cover.max() > 1.0
    np.testing.assert_allclose(footprint.numpy(), cover, atol=2e-3)
    sure = cover > 0.05
    np.testing.assert_allclose(image.numpy()[sure], expected[sure], atol=0.5)


@pytest.mark.parametrize("graph", [False, True], ids=["launched", "captured"])
def test_what_is_raced_on_a_gpu_is_the_integral(
    graph: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HSVAOS_PORTABLE", "1")  # which a graph can hold
    scene = Scene(5, 64, 48)
    work = scene.resident(wp.get_device("cpu"), graph=graph)
    work()
    image, footprint = (part.numpy() for part in work())
    expected, cover = scene.ours()()
    np.testing.assert_array_equal(footprint, cover)
    np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize(
    "kernel",
    [words_kernel, shared_kernel(117), textures_kernel],
    ids=["words", "shared", "textures"],
)
def test_a_form_compiles_for_cuda(kernel: wp.Kernel, tmp_path: Path) -> None:
    targets = wp.get_cuda_supported_archs()
    if not targets:
        pytest.skip("this build of Warp cannot compile for CUDA")
    wp.compile_aot_module(kernel.module, arch=min(targets), module_dir=tmp_path, use_ptx=True)
    assert list(tmp_path.glob("*.ptx"))
