"""Who looks for people: what each method is shown, and from which score it reports."""

import numpy as np
import pytest

from hsvaos.finding import make_finder, operating_scores
from hsvaos.settings import DetectSettings

pytest.importorskip("onnx", reason="needs pip install 'hsvaos[test]'")

from hsvaos.detect.network_input import CHANNELS, photo_layers
from tests.detect.nets import OWN, own_net

SIZE = (160, 192)
ALL_LAYERS = {
    *("rarity", "plain", "rarity_map", "coherence"),
    *("fragments", "fragment_coherence", "ground"),
}


def layers():
    rng = np.random.default_rng(0)
    rays = np.full(SIZE, 30.0, np.float32)

    def picture(channels=3):
        return rng.normal(80.0, 4.0, (*SIZE, channels)).astype(np.float32), rays

    found = {name: picture() for name in ("chosen", "plain", "rarity")}
    for name in ("rarity_map", "anomaly_map"):
        found[name] = (np.abs(rng.normal(0.02, 0.004, (*SIZE, 1))).astype(np.float32), rays)
    found["coherence"] = (picture()[0], np.abs(rng.normal(0.1, 0.02, SIZE)).astype(np.float32))
    return found


@pytest.fixture
def red_net(tmp_path):
    """Sees contrast in red, of the image and of the plain mean, and in rarity."""

    def make(channel):
        weights = [0.0] * len(CHANNELS)
        weights[CHANNELS.index(channel)] = 8.0
        path = tmp_path / f"{channel}.onnx"
        path.write_bytes(own_net(weights, -5.0))
        return str(path)

    return make


def settings(**values):
    return DetectSettings(**{"method": "network", **values})


@pytest.mark.parametrize(
    ("channel", "layer"),
    [("red", "rarity"), ("plain red", "plain"), ("rarity", "rarity_map")],
)
def test_the_network_sees_everything(red_net, channel, layer):
    finder = make_finder(settings(model=red_net(channel)), 30)
    assert set(finder.layers) == ALL_LAYERS
    assert finder.looks_at_photos
    shown = layers()
    assert len(finder(shown, 0.05)) == 0
    shown[layer][0][64:80, 96:112, 0] *= 3.0
    found = finder(shown, 0.05)
    assert len(found) == 1
    assert found.boxes_xyxy[0] == pytest.approx([95.5, 63.5, 111.5, 79.5], abs=1e-3)


def test_the_network_sees_coherence(red_net):
    finder = make_finder(settings(model=red_net("coherence")), 30)
    shown = layers()
    assert len(finder(shown, 0.05)) == 0
    shown["coherence"][1][64:80, 96:112] *= 6.0
    found = finder(shown, 0.05)
    assert len(found) == 1
    assert found.boxes_xyxy[0] == pytest.approx([95.5, 63.5, 111.5, 79.5], abs=1e-3)


@pytest.mark.parametrize(
    ("channel", "layer", "much"),
    [("fragment red", "fragment_coherence", 0.1), ("ground red-green", "ground", 6.0)],
)
def test_the_network_sees_the_colours_of_pieces_and_of_the_ground(red_net, channel, layer, much):
    finder = make_finder(settings(model=red_net(channel)), 30)
    shown = layers()
    rng = np.random.default_rng(1)
    evidence = np.abs(rng.normal(900.0, 90.0, (*SIZE, 1))).astype(np.float32)
    colours = rng.normal(90.0, 9.0, (*SIZE, 3)).astype(np.float32)
    shown["fragments"] = (evidence, shown["plain"][1])
    shown[layer] = (colours, np.full(SIZE, much, np.float32))
    assert len(finder(shown, 0.05)) == 0
    colours[64:80, 96:112, 0] *= 3.0
    found = finder(shown, 0.05)
    assert len(found) == 1
    assert found.boxes_xyxy[0] == pytest.approx([95.5, 63.5, 111.5, 79.5], abs=1e-3)


def test_the_network_sees_fragments_where_there_are_some(red_net):
    path = red_net("fragments")
    finder = make_finder(settings(model=path), 30)
    assert set(finder.layers) == ALL_LAYERS
    shown = layers()
    assert len(finder(shown, 0.05)) == 0  # a grey flight has none
    evidence = np.abs(np.random.default_rng(1).normal(900.0, 90.0, (*SIZE, 1))).astype(np.float32)
    evidence[64:80, 96:112] *= 8.0
    found = finder(shown | {"fragments": (evidence, shown["plain"][1])}, 0.05)
    assert len(found) == 1
    assert found.boxes_xyxy[0] == pytest.approx([95.5, 63.5, 111.5, 79.5], abs=1e-3)
    hurried = make_finder(settings(model=path, inputs="integrals"), 30)
    assert "fragments" not in hurried.layers


def test_nothing_is_made_that_the_network_does_not_see():
    assert photo_layers(CHANNELS) == ("fragments", "fragment_coherence", "ground")
    assert photo_layers(CHANNELS[:19]) == ("fragments", "fragment_coherence")
    assert photo_layers(("red", "ground rays")) == ("ground",)
    assert photo_layers(CHANNELS[:14]) == ()


def test_the_paper_shows_it_the_chosen_image_only(red_net):
    finder = make_finder(settings(model=red_net("red"), inputs="image"), 30)
    assert finder.layers == ("chosen",)
    shown = {"chosen": layers()["chosen"]}
    shown["chosen"][0][64:80, 96:112, 0] *= 3.0
    assert len(finder(shown, 0.05)) == 1


def test_finds_are_places_of_the_view_at_any_sampling(red_net):
    finder = make_finder(settings(model=red_net("red"), inputs="image"), 30)
    fine = layers()["chosen"][0].repeat(2, axis=0).repeat(2, axis=1)
    fine[128:160, 192:224, 0] *= 3.0
    found = finder({"chosen": (fine, np.full(fine.shape[:2], 30.0, np.float32))}, 0.025)
    assert len(found) == 1
    assert found.boxes_xyxy[0] == pytest.approx([191.5, 127.5, 223.5, 159.5], abs=3.0)


@pytest.mark.parametrize("method", ["rarity", "anomaly"])
def test_peaks_need_no_weights(method):
    finder = make_finder(DetectSettings(method=method), 30)
    assert finder.layers == (f"{method}_map",)
    assert finder.least_score == 3.0
    shown = layers()
    shown[f"{method}_map"][0][64:80, 96:112] += 0.5
    found = finder(shown, 0.05)
    middle = 0.5 * (found.boxes_xyxy[0, :2] + found.boxes_xyxy[0, 2:])
    assert middle == pytest.approx([103.5, 71.5], abs=2.0)


def test_scores_from_which_finds_are_reported(red_net):
    model = red_net("red")
    assert operating_scores(settings(model=model)) == pytest.approx((0.4, 0.4))
    assert operating_scores(settings(model=model, min_score=0.2)) == (0.2, 0.2)
    assert operating_scores(settings(model=model, person_score=0.3)) == (pytest.approx(0.4), 0.3)
    assert operating_scores(settings(min_score=0.6, person_score=0.2)) == (0.6, 0.2)
    assert operating_scores(DetectSettings(method="rarity", min_z=7.0)) == (7.0, 7.0)
    for values in ({}, {"person_score": 0.3}, {"min_score": 0.6}):
        asked = settings(model=model, **values)
        finder = make_finder(asked, 30)
        assert finder.scores == operating_scores(asked)
        assert finder.least_score == 0.5 * finder.scores.of_persons
    assert make_finder(settings(enabled=False), 30) is None


def test_persons_may_be_less_sure_than_boxes(tmp_path):
    path = tmp_path / "own.onnx"
    path.write_bytes(
        own_net([8.0], -5.0, metadata={**OWN, "person_score_threshold": "0.2"})  # sees red
    )
    asked = settings(model=str(path))
    assert operating_scores(asked) == pytest.approx((0.4, 0.2))
    shown = layers()
    faint = shown["rarity"][0][64:80, 96:112, 0]
    for strength in np.linspace(1.0, 2.0, 41):
        faint[:] = 80.0 * strength
        scores = make_finder(asked, 30)(shown, 0.05).scores
        if len(scores):
            break
    assert 0.2 <= scores[0] < 0.4
    assert len(make_finder(settings(model=str(path), min_score=0.4), 30)(shown, 0.05)) == 0


def test_a_network_that_is_none_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"none\.onnx"):
        make_finder(settings(model=str(tmp_path / "none.onnx")), 30)
