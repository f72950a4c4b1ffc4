"""Photos brought over from the host in batches make the picture that photos held there make."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from bench.bench_integrate import Scene
from bench.bench_upload import BATCH, WAYS
from hsvaos import Integrator, hue_masks


@pytest.mark.parametrize("name", WAYS)
def test_uploads_in_batches_change_nothing(
    name: str, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HSVAOS_PORTABLE", "1")  # as on CUDA, where nothing is packed
    scene = Scene(2 * BATCH + 1, 64, 48)
    work = WAYS[name](scene, wp.get_device(device))
    work()
    image, footprint = (part.numpy() for part in work())
    masks, _ = hue_masks(scene.images)
    integrator = Integrator(scene.camera, scene.images, scene.poses, masks)
    expected, cover = integrator.integrate(scene.view, scene.surface)
    assert cover.max() > 1.0
    np.testing.assert_allclose(footprint, cover, atol=1e-3)
    sure = cover > 0.05
    np.testing.assert_allclose(image[sure], expected[sure], atol=0.1)
