"""Ground maps of training flights, of a drawn ground that undulates (extra `train`)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

import train.maps
from hsvaos.detect.fragments import PhotoEvidence
from hsvaos.formats.native_write import write_native
from hsvaos.formats.open import open_flight
from hsvaos.masking import make_masks
from hsvaos.photos import load_photos
from hsvaos.settings import Settings
from hsvaos.surface import FocalTerrain
from tests.relief.ground import flown, waves
from train.maps import (
    GROUND,
    GROUND_RAYS,
    Condition,
    _on_relief,
    conditions,
    make_maps,
)
from train.rarity import rarity_without, training_rarity


class Knows:
    """Stands for the network of the photos: it knows which pixels show the ground."""

    def __init__(self, ground):
        self.ground = ground

    def evidence(self, inputs, gsd_m=None, progress=None):
        return PhotoEvidence(np.zeros(self.ground.shape, np.uint16), self.ground)


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> tuple[Path, np.ndarray]:
    """A flight as the simulator leaves it: photos, poses and a person, whom every photo sees."""
    folder = tmp_path_factory.mktemp("maps") / "flight_5"
    photos, ground = flown(waves(), hidden=0.2)
    outline = [[1.0, 1.0, 0.0], [1.0, 2.0, 0.0], [1.5, 1.0, 0.0]]
    person = {"outline_ned_m": outline, "occlusion": "bush"}
    truth = {
        "settings": {"forest": {"seed": 5}},
        "people": [person],
        "pixels": {"by_photo": [[[30, 40]]] * len(ground)},
    }
    frames = tuple(replace(frame, name=f"{frame.name}.png") for frame in photos.flight.frames)
    named = photos.flight.replace(frames=frames)
    write_native(named, folder, images=photos.images.numpy(), truth=truth)
    return folder, ground


def _maps(flight, target, monkeypatch, *wanted: Condition) -> list[dict[str, np.ndarray]]:
    folder, ground = flight
    target.mkdir(exist_ok=True)
    monkeypatch.setattr(train.maps, "conditions", lambda rng: list(wanted))
    make_maps(folder, target, fragments=Knows(ground))
    return [dict(np.load(target / f"flight_5_{n}.npz")) for n in range(len(wanted))]


def test_maps_are_on_the_relief_whatever_the_focus(flight, tmp_path, monkeypatch):
    """With the focus .3 m off the ground looks as without, where the relief is looked for."""
    asked = [Condition(focus_m=f, relief=r) for f, r in ((0.0, True), (0.3, True), (0.3, False))]
    relief, off, plane = _maps(flight, tmp_path, monkeypatch, *asked)
    seen = relief["layers"][GROUND_RAYS] > 14.0
    shown = [one["layers"][GROUND][0][seen] for one in (relief, off, plane)]
    alike = np.corrcoef(shown)[0]
    assert alike[1] > 0.95
    assert alike[2] < 0.8
    assert relief["rays"] == pytest.approx(0.75 * len(flight[1]))
    assert relief["classes"].tolist() == ["bush"]


def test_photos_left_out_tell_nothing_of_the_relief():
    photos, ground = flown(waves())
    chosen = np.arange(0, len(ground), 2)
    masks = make_masks(photos, Settings())
    said = PhotoEvidence(np.zeros(ground.shape, np.uint16), ground)
    found = _on_relief(photos, said, masks, 0.1, chosen)
    photos.images.numpy()[1::2] = 7  # the others
    again = _on_relief(photos, said, masks, 0.1, chosen)
    assert isinstance(found, FocalTerrain)
    assert np.array_equal(found.down_m, again.down_m)
    assert found.highest_m < -0.15


def test_some_maps_are_on_a_plane():
    rng = np.random.default_rng(4)
    drawn = [one.relief for _ in range(100) for one in conditions(rng)]
    assert 0.1 < 1.0 - np.mean(drawn) < 0.3


def test_people_of_later_flights_are_as_common_as_in_a_search(flight):
    folder, _ = flight
    photos = load_photos(open_flight(folder), 1.0, "cpu", None)
    outline = np.array([[-4.0, -4.0, 0.0], [-4.0, 4.0, 0.0], [4.0, 4.0, 0.0], [4.0, -4.0, 0.0]])
    whole, without = (rarity_without(photos, some, None).counts for some in ([], [outline]))
    truth = {"people": [{"outline_ned_m": outline}], "settings": {"forest": {"seed": 101_448}}}
    found = training_rarity(photos, truth, np.random.default_rng(0), None).counts
    own = whole - without
    assert own.sum() > 1000
    share = (found - without).sum() / own.sum()
    length = len(photos.flight.poses) / 117.0  # a search has as many people in more photos
    assert 0.35 * length < share < 0.8 * length
    # counts are whole numbers, and the share found is a little off by that
    np.testing.assert_allclose(found, without + share * own, atol=0.5 + 0.02 * own.max())
