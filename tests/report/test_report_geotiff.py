from pathlib import Path

import numpy as np
import pytest

from hsvaos.camera import VirtualCamera
from hsvaos.flight import Origin
from hsvaos.report import geotiff
from hsvaos.report.figures import stretch

pytest.importorskip("pyproj")
rasterio = pytest.importorskip("rasterio")


def _geodetic(ned: np.ndarray, origin: Origin) -> np.ndarray:
    """Lon, lat of points on the ground by geodesics: independent of the code under test."""
    from pyproj import Geod

    north, east = ned[:, 0], ned[:, 1]
    start = np.ones(len(ned))
    lon, lat, _ = Geod(ellps="WGS84").fwd(
        origin.lon_deg * start,
        origin.lat_deg * start,
        np.degrees(np.arctan2(east, north)),
        np.hypot(north, east),
    )
    return np.column_stack([lon, lat])


@pytest.mark.parametrize(
    ("lat", "lon", "epsg"),
    [
        (47.5, 13.25, 32633),
        (46.8426, -91.9945, 32615),  # far from its central meridian
        (0.0, 0.01, 32631),
        (-33.9, 18.4, 32734),
        (69.6, 18.0001, 32634),
        (51.0, 11.9999, 32632),
        (10.0, 180.0, 32601),
        (86.0, 30.0, 32661),
        (-82.0, 30.0, 32761),
    ],
)
def test_pixels_lie_where_geodesics_say(lat: float, lon: float, epsg: int) -> None:
    from pyproj import Geod, Transformer

    origin = Origin(lat, lon, 0.0)
    view = VirtualCamera.ortho(300.0, -200.0, 0.5, 1000, 1000)  # 500 m x 500 m, off the origin
    reference = geotiff.ground_reference(view, origin)
    assert reference.epsg == epsg
    assert reference.residual_m < 0.005
    pixels = np.random.default_rng(0).uniform(-0.5, 999.5, (200, 2))
    expected = _geodetic(view.rays(pixels)[0], origin)
    a, b, c, d, e, f = reference.affine
    col, row = (pixels + 0.5).T  # GDAL counts from the corner of the first pixel
    back = Transformer.from_crs(f"EPSG:{epsg}", "EPSG:4326", always_xy=True)
    lon_deg, lat_deg = back.transform(a * col + b * row + c, d * col + e * row + f)
    _, _, error = Geod(ellps="WGS84").inv(lon_deg, lat_deg, *expected.T)
    assert np.max(error) < 0.01


def test_heights_count() -> None:
    view = VirtualCamera.ortho(0.0, 990.0, 1.0, 20, 20)
    origin = Origin(47.5, 13.25, 600.0)
    level, deep = (geotiff.ground_reference(view, origin, d).affine for d in (0.0, 300.0))
    # Verticals converge downwards: what lies deep below the tangent plane is farther out.
    assert deep[2] - level[2] == pytest.approx(300.0 * 1000.0 / 6.37e6, rel=0.05)


def test_what_cannot_be_described_is_refused(result_of) -> None:
    pinhole = result_of().main.view
    with pytest.raises(ValueError, match="needs a ground grid"):
        geotiff.ground_reference(pinhole, Origin(47.5, 13.25))
    huge = VirtualCamera.ortho(2e4, -2e4, 10.0, 4000, 4000)
    with pytest.raises(ValueError, match="40000 x 40000 m must be small enough"):
        geotiff.ground_reference(huge, Origin(47.5, 13.25))


def test_files_open_in_rasterio_as_they_were_written(tmp_path: Path, result_of) -> None:
    result = result_of(ortho=True)
    main = result.main
    reference = geotiff.ground_reference(main.view, result.flight.origin)
    picture = stretch(main.integral, main.footprint)
    look = geotiff.write_ortho(tmp_path / "ortho.tif", picture, reference)
    data = geotiff.write_ortho_data(
        tmp_path / "ortho_data.tif", main.integral, main.footprint, reference, main.rarity_map
    )
    with rasterio.open(look) as opened:
        assert opened.crs.to_epsg() == 32633
        assert opened.profile["tiled"]
        assert opened.profile["compress"] == "deflate"
        assert [c.name for c in opened.colorinterp] == ["red", "green", "blue", "alpha"]
        np.testing.assert_array_equal(np.moveaxis(opened.read(), 0, -1), picture)
        np.testing.assert_allclose(tuple(opened.transform)[:6], reference.affine, atol=1e-6)
        east, north = opened.xy(0, 0)  # the centre of the first pixel
        middle = np.array(reference.affine).reshape(2, 3) @ [0.5, 0.5, 1.0]
        np.testing.assert_allclose((east, north), middle, atol=1e-6)
    seen = main.footprint > 0
    with rasterio.open(data) as opened:
        assert opened.descriptions == ("red", "green", "blue", "footprint", "rarity_map")
        assert np.isnan(opened.nodata)
        bands = opened.read()
        assert np.isnan(bands[:, ~seen]).all()
        np.testing.assert_array_equal(bands[3][seen], main.footprint[seen])
        np.testing.assert_array_equal(bands[0][seen], main.integral[..., 0][seen])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ortho.tif", "ortho_data.tif"]
