"""The relief of the ground is found where rays agree, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hsvaos import FocalPlane, FocalTerrain
from hsvaos.relief.find import find_relief
from tests.relief.ground import down_at, flown, waves


def errors(found: FocalTerrain, truth: FocalTerrain, half_m: float = 10.0) -> np.ndarray:
    """Errors [m] at places that many photos see."""
    axis = np.arange(-half_m, half_m + 0.1, 0.5)
    north, east = np.meshgrid(axis, axis, indexing="ij")
    return down_at(found, north, east) - down_at(truth, north, east)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.mark.parametrize(
    ("hidden", "least"), [(0.0, 5.0), (0.4, 4.0), (0.7, 1.8)], ids=["open", "leaves", "closed"]
)
def test_waves_are_found(hidden: float, least: float) -> None:
    """Errors are so many times smaller than those of the plane, at 17 cm a pixel."""
    truth = waves()
    photos, ground = flown(truth, hidden=hidden)
    found, note = find_relief(photos, ground, None, FocalPlane(0.0))
    assert found is not None, note
    of_plane = rms(down_at(truth, *np.mgrid[-10:11, -10:11]))
    assert of_plane > least * rms(errors(found, truth))
    assert "relief of the ground" in note


def test_the_plane_may_be_tilted_and_off() -> None:
    truth = waves(slope=0.1)
    photos, ground = flown(truth, hidden=0.3)
    plane = FocalPlane(point=(0.0, 0.0, 0.4), normal=(-0.1, 0.0, 1.0))
    found, note = find_relief(photos, ground, None, plane)
    assert found is not None, note
    assert rms(errors(found, truth)) < 0.05


def test_levelled_photos_and_masks_of_the_user() -> None:
    truth = waves()
    photos, ground = flown(truth, hidden=0.5)
    images = photos.images.numpy()
    images[::2] = (images[::2] * 0.6).astype(np.uint8)
    gains = np.where(np.arange(len(images)) % 2 == 0, 1.0 / 0.6, 1.0)[:, None] * np.ones(3)
    # what the user masks is no ground, whatever a network says
    masked = replace(photos, valid=ground)
    found, note = find_relief(masked, np.full_like(ground, 255), gains, FocalPlane(0.0))
    assert found is not None, note
    assert rms(errors(found, truth)) < 0.04


def test_noise_keeps_the_plane() -> None:
    photos, ground = flown(waves(), texture=False)
    found, note = find_relief(photos, ground, None, FocalPlane(0.0))
    assert found is None
    assert "not known" in note


def test_a_photo_alone_keeps_the_plane() -> None:
    photos, ground = flown(waves())
    one = replace(photos, flight=photos.flight.subset([3]), images=photos.images[3:4])
    found, _ = find_relief(one, ground[3:4], None, FocalPlane(0.0))
    assert found is None


def test_a_look_to_the_horizon_keeps_the_plane() -> None:
    photos, ground = flown(waves(), pitch_deg=50.0)
    found, note = find_relief(photos, ground, None, FocalPlane(0.0))
    assert found is None
    assert "horizon" in note


def test_it_goes_on_beyond_what_photos_see() -> None:
    truth = waves()
    photos, ground = flown(truth)
    found, _ = find_relief(photos, ground, None, FocalPlane(0.0))
    assert found is not None
    reach = 7.0 + 20.0 * np.tan(np.radians(40.0))
    assert found.north0_m < -reach
    assert found.north0_m + found.spacing_m * (found.down_m.shape[0] - 1) > reach
    assert np.isfinite(found.down_m).all()
