"""The person network trained further on looks: its crops, and who is drawn (extra `train`)."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

from hsvaos.detect.network import Network  # noqa: E402
from hsvaos.detect.network_input import CHANNELS  # noqa: E402
from hsvaos.detect.yolo import Detector  # noqa: E402
from tests.train.test_recipe import drawn_map  # noqa: E402
from tests.train.test_second import a_look, first_network  # noqa: E402
from train import further  # noqa: E402
from train.classes import CLASS_SHARES, ByClass  # noqa: E402
from train.export import export  # noqa: E402
from train.judge import finds, from_looks, from_maps  # noqa: E402
from train.look_crops import LookCrops, crop_at  # noqa: E402
from train.looks import make_look, read_look  # noqa: E402
from train.net import Exported, PersonNet  # noqa: E402
from train.samples import CROP_PX  # noqa: E402


def _made(folder, kind="looks", *, as_found=False):
    """Return a drawn map, and the look that was made of it."""
    maps, looks = folder / f"{kind}_maps", folder / kind
    maps.mkdir()
    looks.mkdir()
    path = drawn_map(maps / "flight_7_0.npz", people=5)
    make_look(path, looks, first_network(folder / "first.onnx"), as_found=as_found)
    return path, looks / path.name


def test_people_are_drawn_by_class_and_nobody_from_nobody():
    rng = np.random.default_rng(1)
    people = [(0, k, "half") for k in range(90)] + [(1, 0, "bush"), (1, 1, "full")]
    drawn = ByClass(people).drawn(4000, rng)
    rest = 1.0 - CLASS_SHARES["open"]
    for one, name in (((1, 0), "bush"), ((1, 1), "full")):
        assert drawn.count(one) / 4000 == pytest.approx(CLASS_SHARES[name] / rest, abs=0.03)
    assert ByClass([]).drawn(5, rng) == []


@pytest.mark.parametrize("seed", range(6))
def test_a_crop_keeps_boxes_over_what_they_show(seed):
    """Every channel of one person is 1, of the other, whom few rays reach, 2; 0 elsewhere."""
    rng = np.random.default_rng(seed)
    look = a_look([[40, 30, 62, 44], [5, 70, 15, 92]], [], reach=[9.0, 0.4])
    look.layers[30:45, 40:63] = 1.0
    look.layers[70:93, 5:16] = 2.0
    for _ in range(20):
        crop = crop_at(look, np.array([51.0, 37.0]), rng)
        assert crop.whole.shape == (len(CHANNELS), CROP_PX, CROP_PX)
        (person,) = crop.boxes
        (faint,) = crop.ignored
        shown = crop.whole[0]
        for box, least in ((person, 0.6), (faint, 1.2)):
            x0, y0, x1, y1 = np.rint(box).astype(int)
            assert shown[y0 + 2 : y1 - 1, x0 + 2 : x1 - 1].min() > least / 2
        shown = shown.copy()
        for x0, y0, x1, y1 in np.rint([person, faint]).astype(int):
            shown[max(0, y0 - 2) : y1 + 3, max(0, x0 - 2) : x1 + 3] = 0.0
        assert np.abs(shown).max() < 0.01  # nothing of them anywhere else
        photos, ground = CHANNELS.index("fragments"), CHANNELS.index("ground light")
        known = [bool(crop.whole[k].any()) for k in range(len(CHANNELS))]
        assert all(known[:photos])
        if not known[photos]:
            assert not any(known[photos:])  # in a hurry nobody looks at single photos
        elif not known[ground]:
            assert all(known[photos:ground])
            assert not any(known[ground:])
        else:
            assert all(known)


def test_crops_beyond_a_small_map_are_empty():
    look = a_look([], [])
    look.layers[:] = 1.0
    crop = crop_at(look, np.array([99.0, 99.0]), np.random.default_rng(0))
    assert len(crop.boxes) == len(crop.ignored) == 0
    assert 0.1 < (crop.whole[0] > 0.2).mean() < 0.2  # 100 of 256 pixels each way


def test_looks_show_what_their_maps_do(tmp_path):
    """One network judged by a map and by the look that was made of it."""
    torch.manual_seed(1)
    path, look = _made(tmp_path, as_found=True)
    ((whole, rays, people, reach),) = from_maps([path])
    ((other, others, same, reached),) = from_looks([read_look(look)])
    np.testing.assert_allclose(other, whole, atol=4e-3, rtol=1e-3)
    np.testing.assert_allclose(others, rays, rtol=1e-3)
    np.testing.assert_array_equal(same, people)
    np.testing.assert_array_equal(reached, reach)
    net = Exported(PersonNet()).eval()
    assert len(finds(net, other)[0]) == len(finds(net, whole)[0])


def test_the_recipe_goes_on_from_a_network_and_writes_one_that_detects(tmp_path, monkeypatch):
    torch.manual_seed(2)
    for kind in ("looks", "tuning_looks"):
        _made(tmp_path, kind, as_found=kind != "looks")
    for name in ("start", "earlier"):
        export(PersonNet(), tmp_path / f"{name}.onnx", 0.5, {})
    monkeypatch.setattr("train.look_crops.BATCH", 2)
    asked = [str(tmp_path), "--start-from", str(tmp_path / "start.onnx"), "--steps", "2"]
    earlier = str(tmp_path / "earlier.onnx")
    monkeypatch.setattr("sys.argv", ["further", *asked, "--keep", "1", "--keep-of", earlier])
    with pytest.raises(SystemExit):
        further.main()
    monkeypatch.setattr("sys.argv", ["further", *asked, "--keep", "0.5", "--keep-of", earlier])
    assert further.main() == 0
    assert Detector(tmp_path / "person.onnx").layout == "hsvaos"
    told = json.loads(Network(tmp_path / "person.onnx").metadata["training"])
    assert (told["kept_of_it"], told["kept_of"]) == (0.5, "earlier.onnx")
    curve = (tmp_path / "person" / "curve.csv").read_text().splitlines()
    assert len(curve) == 2
    assert curve[1].startswith("2,")


def test_without_looks_the_recipe_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["further", str(tmp_path)])
    with pytest.raises(SystemExit):
        further.main()
    assert "looks: expected looks" in capsys.readouterr().err


def test_batches_hold_crops_of_the_batch_size(tmp_path):
    _, look = _made(tmp_path)
    batch = next(iter(LookCrops([look], seed=1)))
    assert batch[0].shape[1:] == (len(CHANNELS), CROP_PX, CROP_PX)
    assert int(batch[3].sum()) > 0
