"""Pieces of people in single photos: the network's input, and what it says of them."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import warp as wp

from hsvaos import Camera, Flight, VirtualCamera, reference
from hsvaos.demo import demo_flight
from hsvaos.detect.fragments import FRAGMENT_CHANNELS, FragmentNet, PhotoEvidence, resampled
from hsvaos.detect.yolo import PACKAGED
from hsvaos.flight import Frame
from hsvaos.fragment_input import FragmentInput, surprises
from hsvaos.kernels.rarity import rarity_model
from hsvaos.masking import make_masks
from hsvaos.photos import Photos, load_photos, with_poses
from hsvaos.rarity_model import model_from_counts
from hsvaos.rendering import evidence_integrators, look_at_photos
from hsvaos.settings import Settings
from hsvaos.simulate.forest import ForestSettings
from hsvaos.simulate.instances import Kind
from hsvaos.simulate.simulation import Simulation
from hsvaos.surface import FocalPlane
from hsvaos.viewing import ground_grid
from tests.simulate.conftest import small_settings

SHAPE = (3, 40, 56)
LEAST_RATIO = {"summer": 3.0, "fall": 3.0, "snow": 2.0}


def forest(dtype, seed=0):
    """Greens of some spread, and a few pixels of every colour."""
    rng = np.random.default_rng(seed)
    unit = np.clip(rng.normal([0.2, 0.35, 0.12], 0.05, (*SHAPE, 3)), 0.02, 0.9)
    odd = rng.uniform(size=SHAPE) < 0.02
    unit[odd] = rng.uniform(0.05, 0.9, (int(odd.sum()), 3))
    if dtype is np.float32:
        return unit.astype(np.float32)
    return np.rint(unit * np.iinfo(dtype).max).astype(dtype)


def inputs_of(images, gains=None):
    held = wp.array(np.ascontiguousarray(images), dtype=wp.dtype_from_numpy(images.dtype))
    return FragmentInput(held, rarity_model(held, gains=gains), gains)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_input_is_what_numpy_makes_of_photos(dtype):
    images = forest(dtype)
    gains = np.random.default_rng(1).uniform(0.8, 1.2, (3, 3))
    inputs = inputs_of(images, gains)
    top = 1.0 if dtype is np.float32 else float(np.iinfo(dtype).max)
    levelled = images / top * gains[:, None, None, :]
    middles = [np.median(photo[::8, ::8].max(axis=2)) for photo in levelled]
    light = levelled * (0.25 / np.median(middles))
    place = reference.rarity_coordinates(levelled[1])
    clear = (np.abs(place - np.rint(place)) > 1e-2).all(axis=-1)
    bins = reference.rarity_bins(levelled[1])
    model = rarity_model(images, gains=gains)
    lightness = model.counts.sum(axis=(1, 2)) / model.counts.sum()
    share = model.probability.reshape(-1)[bins]
    both = share * lightness[bins // 1600]
    planes = inputs(1)
    assert planes.shape == (len(FRAGMENT_CHANNELS), *SHAPE[1:])
    assert planes.dtype == np.float32
    want = 4.0 * np.sqrt(np.clip(light[1], 0, 1)) - 2.0
    assert np.allclose(planes[:3], np.moveaxis(want, 2, 0), atol=2e-4)
    for plane, p in ((planes[3], share), (planes[4], both)):
        twin = np.clip(-np.log10(np.maximum(p, 1e-9)) - 2.0, 0.0, 5.0) - 1.5
        assert clear.mean() > 0.9  # a colour between two bins may fall into either
        assert np.allclose(plane[clear], twin[clear], atol=1e-3)


def test_no_exposure_is_better():
    images = forest(np.float32)
    dark, bright = inputs_of(0.5 * images)(0), inputs_of(images)(0)
    assert np.allclose(dark[:3], bright[:3], atol=1e-3)


def test_surprises_count_decades():
    counts = np.zeros((10, 40, 40), np.int64)
    counts[3, 20, 20], counts[3, 30, 30], counts[7, 5, 5] = 899_900, 100, 100_000
    chroma, colour = surprises(model_from_counts(counts, None, 1.5, 0.0))
    assert chroma[3, 20, 20] == 0.0
    assert chroma[3, 30, 30] == pytest.approx(np.log10(9000.0) - 2.0, abs=1e-3)
    assert chroma[7, 5, 5] == 0.0  # nothing else is so bright
    assert colour[3, 30, 30] == pytest.approx(2.0, abs=1e-3)
    assert chroma[0, 0, 0] == colour[0, 0, 0] == 5.0


def test_grey_photos_hold_no_fragments():
    grey = wp.array(forest(np.uint8)[..., 0].copy(), dtype=wp.uint8)
    with pytest.raises(ValueError, match="colour photos, got grey"):
        FragmentInput(grey, rarity_model(grey))


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (37, 61)])
def test_photos_of_any_size_are_looked_at(size):
    planes = np.random.default_rng(0).normal(size=(5, *size)).astype(np.float32)
    for said in FragmentNet(provider="cpu").of_planes(planes):
        assert said.shape == size
        assert ((said >= 0.0) & (said <= 1.0)).all()


def test_photos_far_from_the_trained_sampling_are_resampled():
    planes = np.zeros((5, 60, 80), np.float32)
    assert resampled(planes, None) is planes
    assert resampled(planes, 0.04) is planes
    assert resampled(planes, 0.02).shape == (5, 30, 40)
    assert resampled(planes, 0.08).shape == (5, 120, 160)
    done = []
    found = FragmentNet(provider="cpu").evidence(
        inputs_of(forest(np.uint8)), 0.02, lambda *counts: done.append(counts)
    )
    assert found.people.shape == found.ground.shape == (3, 20, 28)
    assert (found.people.dtype, found.ground.dtype) == (np.uint16, np.uint8)
    assert done == [(1, 3), (2, 3), (3, 3)]


def test_another_network_is_refused():
    with pytest.raises(ValueError, match="expected a network of fragments"):
        FragmentNet(PACKAGED)


@pytest.mark.parametrize("season", ["summer", "fall", "snow"])
def test_the_ground_is_told_from_what_stands_on_it(season):
    """A flight that training never saw: seed 5, where training begins with 101000."""
    forest = ForestSettings(season=season, seed=5, density=260.0, leaf_density=0.5)
    camera = Camera.from_fov(512, 512, 64.0)
    settings = small_settings(forest=forest, camera=camera, classes=("half", "open"), stakes=0)
    simulation = Simulation(settings)
    photos = [simulation.photo(k) for k in range(6)]
    inputs = inputs_of(np.stack([photo.image for photo in photos]))
    said = FragmentNet(provider="cpu").evidence(inputs, 0.05)
    kind = np.stack([photo.kind for photo in photos])
    stands = np.isin(kind, [Kind.TREE, Kind.BUSH])
    assert 0.1 < stands.mean() < 0.9
    ground = said.ground / 255.0
    assert ground[~stands].mean() > LEAST_RATIO[season] * ground[stands].mean()
    person = kind == Kind.PERSON
    assert person.sum() > 100
    assert said.people[person].mean() > 10.0 * said.people[~person].mean()


def test_evidence_adds_up_where_people_lie():
    flight = with_poses(demo_flight())
    photos = load_photos(flight, device="cpu")
    net = FragmentNet(provider="cpu")
    masks = make_masks(photos, Settings())
    made = evidence_integrators(photos, look_at_photos(photos, masks, net), masks.gains)
    surface = FocalPlane(photos.flight.ground_down_m or 0.0)
    view = ground_grid(photos.flight, surface, 0.05)
    image, rays = (np.asarray(part.numpy()) for part in made.fragments.integrate(view, surface))
    reach = np.asarray(made.ground.integrate(view, surface)[1].numpy())
    total = cv2.GaussianBlur(image[..., 0] * rays, (0, 0), 4.0)
    smooth = total / (cv2.GaussianBlur(reach, (0, 0), 4.0) + 1.0)  # by rays of the ground
    ground = smooth[rays >= 5.0]
    people = json.loads((flight.source / "truth.json").read_text())["people"]
    for person in people:
        x, y = view.project(np.array([[person[f"{way}_m"] for way in ("north", "east", "down")]]))[
            0
        ]
        near = smooth[int(y) - 12 : int(y) + 13, int(x) - 12 : int(x) + 13]
        # of the one the photos see 2 %
        most = {"half": 1e-4, "full": 0.01}[person["occlusion"]]
        assert (ground > near.max()).mean() < most


def test_photos_are_weighed_by_what_is_seen_in_them():
    """Two rays of three show one colour with evidence, one another; a fourth has no evidence."""
    count, size = 4, 16
    colours = np.array([[200, 40, 40], [200, 40, 40], [40, 40, 200], [90, 90, 90]], np.uint8)
    images = np.ascontiguousarray(np.broadcast_to(colours[:, None, None], (count, size, size, 3)))
    pose = np.eye(4)
    pose[2, 3] = -20.0
    camera = Camera.from_fov(size, size, 60.0)
    frames = tuple(Frame(f"{k}", Path(f"{k}.png"), pose) for k in range(count))
    held = wp.array(images, dtype=wp.uint8)
    photos = Photos(Flight("drawn", camera, frames), held, None, ())
    evidence = np.full((count, size, size), 6554, np.uint16)
    evidence[3] = 0
    soil = np.zeros((count, size, size), np.uint8)
    soil[2], soil[3] = 51, 153
    shown, pieces, lit = evidence_integrators(photos, PhotoEvidence(evidence, soil), None)
    view, ground = VirtualCamera.ortho(1.0, -1.0, 0.2, 8, 8), FocalPlane(0.0)
    mean, rays = shown.integrate(view, ground)
    assert mean.numpy() == pytest.approx(0.075 * 65535.0, rel=1e-2)
    assert rays.numpy() == pytest.approx(4.0)
    colour, much = pieces.coherence(view, ground)
    assert colour.numpy()[4, 4] == pytest.approx([200.0, 40.0, 40.0], abs=1.0)
    assert much.numpy() == pytest.approx(np.sqrt(0.1 * 0.2 / 4.0), rel=1e-2)
    of_ground, reach = lit.integrate(view, ground)
    assert of_ground.numpy()[4, 4] == pytest.approx([77.5, 77.5, 117.5], abs=0.5)
    assert reach.numpy() == pytest.approx(0.8, rel=1e-2)
    # what the user masks is no ray; evidence of resampled photos is brought to their size
    part = Photos(photos.flight, held, np.zeros((size, size), np.uint8), ())
    part.valid[:, : size // 2] = 255
    small = (one[:, ::2, ::2].copy() for one in (evidence, soil))
    halves = evidence_integrators(part, PhotoEvidence(*small), None)
    for integrator in halves:
        south, north = (
            integrator.coherence(VirtualCamera.ortho(top, -1.0, 0.2, 8, 8), ground)[1].numpy()
            for top in (-2.0, 4.0)
        )
        assert (north == 0.0).all()
        assert (south > 0.0).all()
