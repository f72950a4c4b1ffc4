"""How the fragment network is made: labels, crops, fit and export (extra `train`)."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

import hsvaos  # noqa: E402
from hsvaos.camera import Camera  # noqa: E402
from hsvaos.detect.fragments import FRAGMENT_CHANNELS, FragmentNet  # noqa: E402
from hsvaos.fragment_input import FragmentInput  # noqa: E402
from hsvaos.masking import levelled  # noqa: E402
from hsvaos.photos import load_photos  # noqa: E402
from hsvaos.settings import Settings  # noqa: E402
from hsvaos.simulate.record import simulate_flight  # noqa: E402
from tests.simulate.conftest import small_settings  # noqa: E402
from train.flights import Labelled, labels_of  # noqa: E402
from train.fragment_crops import SIDE_PX, as_input, make_crops, read_crops  # noqa: E402
from train.fragment_fit import fit_fragments, loss_on  # noqa: E402
from train.fragment_net import Evidence, export_fragments  # noqa: E402
from train.rarity import training_rarity  # noqa: E402
from train.truth import flight_truth  # noqa: E402


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Six small photos of people in the open, with labels of people and ground."""
    folder = tmp_path_factory.mktemp("flights") / "flight_1"
    settings = small_settings(camera=Camera.from_fov(256, 256, 64.0), classes=("open", "open"))
    simulation = Labelled(settings)
    simulation.labels = labels_of(folder)
    simulation.labels.mkdir()
    simulate_flight(settings, folder, simulation=simulation)
    return folder


@pytest.fixture(scope="module")
def crops(flight, tmp_path_factory):
    path = tmp_path_factory.mktemp("crops") / "flight_1.npz"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("train.fragment_crops.CROPS", 90)
        make_crops(flight, path)
    return path


def test_labels_mark_the_pixels_that_the_truth_counts(flight):
    truth, _ = flight_truth(flight)
    shown = np.array(truth["pixels"]["by_photo"])[..., 0].sum(axis=1)
    labels = sorted(labels_of(flight).glob("*.png"))
    marked = [int((cv2.imread(str(path), cv2.IMREAD_UNCHANGED) == 255).sum()) for path in labels]
    assert sum(marked) > 100
    assert marked == shown.tolist()


def test_labels_mark_the_ground_and_not_the_crowns(flight):
    paths = sorted(labels_of(flight).glob("*.png"))
    labels = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in paths]
    assert set(np.unique(labels)) == {0, 128, 255}
    assert 0.05 < np.mean([label >= 128 for label in labels]) < 0.95


def test_crops_are_the_input_of_the_photos(flight, crops):
    found = read_crops(crops)
    assert found.inputs.shape == (len(found.shown), len(FRAGMENT_CHANNELS), SIDE_PX, SIDE_PX)
    people, ground = found.shown[:, 0], found.shown[:, 1]
    assert 0.2 < people.any(axis=(1, 2)).mean() < 1.0
    assert ground[people].all()
    assert 0.05 < ground.mean() < 0.95
    photos = load_photos(hsvaos.open_flight(flight), device="cpu")
    truth, rng = flight_truth(flight)
    gains = levelled(photos, Settings())
    model = training_rarity(photos, truth, rng, gains)
    whole = FragmentInput(photos.images, model, gains)(0)
    first = as_input(found.inputs[0])
    places = [
        (y, x)
        for y in range(0, 256 - SIDE_PX + 1, 2)
        for x in range(0, 256 - SIDE_PX + 1, 2)
        if np.abs(whole[:3, y, x] - first[:3, 0, 0]).max() < 0.02
    ]
    apart = [np.abs(whole[:, y : y + SIDE_PX, x : x + SIDE_PX] - first).max() for y, x in places]
    assert min(apart) < 0.02  # steps of bytes


def test_fitting_lowers_the_loss_goes_on_and_exports_what_was_fitted(crops, tmp_path):
    flights = [read_crops(crops)]
    fit_fragments([crops], [crops], tmp_path, steps=4)
    model = fit_fragments([crops], [crops], tmp_path, steps=60)
    with torch.no_grad():
        logits = model(torch.from_numpy(as_input(flights[0].inputs))).numpy()
    for own, shown in zip(
        np.moveaxis(logits, 1, 0), np.moveaxis(flights[0].shown, 1, 0), strict=True
    ):
        assert own[shown].mean() > own[~shown].mean() + 0.1
    rows = (tmp_path / "fragment_curve.csv").read_text().split()
    assert [row.split(",")[0] for row in rows] == ["step", "4", "60"]
    early, late = (float(row.split(",")[3]) for row in rows[1:])
    assert late < 0.97 * early
    assert loss_on(model, flights) == pytest.approx(late, abs=1e-4)
    path = tmp_path / "fragments.onnx"
    export_fragments(model, path, {"recipe": "test"})
    assert path.stat().st_size < 600_000
    planes = as_input(flights[0].inputs[3])
    with torch.no_grad():
        want = Evidence(model).eval()(torch.from_numpy(planes)[None])
    have = FragmentNet(path, provider="cpu").of_planes(planes)
    for ours, theirs in zip(have, want, strict=True):
        assert np.allclose(ours, theirs[0, 0].numpy(), rtol=1e-3, atol=1e-3)


def test_nothing_to_learn_from_is_said(tmp_path):
    with pytest.raises(ValueError, match="expected crops of some flights"):
        fit_fragments([], [], tmp_path, steps=1)


def test_crops_of_another_recipe_are_refused(tmp_path):
    path = tmp_path / "flight_9.npz"
    shown = np.packbits(np.zeros((2, 2, SIDE_PX, SIDE_PX), bool), axis=-1)
    np.savez(path, inputs=np.zeros((2, 4, SIDE_PX, SIDE_PX), np.uint8), shown=shown)
    with pytest.raises(ValueError, match="of this recipe"):
        read_crops(path)
