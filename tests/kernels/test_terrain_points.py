"""Where rays meet a height field: on it, on the pixel's ray, and where brute force finds it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos import Camera, FocalTerrain, VirtualCamera, reference
from hsvaos.kernels.rays import focal_points

CAMERA = Camera.from_fov(24, 20, 80.0)
SPACINGS = st.floats(0.2, 3.0)
HEIGHTS = st.floats(0.01, 3.0)


def looking_down(rng: np.random.Generator, tilt: float) -> VirtualCamera:
    """20 m up, somewhere, tilted up to so much [rad]."""
    pose = np.eye(4)
    angles = rng.uniform(-tilt, tilt, 3)
    for axis, angle in enumerate(angles):
        turn, (i, j) = np.eye(3), [k for k in range(3) if k != axis]
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        pose[:3, :3] = pose[:3, :3] @ turn
    pose[:3, 3] = *rng.uniform(-3.0, 3.0, 2), -20.0
    return VirtualCamera(CAMERA, pose)


def rough(rng: np.random.Generator, spacing: float, height: float) -> FocalTerrain:
    """Hills without any order, 80 m wide."""
    count = int(80.0 / spacing) + 1
    down = rng.normal(0.0, height, (count, count)).clip(-6.0, 6.0).astype(np.float32)
    return FocalTerrain(-40.0, -40.0, spacing, down)


def points(view: VirtualCamera, terrain: FocalTerrain) -> tuple[np.ndarray, np.ndarray]:
    """Points [m], shape (H, W, 3), and where there are any."""
    found = focal_points(view, terrain).numpy().reshape(view.height, view.width, 4)
    return found[..., :3].astype(np.float64) + view.world_from_camera[:3, 3], found[..., 3] > 0.0


@given(st.integers(0, 10_000), SPACINGS, HEIGHTS)
def test_points_lie_on_the_height_field_and_on_their_rays(
    seed: int, spacing: float, height: float
) -> None:
    rng = np.random.default_rng(seed)
    terrain, view = rough(rng, spacing, height), looking_down(rng, 0.4)
    places, hit = points(view, terrain)
    assert hit.mean() > 0.5
    surface = reference.terrain_down(places[hit][:, 0], places[hit][:, 1], terrain)
    steepest = np.abs(np.diff(terrain.down_m, axis=0)).max() / spacing
    # float32 tells metres apart to 2e-6, across as well, where the slope makes height of it
    np.testing.assert_allclose(places[hit][:, 2], surface, atol=1e-5 * (1.0 + steepest))
    v, u = np.nonzero(hit)
    np.testing.assert_allclose(view.project(places[hit]), np.column_stack([u, v]), atol=1e-3)


@given(st.integers(0, 10_000), st.floats(0.05, 1.0))
def test_gentle_hills_are_met_where_brute_force_meets_them(seed: int, height: float) -> None:
    rng = np.random.default_rng(seed)
    terrain, view = rough(rng, 8.0, height), looking_down(rng, 0.1)
    places, hit = points(view, terrain)
    want = reference.focal_points(view, terrain)
    both = hit & np.isfinite(want).all(axis=2)
    assert both.mean() > 0.9
    np.testing.assert_allclose(places[both], want[both], atol=2e-3)


@pytest.mark.parametrize("spacing", [0.5, 2.0])
def test_nothing_is_met_in_a_hole_and_the_rest_is_as_without_it(spacing: float) -> None:
    rng = np.random.default_rng(5)
    whole, view = rough(rng, spacing, 0.1), looking_down(rng, 0.2)
    places, hit = points(view, whole)
    down = whole.down_m.copy()
    row, column = (int((40.0 + view.world_from_camera[k, 3]) / spacing) for k in (0, 1))
    down[row : row + 2, column : column + 2] = np.nan
    left, seen = points(view, FocalTerrain(-40.0, -40.0, spacing, down))
    inside = np.isnan(reference.terrain_down(places[..., 0], places[..., 1], whole))
    assert not inside[hit].any()
    assert 0 < (hit & ~seen).sum() < 0.5 * hit.sum()
    np.testing.assert_allclose(left[seen], places[seen], atol=1e-4)
