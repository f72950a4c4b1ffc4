from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos.flight import FlightError, Origin
from hsvaos.formats.mesh import rasterise_mesh, read_obj
from hsvaos.formats.terrain import read_terrain
from hsvaos.geodesy import ned_from_geodetic
from hsvaos.surface import FocalTerrain


def node_places(terrain):
    rows, columns = terrain.down_m.shape
    north = terrain.north0_m + terrain.spacing_m * np.arange(rows)
    east = terrain.east0_m + terrain.spacing_m * np.arange(columns)
    return np.meshgrid(north, east, indexing="ij")


def pixel_places(transform, rows, columns):
    a, b, c, d, e, f = transform[:6]
    x, y = columns + 0.5, rows + 0.5
    return a * x + b * y + c, d * x + e * y + f


@settings(max_examples=40)
@given(st.tuples(*[st.floats(-3, 3)] * 3), st.floats(0.05, 0.7), st.integers(0, 1000))
def test_a_tilted_plane_comes_back_exactly(plane, spacing, seed):
    # A square of random triangles with shared edges: no cracks, exact heights.
    rng = np.random.default_rng(seed)
    inner = np.append(rng.uniform(-1.5, 1.5, 2), 0.0)
    vertices = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0], inner])
    vertices[:, 2] = plane[0] + vertices[:, :2] @ plane[1:]
    terrain = rasterise_mesh(vertices, [[i, (i + 1) % 4, 4] for i in range(4)], spacing)
    north, east = node_places(terrain)
    inside = (np.abs(north) <= 2 - 1e-6) & (np.abs(east) <= 2 - 1e-6)
    outside = (np.abs(north) > 2 + 1e-6) | (np.abs(east) > 2 + 1e-6)
    expected = plane[0] + north * plane[1] + east * plane[2]
    np.testing.assert_allclose(terrain.down_m[inside], expected[inside], atol=1e-5)
    assert np.isnan(terrain.down_m[outside]).all()


def test_the_highest_surface_counts():
    low = np.array([[0, 0, 5], [4, 0, 5], [0, 4, 5]], float)
    high = low * 0.5  # down 2.5 is above down 5
    terrain = rasterise_mesh(np.concatenate([low, high]), [[0, 1, 2], [5, 4, 3]], 0.5)
    north, east = node_places(terrain)
    np.testing.assert_array_equal(terrain.down_m[north + east <= 2], 2.5)
    np.testing.assert_array_equal(terrain.down_m[(north + east > 2) & (north + east <= 4)], 5.0)


def test_in_batches_it_is_the_same(monkeypatch):
    import hsvaos.formats.mesh as module

    rng = np.random.default_rng(5)
    vertices, faces = rng.uniform(-5, 5, (60, 3)), rng.integers(0, 60, (50, 3))
    whole = rasterise_mesh(vertices, faces, 0.2)
    monkeypatch.setattr(module, "_BATCH", 37)
    np.testing.assert_array_equal(rasterise_mesh(vertices, faces, 0.2).down_m, whole.down_m)


@pytest.mark.parametrize(
    ("vertices", "faces", "spacing", "message"),
    [
        (np.zeros((0, 3)), [[0, 1, 2]], 1.0, "vertices must have shape"),
        (np.eye(3), np.zeros((0, 3), int), 1.0, "faces must have shape"),
        (np.eye(3), [[0, 1, 3]], 1.0, "faces must name vertices 0 to 2"),
        (np.eye(3), [[0.0, 1.0, 2.0]], 1.0, "faces must be vertex numbers"),
        (np.eye(3) * np.nan, [[0, 1, 2]], 1.0, "finite"),
        (np.eye(3), [[0, 1, 2]], -1.0, "spacing_m must be"),
        (np.eye(3) * 1e6, [[0, 1, 2]], 1.0, "too large"),
        ([[0, 0, 0], [0, 0, 1], [1, 1, 1]], [[0, 1, 2]], 0.5, "no node lies on the mesh"),
    ],
)
def test_bad_meshes(vertices, faces, spacing, message):
    with pytest.raises(ValueError, match=message):
        FocalTerrain.from_mesh(vertices, faces, spacing)


def test_obj_axes_polygons_and_negative_numbers(tmp_path):
    path = tmp_path / "mesh.obj"
    path.write_text(
        "# a square 10 m east and 2 m south\no x\nv 10 2 3\nv 12 2 3\nv 12 4 4\nv 10 4 4\n"
        "vn 0 0 1\nf 1//1 2//1 3//1 4//1\nf -4 -3 -2\n"
    )
    vertices, faces = read_obj(path)
    np.testing.assert_array_equal(vertices[0], [-2, 10, 3])
    np.testing.assert_array_equal(faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]])
    terrain = FocalTerrain.from_file(path)
    assert terrain.north0_m == pytest.approx(-4.0, abs=terrain.spacing_m)
    assert (terrain.highest_m, terrain.lowest_m) == pytest.approx((3.0, 4.0), abs=0.3)
    path.write_text("v 1 2\nf 1 1 1\n")
    with pytest.raises(FlightError, match=r"mesh\.obj: line 1: malformed"):
        read_terrain(path)


def test_npz(tmp_path):
    path = tmp_path / "t.npz"
    down = np.arange(6, dtype=np.float32).reshape(2, 3)
    np.savez(path, north_m=[1.0, 0.0], east_m=[5.0, 6.0, 7.0], down_m=down)
    terrain = FocalTerrain.from_file(path)
    np.testing.assert_array_equal(terrain.down_m, down[::-1])
    np.savez(path, north_m=[1.0, 0.0], down_m=down)
    with pytest.raises(FlightError, match="missing east_m"):
        read_terrain(path)
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(FlightError, match=r"t\.npz: malformed"):
        read_terrain(path)
    (tmp_path / "t.txt").write_text("hello")
    with pytest.raises(FlightError, match="expected a terrain"):
        read_terrain(tmp_path / "t.txt")
    with pytest.raises(FlightError, match="no such terrain"):
        read_terrain(tmp_path / "gone.tif")


def test_terrain_of_f0_covers_its_mesh(data):
    vertices, faces = read_obj(data("jku_f0_first30") / "dem_lr.obj")
    terrain = rasterise_mesh(vertices, faces, 0.5)
    # The file's own vertices lie on the height field, but for what half a metre smooths away.
    row = np.rint((vertices[:, 0] - terrain.north0_m) / 0.5).astype(int)
    column = np.rint((vertices[:, 1] - terrain.east0_m) / 0.5).astype(int)
    error = np.abs(terrain.down_m[row, column] - vertices[:, 2])
    assert np.nanmedian(error) < 0.1
    assert np.isnan(terrain.down_m).mean() < 0.02


@pytest.fixture
def geotiff(tmp_path):
    """A plane 100 + 0.1 north - 0.2 east [m], 2 m pixels in UTM zone 15, with a hole."""
    rasterio = pytest.importorskip("rasterio")
    pyproj = pytest.importorskip("pyproj")
    origin = Origin(46.8426, -91.9946, 120.0)
    to_utm = pyproj.Transformer.from_crs(4326, 32615, always_xy=True)
    x0, y0 = to_utm.transform(origin.lon_deg, origin.lat_deg)
    transform = rasterio.Affine(2.0, 0.0, x0 - 100, 0.0, -2.0, y0 + 100)
    rows, columns = np.mgrid[0:100, 0:110]
    x, y = pixel_places(transform, rows, columns)
    lon, lat = to_utm.transform(x, y, direction="INVERSE")
    ned = ned_from_geodetic(lat, lon, 100.0, origin)
    heights = (100.0 + 0.1 * ned[..., 0] - 0.2 * ned[..., 1]).astype(np.float32)
    heights[40:50, 60:70] = -9999.0
    path = tmp_path / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=110, height=100, count=1, dtype="float32",
        crs="EPSG:32615", transform=transform, nodata=-9999.0,
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return path, origin


def test_geotiff_lies_where_it_says(geotiff):
    path, origin = geotiff
    terrain = FocalTerrain.from_file(path, origin)
    north, east = node_places(terrain)
    expected = 120.0 - (100.0 + 0.1 * north - 0.2 * east)
    known = ~np.isnan(terrain.down_m)
    # 1 mm: curvature and the sideways shift by height over 100 m.
    np.testing.assert_allclose(terrain.down_m[known], expected[known], atol=3e-3)
    assert terrain.spacing_m == pytest.approx(2.0, rel=0.05)
    hole = (north - 9.0) ** 2 + (east - 29.0) ** 2 < 7.0**2
    assert np.isnan(terrain.down_m[hole]).all()
    assert known[(np.abs(north) < 5) & (np.abs(east) < 5)].all()
    assert 0.85 < known.mean() < 0.99
    same = FocalTerrain.from_file(path, (origin.lat_deg, origin.lon_deg, origin.height_m))
    np.testing.assert_array_equal(same.down_m, terrain.down_m)


def test_geotiff_without_what_it_needs(geotiff, monkeypatch, tmp_path):
    path, origin = geotiff
    with pytest.raises(FlightError, match="needs a flight with an origin"):
        read_terrain(path)
    (tmp_path / "cut.tif").write_bytes(path.read_bytes()[:200])
    with pytest.raises(FlightError, match=r"cut\.tif: cannot be read as GeoTIFF"):
        read_terrain(tmp_path / "cut.tif", origin)
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(FlightError, match=r"pip install 'hsvaos\[geo\]'"):
        read_terrain(path, origin)


def test_surface_model_of_odm(data):
    rasterio = pytest.importorskip("rasterio")
    pyproj = pytest.importorskip("pyproj")
    path = data("odm_small") / "odm" / "odm_dem" / "dsm.tif"
    origin = Origin(24.68, 120.9505, 50.0)
    terrain = read_terrain(path, origin)
    with rasterio.open(path) as file:
        heights, transform, crs = file.read(1), file.transform, file.crs
    # Pixels of the file, put into the local frame one by one, lie on the height field.
    rng = np.random.default_rng(7)
    inner = np.isfinite(heights)
    for shift in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        rolled = np.roll(heights, shift, (0, 1))
        with np.errstate(invalid="ignore"):
            inner &= np.abs(rolled - heights) < 0.05  # flat places: sampling does not matter
    rows, columns = np.nonzero(inner)
    chosen = rng.permutation(rows.size)[:300]
    rows, columns = rows[chosen], columns[chosen]
    x, y = pixel_places(transform, rows, columns)
    lon, lat = pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(x, y)
    ned = ned_from_geodetic(lat, lon, heights[rows, columns], origin)
    i = np.rint((ned[:, 0] - terrain.north0_m) / terrain.spacing_m).astype(int)
    j = np.rint((ned[:, 1] - terrain.east0_m) / terrain.spacing_m).astype(int)
    error = np.abs(terrain.down_m[i, j] - ned[:, 2])
    assert np.nanmax(error) < 0.15
    assert np.isnan(error).mean() < 0.05
