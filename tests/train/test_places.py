"""Where people lie in training flights whose places are drawn by what is seen (extra `train`)."""

import numpy as np
import pytest

import train.places
from train.flights import FIRST_TRAINING_SEED, FIRST_TUNING_SEED, by_visibility, flight_settings


@pytest.fixture(scope="module")
def drawn():
    """Settings of a flight, and how much of the ground photos see, by place."""
    kept = {}

    def smooth(chart, radius):
        kept["chart"], kept["seen"] = chart, original(chart, radius)
        return kept["seen"]

    original = train.places.smooth
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(train.places, "smooth", smooth)
        settings = flight_settings(101_449)
    cells = (np.array(settings.places) + kept["chart"].half_m) / kept["chart"].cell_m
    seen = kept["seen"][tuple(cells.astype(int).T)]
    return settings, seen


def test_early_flights_keep_their_places():
    assert not by_visibility(FIRST_TRAINING_SEED)
    assert not by_visibility(101_447)
    assert by_visibility(101_448)
    assert not by_visibility(FIRST_TUNING_SEED)


def test_bushes_stand_where_photos_see_the_ground(drawn):
    settings, seen = drawn
    bush = np.array([name == "bush" for name in settings.classes])
    assert 4 <= bush.sum() <= 18
    assert seen[bush].min() > 0.44


def test_others_lie_in_the_open_and_below_closed_crowns_too(drawn):
    settings, seen = drawn
    others = seen[np.array([name != "bush" for name in settings.classes])]
    assert (others < 0.14).any()
    assert ((others > 0.14) & (others < 0.71)).any()
    assert (others > 0.84).any()


def test_people_lie_apart_and_within_the_ground(drawn):
    settings, _ = drawn
    places = np.array(settings.places)
    assert len(places) == len(settings.clothes) == settings.people == 26
    between = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    assert between[np.triu_indices(len(places), 1)].min() > 2.7
    assert (np.abs(places) <= np.array(settings.mission.half_m) + 3.0).all()
