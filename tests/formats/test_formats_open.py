from __future__ import annotations

import numpy as np
import pytest

import hsvaos


def test_jku_conifer(data):
    flight = hsvaos.open_flight(data("jku_conifer"), fov_deg=32.51)
    assert (flight.format, len(flight)) == ("jku", 10)
    assert flight.mask.name == "mask.png"
    assert any("mask.png" in note for note in flight.notes)
    # The cameras stand in a row of 11 units and look down.
    assert np.ptp(flight.poses[:, 1, 3]) == pytest.approx(11.0, abs=0.1)
    assert (flight.poses[:, 2, 2] > 0.97).all()
    assert next(flight.images()).shape == (1024, 1024, 3)


def test_brighton_beach_opens(data):
    flight = hsvaos.open_flight(data("brighton_beach"))
    assert (flight.format, len(flight)) == ("dji", 6)
    assert flight.ground_down_m == 0.0
    np.testing.assert_allclose(flight.poses[:, 2, 3], -40.0, atol=0.25)
