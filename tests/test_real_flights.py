"""Real flights against the field's reference renderer, and the targets seen through the trees."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hsvaos
from hsvaos.formats.images import read_mask
from hsvaos.formats.poses import NED_FROM_JKU
from hsvaos.settings import DetectSettings, FocusSettings, MaskSettings, Settings, ViewSettings

Find = Callable[[str], Path]

F0_FOV = 50.815436217896945
CONIFER_FOV = 32.51
BLUE_TARGET = (14, 606, 40, 626)
"""Left, top, right, bottom of the small blue target in the centre frame's view [px]."""


def reference(folder: Path, name: str, fov: float) -> tuple[np.ndarray, np.ndarray, object]:
    """Integral image, view count and virtual camera of a render by JKU's own program."""
    stored = np.load(folder / "reference" / f"{name}.npz")
    jku_from_camera = np.linalg.inv(stored["M_virtual"])
    pose = np.eye(4)
    pose[:3] = NED_FROM_JKU @ jku_from_camera[:3]
    image = stored["integral"]
    image = image[..., None] if image.ndim == 2 else image[..., ::-1]  # theirs is BGR
    height, width = image.shape[:2]
    camera = hsvaos.Camera.from_fov(width, height, fov)
    return image, stored["count"], hsvaos.VirtualCamera(camera, pose)


def psnr(ours: np.ndarray, theirs: np.ndarray, where: np.ndarray) -> float:
    return float(10 * np.log10(255.0**2 / ((ours - theirs)[where] ** 2).mean()))


@pytest.mark.parametrize("name", ["plane_z+10_512", "plane_z+16_512", "demlr_z0_512"])
def test_f0_equals_the_reference_renders(data: Find, device: str, name: str) -> None:
    folder = data("jku_f0_first30")
    flight = hsvaos.open_flight(folder, fov_deg=F0_FOV)
    theirs, count, view = reference(folder, name, F0_FOV)
    surface: object
    if name.startswith("plane"):
        surface = hsvaos.FocalPlane(float(name.split("+")[1].split("_")[0]))
    else:
        surface = hsvaos.FocalTerrain.from_file(folder / "dem_lr.obj")
    images = np.stack(list(flight.images()))
    integrator = hsvaos.Integrator(flight.camera, images, flight.poses, device=device)
    ours, footprint = integrator.integrate(view, surface)
    same = np.abs(footprint - count) < 1e-3
    assert same.mean() >= 0.99
    assert psnr(ours, theirs, same & (count > 0)) >= 60.0


@pytest.mark.parametrize("name", ["plane_z+51.4_512", "plane_z+36_512"])
def test_conifer_equals_the_reference_renders(data: Find, device: str, name: str) -> None:
    folder = data("jku_conifer")
    flight = hsvaos.open_flight(folder, fov_deg=CONIFER_FOV)
    theirs, count, view = reference(folder, name, CONIFER_FOV)
    images = np.stack(list(flight.images()))
    mask = read_mask(folder / "mask.png", 1024, 1024)
    integrator = hsvaos.Integrator(flight.camera, images, flight.poses, mask, device=device)
    plane = hsvaos.FocalPlane(float(name.split("+")[1].split("_")[0]))
    ours, footprint = integrator.integrate(view, plane)
    same = np.abs(footprint - count) < 1e-2
    assert same.mean() >= 0.99
    assert psnr(ours, theirs, same & (count > 0)) >= 50.0


def contrast(image: np.ndarray, footprint: np.ndarray) -> float:
    """Distance of the blue target's colour from its surround's, in deviations of the surround.

    |mean colour in the box - mean colour around| / sqrt(sum of the channels' variances around),
    over the pixels that have a sample; the surround reaches 60 px out, without a rim of 8 px.
    """
    left, top, right, bottom = BLUE_TARGET
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]

    def within(margin: int) -> np.ndarray:
        wide = (columns >= left - margin) & (columns <= right + margin)
        return wide & (rows >= top - margin) & (rows <= bottom + margin) & (footprint > 0)

    target, surround = image[within(0)], image[within(60) & ~within(8)]
    away = target.mean(axis=0) - surround.mean(axis=0)
    return float(np.linalg.norm(away) / np.sqrt(surround.var(axis=0).sum()))


@pytest.mark.parametrize("mask", ["hue", "rarity"])
def test_blue_target_under_conifers_stands_out(data: Find, mask: str) -> None:
    flight = hsvaos.open_flight(data("jku_conifer"), fov_deg=CONIFER_FOV)
    settings = Settings(focus=FocusSettings(down_m=51.4), mask=MaskSettings(method=mask))
    result = hsvaos.run(flight, settings)
    plain = contrast(*result.main.extra["plain"])
    masked = contrast(result.main.integral, result.main.footprint)
    assert masked >= 2.0 * plain
    at_the_target(result)
    assert result.persons[0].score > 0.7


def at_the_target(result: hsvaos.Result) -> None:
    """The strongest find is the blue target."""
    left, top, right, bottom = result.main.detections.boxes_xyxy[0]
    assert abs((left + right) / 2 - 27) < 8
    assert abs((top + bottom) / 2 - 616) < 6


def test_blue_target_is_the_strongest_peak_of_rarity_by_far(data: Find) -> None:
    flight = hsvaos.open_flight(data("jku_conifer"), fov_deg=CONIFER_FOV)
    settings = Settings(focus=FocusSettings(down_m=51.4), detect=DetectSettings(method="rarity"))
    result = hsvaos.run(flight, settings)
    at_the_target(result)
    assert result.persons[0].score > 1.3 * result.persons[1].score


def test_the_network_takes_no_warm_ground_for_a_person(data: Find) -> None:
    flight = hsvaos.open_flight(data("jku_f0_first30"), fov_deg=F0_FOV)
    result = hsvaos.run(flight, Settings(focus=FocusSettings(down_m=16.0)))
    assert len(result.persons) == 0


def test_autofocus_finds_the_ground_under_conifers(data: Find) -> None:
    """The targets lie at 51.4; tree crowns, which have more texture, at 30 to 36."""
    flight = hsvaos.open_flight(data("jku_conifer"), fov_deg=CONIFER_FOV)
    result = hsvaos.run(flight, Settings(focus=FocusSettings(autofocus=True)))
    assert result.surface.point[2] == pytest.approx(51.4, abs=1.5)


def test_thermal_flight_keeps_everything_and_says_so(data: Find) -> None:
    flight = hsvaos.open_flight(data("jku_f0_first30"), fov_deg=F0_FOV)
    result = hsvaos.run(flight, Settings(focus=FocusSettings(down_m=16.0)))
    assert any("grey" in note for note in result.notes)
    plain, count = result.main.integral, result.main.footprint
    assert plain.shape[2] == 1
    assert count.max() == pytest.approx(30.0, abs=0.01)


def test_ground_grid_of_brighton_lies_where_its_gps_says(data: Find, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.warp import transform

    from hsvaos.report.write import write_result

    flight = hsvaos.open_flight(data("brighton_beach"))
    settings = Settings(view=ViewSettings(frame="ortho", gsd_m=0.2))
    result = hsvaos.run(flight, settings)
    write_result(result, tmp_path, want_geotiff=True)
    with rasterio.open(tmp_path / "ortho.tif") as image:
        assert image.crs.to_epsg() == 32615
        assert image.count == 4
        # the first photo's camera is the origin, whose place its GPS tag gives
        easts, norths = transform(
            "EPSG:4326",
            image.crs,
            [-(91 + 59 / 60 + 40.4156 / 3600)],
            [46 + 50 / 60 + 33.3855 / 3600],
        )
        row, column = image.index(easts[0], norths[0])
    grid = result.main.view
    expected = grid.project([0.0, 0.0, 0.0])
    assert (column, row) == pytest.approx(tuple(expected), abs=1.01)
    features = json.loads((tmp_path / "detections.geojson").read_text())["features"]
    for feature in features:
        lon, lat = feature["geometry"]["coordinates"][:2]
        assert lat == pytest.approx(46.8428, abs=0.002)
        assert lon == pytest.approx(-91.9942, abs=0.002)
