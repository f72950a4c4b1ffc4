from dataclasses import replace

import cv2
import numpy as np
import pytest

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.report import figures
from hsvaos.report.ground import covered_outline, ground_points, photo_in_view, surface_down
from hsvaos.surface import FocalPlane, FocalTerrain


def _hill() -> FocalTerrain:
    axis = np.arange(-40.0, 41.0, 2.0)
    north, east = np.meshgrid(axis, axis, indexing="ij")
    return FocalTerrain(-40.0, -40.0, 2.0, (-0.2 * north + 0.1 * east).astype(np.float32))


@pytest.mark.parametrize("ortho", [False, True])
@pytest.mark.parametrize("surface", ["level", "tilted", "terrain"])
def test_ground_points_lie_on_the_surface_and_project_back(result_of, ortho, surface) -> None:
    view = result_of(ortho=ortho).main.view
    normal = np.array([0.2, -0.1, 1.0])
    focal = {
        "level": FocalPlane(1.5),
        "tilted": FocalPlane(point=(0.0, 0.0, 0.0), normal=normal),
        "terrain": _hill(),
    }[surface]
    pixels = np.stack(np.meshgrid(np.arange(0, 60, 7), np.arange(0, 60, 7)), -1).astype(float)
    points = ground_points(view, pixels, focal)
    np.testing.assert_allclose(view.project(points), pixels, atol=1e-6)
    north, east, down = np.moveaxis(points, -1, 0)
    expected = 1.5 if surface == "level" else -0.2 * north + 0.1 * east
    np.testing.assert_allclose(down, np.broadcast_to(expected, down.shape), atol=1e-3)


def test_surface_down_ignores_holes() -> None:
    down = np.full((3, 3), 7.0, np.float32)
    down[0] = np.nan
    assert surface_down(FocalTerrain(0.0, 0.0, 1.0, down)) == 7.0
    assert surface_down(FocalPlane(-2.0)) == -2.0


def test_photo_laid_over_its_own_view_is_the_photo(result_of) -> None:
    result = result_of()
    photo = figures.photo_picture(result.photo)
    laid = photo_in_view(result, photo, 1000)
    assert np.abs(laid.astype(int) - photo).max() <= 1
    assert photo_in_view(replace(result, photo_frame="absent.png"), photo, 1000) is None


def test_photo_laid_over_a_smaller_picture_keeps_its_pixel_centres(result_of) -> None:
    ramp = np.broadcast_to(2 * np.arange(96), (64, 96)).astype(np.uint8)
    laid = photo_in_view(result_of(), np.dstack([ramp] * 3 + [np.full_like(ramp, 255)]), 48)
    assert laid.shape == (32, 48, 4)
    # Pixel c of the half-size picture is centred on 2 c + 0.5.
    np.testing.assert_allclose(laid[8, 2:-2, 0], 2 * (2 * np.arange(2, 46) + 0.5), atol=0.51)


def test_photo_laid_over_its_own_view_loses_its_distortion(result_of) -> None:
    result = result_of()
    bent = Camera(96, 64, 70.0, 70.0, 47.5, 31.5, (-0.2, 0.05, 0.0, 0.0, 0.0))
    straight = bent.without_distortion()
    # A photo that tells, in two channels, the undistorted pixel that each of its pixels shows.
    pixels = np.stack(np.meshgrid(np.arange(96.0), np.arange(64.0)), -1)
    where = straight.project(bent.back_project(pixels))
    photo = np.zeros((64, 96, 4), np.uint8)
    photo[..., :2], photo[..., 3] = np.clip(where.round(), 0, 255), 255
    pose = result.flight.frames[2].world_from_camera
    main = replace(result.main, view=VirtualCamera(straight, pose))
    result = replace(result, flight=result.flight.replace(camera=bent), main=main)
    laid = photo_in_view(result, photo, 1000)[4:-4, 4:-4]
    assert (laid[..., 3] == 255).all()
    assert np.abs(laid[..., :2] - pixels[4:-4, 4:-4]).max() <= 1.6


def test_photo_laid_on_the_ground_puts_a_spot_where_it_is(result_of) -> None:
    result = result_of(ortho=True)
    spot = np.array([4.0, -3.0, 0.0])
    u, v = result.flight.view(2).project(spot)
    photo = np.zeros((64, 96, 4), np.uint8)
    photo[..., 3] = 255
    cv2.circle(photo, (round(u), round(v)), 2, (255, 255, 255, 255), -1)
    laid = photo_in_view(result, photo, 1000)
    assert laid.shape == (60, 80, 4)
    rows, columns = np.nonzero(laid[..., 0] > 128)
    x, y = result.main.view.project(spot)
    assert np.hypot(columns.mean() - x, rows.mean() - y) < 1.5  # half a photo pixel on the ground


def test_outline_is_that_of_the_covered_ground(result_of) -> None:
    view = result_of(ortho=True).main.view
    footprint = np.zeros((60, 80), np.float32)
    footprint[10:40, 20:60] = np.random.default_rng(0).random((30, 40)) > 0.3  # with pinholes
    (outline,) = covered_outline(view, footprint, FocalPlane(0.0))
    north, east = outline.T
    np.testing.assert_allclose((north.max(), north.min()), (10 - 2.5, 10 - 9.75), atol=0.5)
    np.testing.assert_allclose((east.min(), east.max()), (-5.0, 4.75), atol=0.5)
    assert covered_outline(view, np.zeros((60, 80), np.float32), FocalPlane(0.0)) == []
