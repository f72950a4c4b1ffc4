import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections, Person
from hsvaos.flight import FlightError
from hsvaos.report import geotiff
from hsvaos.report.finds import detections_geojson, detections_json
from hsvaos.report.write import FILE_NAMES, write_result
from hsvaos.surface import FocalTerrain

NO_GEO = {"ortho.tif", "ortho_data.tif"}
TERRAIN = {"terrain.png", "terrain.npz"}


def test_folder_holds_what_the_design_says(tmp_path: Path, result_of) -> None:
    result = result_of()
    written = write_result(result, tmp_path / "out")
    assert set(written) == set(FILE_NAMES) - NO_GEO - TERRAIN  # it is on a plane
    assert {p.name for p in (tmp_path / "out").iterdir()} == set(written)
    main = result.main
    png = cv2.imread(str(written["integral.png"]), cv2.IMREAD_UNCHANGED)
    assert png.shape == (64, 96, 4)
    np.testing.assert_array_equal(png[..., 3] == 0, main.footprint == 0)
    assert set(np.unique(png[..., 3])) == {0, 255}
    with np.load(written["integral.npz"]) as arrays:
        np.testing.assert_array_equal(arrays["image"], main.integral)
        np.testing.assert_array_equal(arrays["footprint"], main.footprint)
        np.testing.assert_array_equal(arrays["rarity_map"], main.rarity_map)
        np.testing.assert_array_equal(arrays["fragment_map"], main.fragment_map)
        np.testing.assert_array_equal(arrays["ground"], main.extra["ground"][0])
        np.testing.assert_array_equal(arrays["ground_rays"], main.extra["ground"][1])
        assert arrays["image"].dtype == arrays["footprint"].dtype == np.float32
        np.testing.assert_array_equal(arrays["world_from_camera"], main.view.world_from_camera)
        assert arrays["camera"][2] == main.view.camera.fx
    assert written["settings.toml"].read_text() == result.settings.to_toml()


def test_npz_of_a_ground_grid_says_where_it_lies(tmp_path: Path, result_of) -> None:
    result = result_of(ortho=True)
    written = write_result(result, tmp_path, want_geotiff=False)
    assert not NO_GEO & set(written)
    with np.load(written["integral.npz"]) as arrays:
        north0, east0, gsd = arrays["ortho"]
        height, width = arrays["footprint"].shape
        view = VirtualCamera.ortho(north0, east0, gsd, width, height)
        np.testing.assert_array_equal(arrays["origin"], (47.5, 13.25, 600.0))
    np.testing.assert_array_equal(view.world_from_camera, result.main.view.world_from_camera)


def test_second_run_leaves_nothing_of_the_first(tmp_path: Path, result_of) -> None:
    pytest.importorskip("rasterio")
    pytest.importorskip("pyproj")
    (tmp_path / "mine.txt").write_text("kept")
    hills = FocalTerrain(-50.0, -50.0, 4.0, np.random.default_rng(1).normal(size=(26, 26)))
    first = replace(result_of(ortho=True), surface=hills)
    assert set(write_result(first, tmp_path)) == set(FILE_NAMES)
    written = write_result(result_of(rarity=False), tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {*written, "mine.txt"}
    assert not {"rarity_map.png", "fragment_map.png", "ground.png", *NO_GEO, *TERRAIN} & set(
        written
    )


def test_crash_leaves_the_earlier_files_whole(tmp_path: Path, result_of) -> None:
    class Broken:
        def to_toml(self) -> str:
            raise RuntimeError("crash")

    first = write_result(result_of(), tmp_path)
    before = first["report.html"].read_bytes()
    with pytest.raises(RuntimeError, match="crash"):
        write_result(replace(result_of(), settings=Broken()), tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == set(first)
    assert first["report.html"].read_bytes() == before


def test_wrong_folder_is_named_before_anything_is_written(tmp_path: Path, result_of) -> None:
    (tmp_path / "out").write_text("x")
    with pytest.raises(FlightError, match="out: expected a folder"):
        write_result(result_of(), tmp_path / "out")
    (tmp_path / "dir" / "report.html").mkdir(parents=True)
    with pytest.raises(FlightError, match=r"report\.html: expected a file"):
        write_result(result_of(), tmp_path / "dir")
    assert [p.name for p in (tmp_path / "dir").iterdir()] == ["report.html"]


def test_missing_geotiff_is_explained_or_an_error(tmp_path: Path, result_of, monkeypatch) -> None:
    nowhere = result_of(ortho=True, origin=None)
    page = write_result(nowhere, tmp_path)["report.html"].read_text()
    assert "No GeoTIFF was written: the flight has no WGS-84 origin." in page
    with pytest.raises(FlightError, match=r"ortho\.tif: cannot be made: .* no WGS-84 origin"):
        write_result(nowhere, tmp_path, want_geotiff=True)
    with pytest.raises(FlightError, match="no ground grid"):
        write_result(result_of(), tmp_path, want_geotiff=True)
    monkeypatch.setattr(geotiff, "has_geo", lambda: False)
    page = write_result(result_of(ortho=True), tmp_path)["report.html"].read_text()
    assert "pip install &#x27;hsvaos[geo]&#x27;" in page


def test_json_has_the_agreed_keys_and_no_nan(result_of) -> None:
    odd = Person(1.0, 2.0, 3.0, None, None, float("nan"), 0.5, 1)
    result = replace(result_of(), persons=(odd,), views=(("a", Detections.none()),))
    content = json.loads(detections_json(result))
    assert content == {
        "views": [{"frame": "a", "boxes": []}],
        "persons": [
            {
                "north_m": 1.0,
                "east_m": 2.0,
                "down_m": 3.0,
                "lat_deg": None,
                "lon_deg": None,
                "std_m": None,
                "covariance_m2": None,
                "score": 0.5,
                "views": 1,
            }
        ],
    }
    view = json.loads(detections_json(result_of()))["views"][0]
    assert view == {"frame": "p2.png", "boxes": [{"xyxy": [29.5, 19.5, 33.5, 25.5], "score": 8.25}]}


def test_geojson_is_lon_lat_and_legal_without_an_origin(result_of) -> None:
    placed = json.loads(detections_geojson(result_of()))
    assert placed["type"] == "FeatureCollection"
    (feature,) = placed["features"]
    assert feature["geometry"] == {"type": "Point", "coordinates": [13.24999, 47.50001]}
    assert feature["properties"]["std_m"] == 0.4
    local = json.loads(detections_geojson(result_of(origin=None)))
    assert "no WGS-84 origin" in local["note"]
    assert local["features"][0]["geometry"] is None
    assert local["features"][0]["properties"]["north_m"] == 1.5
    assert json.loads(detections_geojson(result_of(persons=False)))["features"] == []
