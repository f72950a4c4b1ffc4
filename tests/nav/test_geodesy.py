"""Geodesy against pyproj (an independent implementation) and against its own inverse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.flight import Origin
from hsvaos.nav import geodesy

latitudes = st.floats(-89.9, 89.9)
longitudes = st.floats(-179.9, 179.9)
heights = st.floats(-400.0, 9000.0)


@given(latitudes, longitudes, heights)
def test_earth_centred_and_back(lat, lon, height):
    xyz = geodesy.ecef_from_geodetic([lat, lon, height])
    np.testing.assert_allclose(
        geodesy.ecef_from_geodetic(geodesy.geodetic_from_ecef(xyz)), xyz, atol=1e-7
    )
    np.testing.assert_allclose(geodesy.geodetic_from_ecef(xyz)[2], height, atol=1e-7)


@given(latitudes, longitudes, heights, st.tuples(*[st.floats(-5000.0, 5000.0)] * 3))
def test_local_and_back(lat, lon, height, ned):
    origin = Origin(lat, lon, height)
    there = geodesy.geodetic_from_ned(ned, origin)
    np.testing.assert_allclose(geodesy.ned_from_geodetic(there, origin), ned, atol=1e-6)


def test_axes_point_north_east_and_down():
    origin = Origin(47.0, 8.0, 500.0)
    ned = geodesy.ned_from_geodetic(
        [[47.001, 8.0, 500.0], [47.0, 8.001, 500.0], [47.0, 8.0, 490.0]], origin
    )
    assert ned[0, 0] == pytest.approx(111.17, abs=0.05)
    assert abs(ned[0, 1]) < 1e-6
    assert ned[1, 1] == pytest.approx(76.06, abs=0.05)
    np.testing.assert_allclose(ned[2], [0, 0, 10], atol=1e-6)


def test_agrees_with_pyproj():
    pyproj = pytest.importorskip("pyproj")
    rng = np.random.default_rng(0)
    llh = np.column_stack(
        [rng.uniform(-90, 90, 50), rng.uniform(-180, 180, 50), rng.uniform(0, 5e3, 50)]
    )
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978")
    expected = np.column_stack(to_ecef.transform(*llh.T))
    np.testing.assert_allclose(geodesy.ecef_from_geodetic(llh), expected, atol=1e-6)


def test_gravity_at_equator_and_pole():
    assert geodesy.gravity(0.0) == pytest.approx(9.7803253, abs=1e-6)
    assert geodesy.gravity(90.0) == pytest.approx(9.8321849, abs=1e-6)
    assert geodesy.gravity(45.0) - geodesy.gravity(45.0, 1000.0) == pytest.approx(
        3.086e-3, abs=1e-5
    )
