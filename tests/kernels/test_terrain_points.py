"""Where rays meet a height field: on it, on the pixel's ray, and where brute force finds it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hsvaos import Camera, FocalTerrain, VirtualCamera, reference
from hsvaos.kernels.rays import focal_points
from tests.kernels.strategies import random_pose

CAMERA = Camera.from_fov(24, 20, 80.0)
SPACINGS = st.floats(0.2, 3.0)
HEIGHTS = st.floats(0.01, 3.0)


def looking_down(rng: np.random.Generator, tilt: float, above_m: float = 20.0) -> VirtualCamera:
    """A camera so far up, somewhere, tilted by up to so much [rad]."""
    pose = random_pose(rng, tilt, reach=3.0)
    pose[2, 3] = -above_m
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


@given(st.integers(0, 10_000), SPACINGS, HEIGHTS, st.floats(10.0, 150.0))
@example(1, 0.20000000000000004, 2.0, 41.8984375)  # false position alone was 5 mm off after 20
def test_points_lie_on_the_height_field_and_on_their_rays(
    seed: int, spacing: float, height: float, above_m: float
) -> None:
    rng = np.random.default_rng(seed)
    terrain, view = rough(rng, spacing, height), looking_down(rng, 0.2, above_m)
    places, hit = points(view, terrain)
    assert hit.any()
    surface = reference.terrain_down(places[hit][:, 0], places[hit][:, 1], terrain)
    steepest = np.abs(np.diff(terrain.down_m, axis=0)).max() / spacing
    # 20 m away float32 tells no less than 2e-6 m apart; across too, where slopes make height of it
    close = 1e-5 * max(1.0, above_m / 20.0) * (1.0 + steepest)
    np.testing.assert_allclose(places[hit][:, 2], surface, atol=close)
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
    holed = FocalTerrain(-40.0, -40.0, spacing, down)
    left, seen = points(view, holed)
    lost = hit & ~seen
    assert 0 < lost.sum() < 0.5 * hit.sum()
    assert np.isfinite(reference.terrain_down(left[seen][:, 0], left[seen][:, 1], holed)).all()
    np.testing.assert_allclose(left[seen], places[seen], atol=1e-4)
