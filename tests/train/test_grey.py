"""The recipe of the network for grey images: scenes, crops, and a shift of scores."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

from hsvaos.detect.grey_input import GREY_CHANNELS, grey_input  # noqa: E402
from hsvaos.detect.yolo import Detector  # noqa: E402
from train.export import export  # noqa: E402
from train.fit import BATCH, fit  # noqa: E402
from train.grey import GreyCrops, crops_of, new_net, shifted  # noqa: E402
from train.grey_scene import SIDE_PX, grey_scene  # noqa: E402
from train.samples import CROP_PX  # noqa: E402


def scenes(count):
    return [grey_scene(np.random.default_rng(seed)) for seed in range(count)]


def test_a_seed_draws_the_same_scene_again():
    first, second = (grey_scene(np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(first.boxes, second.boxes)


def test_people_stand_out_where_their_boxes_are():
    clear, people, empty = 0, 0, 0
    for scene in scenes(25):
        assert scene.image.shape == (SIDE_PX, SIDE_PX)
        empty += len(scene.boxes) == 0
        for x0, y0, x1, y1 in scene.boxes.astype(int):
            inside = scene.image[y0 : y1 + 1, x0 : x1 + 1]
            around = scene.image[max(0, y0 - 40) : y1 + 40, max(0, x0 - 40) : x1 + 40]
            assert np.isfinite(inside).all()
            away = np.abs(inside - np.nanmedian(around)).max()
            spread = np.nanmedian(np.abs(around - np.nanmedian(around)))
            people += 1
            clear += away > 2.0 * spread
    assert people > 30
    assert clear >= 0.9 * people  # the others drown where a bright picture is cut off
    assert empty > 0


def test_crops_hold_the_boxes_of_their_scene():
    scene = next(scene for scene in scenes(20) if len(scene.boxes) > 2)
    whole = grey_input(scene.image)
    samples = crops_of(scene, np.random.default_rng(0))
    assert sum(len(sample.boxes) for sample in samples) > 0
    for sample in samples:
        assert sample.whole.shape == (len(GREY_CHANNELS), CROP_PX, CROP_PX)
        assert np.isfinite(sample.whole).all()
        for box in sample.boxes:
            x, y = np.rint(0.5 * (box[:2] + box[2:])).astype(int)
            moves = scene.boxes - box
            near = moves[np.abs(moves[:, 2:] - moves[:, :2]).max(axis=1) < 1e-9]
            assert any(
                whole[0, y + dy, x + dx] == sample.whole[0, y, x]
                for dx, dy in near[:, :2].astype(int)
            )


def test_the_fit_learns_and_the_network_takes_a_grey_image(tmp_path):
    net = fit(GreyCrops, tmp_path, steps=3, workers=0, new_net=new_net)
    path = tmp_path / "person_grey.onnx"
    export(shifted(net, 0.3, 0.6), path, 0.6, {"steps": 3}, GREY_CHANNELS, (0.036, 0.146))
    detector = Detector(path, score=0.0)
    picture = np.random.default_rng(0).normal(size=(200, 300))
    assert detector.layout == "hsvaos"
    detector.detect(picture)
    assert Detector(path).score == pytest.approx(0.6)
    batch = next(iter(GreyCrops(1)))
    assert batch[0].shape == (BATCH, len(GREY_CHANNELS), CROP_PX, CROP_PX)


def test_a_shift_moves_all_scores_as_the_threshold():
    net = new_net().eval()
    x = torch.randn(1, len(GREY_CHANNELS), 64, 64)
    with torch.no_grad():
        before = torch.sigmoid(net(x)[0]).flatten()
        after = torch.sigmoid(shifted(net, 0.2, 0.6)(x)[0]).flatten()
    at = torch.logit(torch.tensor(0.6)) - torch.logit(torch.tensor(0.2))
    torch.testing.assert_close(torch.logit(after) - torch.logit(before), at.expand(after.shape))
