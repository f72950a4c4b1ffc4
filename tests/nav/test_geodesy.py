"""Normal gravity against the published values."""

import pytest

from hsvaos.nav.geodesy import gravity


def test_gravity_at_equator_and_pole():
    assert gravity(0.0) == pytest.approx(9.7803253, abs=1e-6)
    assert gravity(90.0) == pytest.approx(9.8321849, abs=1e-6)
    assert gravity(45.0) - gravity(45.0, 1000.0) == pytest.approx(3.086e-3, abs=1e-5)
