from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hsvaos.flight import Origin
from hsvaos.geodesy import (
    ecef_from_geodetic,
    geodetic_from_ned,
    ned_from_geodetic,
    ned_from_llh,
)

origins = st.builds(
    Origin, st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.floats(-400.0, 9000.0)
)
places = st.lists(
    st.tuples(*[st.floats(-5e4, 5e4)] * 2, st.floats(-2e3, 2e3)), min_size=1, max_size=5
)


@given(origins, places)
def test_round_trip_to_a_micrometre(origin, ned):
    lat, lon, height = geodetic_from_ned(ned, origin)
    np.testing.assert_allclose(ned_from_geodetic(lat, lon, height, origin), ned, atol=1e-6)
    rows = np.stack([lat, lon, height], axis=-1)
    np.testing.assert_allclose(ned_from_llh(rows, origin), ned, atol=1e-6)


def test_equals_pyproj():
    pyproj = pytest.importorskip("pyproj")
    rng = np.random.default_rng(3)
    lat, lon = rng.uniform(-89.9, 89.9, 50), rng.uniform(-180, 180, 50)
    height = rng.uniform(-100, 5000, 50)
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    expected = np.stack(to_ecef.transform(lon, lat, height), axis=1)
    np.testing.assert_allclose(ecef_from_geodetic(lat, lon, height), expected, atol=1e-6)

    origin = Origin(lat[0], lon[0], height[0])
    lat, lon = lat[0] + rng.uniform(-0.05, 0.05, 50), lon[0] + rng.uniform(-0.05, 0.05, 50)
    topocentric = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        f"+step +proj=topocentric +lat_0={origin.lat_deg} +lon_0={origin.lon_deg} "
        f"+h_0={origin.height_m}"
    )
    east, north, up = topocentric.transform(lon, lat, height)
    expected = np.stack([north, east, -np.asarray(up)], axis=1)
    np.testing.assert_allclose(ned_from_geodetic(lat, lon, height, origin), expected, atol=1e-6)


def test_axes_point_north_east_and_down():
    origin = Origin(46.0, -92.0, 100.0)
    lat, lon, height = geodetic_from_ned([[10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0, 0, 10.0]], origin)
    assert lat[0] > 46.0 + 8e-5
    assert lon[1] > -92.0 + 8e-5
    assert height[2] == pytest.approx(90.0)
