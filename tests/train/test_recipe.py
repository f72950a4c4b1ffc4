"""The training recipe: its pieces, on drawn maps (extra `train`)."""

from functools import partial

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

from hsvaos.detect.network_input import CHANNELS, network_input  # noqa: E402
from hsvaos.detect.yolo import Detector  # noqa: E402
from train.drawn import draw_figures  # noqa: E402
from train.export import export  # noqa: E402
from train.fit import Crops, collate, fit, loss_of, overlap  # noqa: E402
from train.flights import FIRST_TRAINING_SEED, FIRST_TUNING_SEED, flight_settings  # noqa: E402
from train.maps import (  # noqa: E402
    COHERENCE,
    COHERENT,
    CONDITIONS,
    FRAGMENT_COHERENCE,
    FRAGMENT_COLOUR,
    FRAGMENTS,
    GROUND,
    GROUND_RAYS,
    HUE_FOOTPRINT,
    LAYERS,
    PLANES,
    RARITY_MAP,
    RAYS,
    Condition,
    conditions,
    disturbed,
)
from train.net import STRIDE, Exported, PersonNet, boxes_of, cell_centres  # noqa: E402
from train.samples import CROP_PX, Sample, visit  # noqa: E402
from train.warm import blended, unfolded  # noqa: E402


def drawn_map(path, people=6, seed=0, side=420):
    rng = np.random.default_rng(seed)
    layers = rng.normal(90.0, 6.0, (LAYERS, side, side)).astype(np.float32)
    shares = (RARITY_MAP, COHERENCE, FRAGMENTS, FRAGMENT_COHERENCE)
    for one in shares:
        layers[one] = np.abs(rng.normal(0.02, 0.005, (side, side)))
    layers[RAYS] = 30.0
    layers[HUE_FOOTPRINT] = layers[GROUND_RAYS] = 5.0
    corners = rng.uniform(40, side - 80, (people, 2)).round()
    boxes = np.concatenate([corners, corners + rng.uniform(14, 36, (people, 2)).round()], axis=1)
    for x0, y0, x1, y1 in boxes.astype(int):
        for one in (*PLANES.values(), COHERENT, FRAGMENT_COLOUR, GROUND):
            layers[one, y0:y1, x0:x1] += 40.0
        for one in shares:
            layers[one, y0:y1, x0:x1] += 0.2
    rays = np.full(people, 5.0)
    rays[0] = 0.1
    known = {"boxes": boxes, "rays": rays, "gsd": 0.05, "colour": True, "fragments": True}
    known["classes"] = ["half"] * people
    np.savez(path, layers=layers.astype(np.float16), **known)
    return path


@pytest.mark.parametrize("seed", range(6))
def test_crops_keep_people_where_they_are(tmp_path, seed):
    path = drawn_map(tmp_path / "flight_1_0.npz")
    samples = visit(path, np.random.default_rng(seed), 8)
    assert len(samples) == 8
    found = 0
    for sample in samples:
        assert sample.whole.shape == (len(CHANNELS), CROP_PX, CROP_PX)
        assert np.isfinite(sample.whole).all()
        for x0, y0, x1, y1 in np.clip(np.rint(sample.boxes), 0, CROP_PX).astype(int):
            inside = sample.whole[0, y0 + 2 : y1 - 2, x0 + 2 : x1 - 2]
            if inside.size > 20:
                found += 1
                assert abs(inside.mean()) > 0.4  # below 0 in black-hot pictures
    assert found > 3


def test_cells_answer_for_people_and_not_for_those_nobody_can_see():
    seen = np.array([[40.0, 40.0, 70.0, 60.0]])
    unseen = np.array([[150.0, 150.0, 180.0, 170.0]])
    whole = np.zeros((len(CHANNELS), CROP_PX, CROP_PX), np.float32)
    _, wanted, boxes, people = collate([Sample(whole, seen, unseen)])
    centres = cell_centres(CROP_PX // STRIDE, CROP_PX // STRIDE).numpy()
    own = wanted[0].numpy() == 1.0
    assert 1 <= own.sum() <= 4
    assert np.abs(centres[own] - [55.0, 50.0]).max() < STRIDE
    assert np.array_equal(boxes[0].numpy()[own], np.repeat(seen, own.sum(), 0).astype(np.float32))
    silent = wanted[0].numpy() == -1.0
    assert (centres[silent] > 30).all()
    assert people.tolist() == [1]
    hidden = (centres > [150, 150]).all(1) & (centres < [180, 170]).all(1)
    assert silent[hidden].all()


@pytest.mark.parametrize("channels", [1, 3])
def test_drawn_people_stand_out_where_their_boxes_are(channels):
    rng = np.random.default_rng(2)
    image = rng.normal(90.0, 3.0, (500, 600, channels)).astype(np.float32)
    image[:, :40] = np.nan
    before = image.copy()
    there = np.array([[300.0, 240.0, 330.0, 260.0]])
    found = draw_figures(image, there, 0.05, 12, rng)
    assert 4 <= len(found) <= 12
    changed = np.abs(image - before).max(axis=2)
    assert np.isnan(image[:, :40]).all()
    for box in found:
        x0, y0, x1, y1 = box.astype(int)
        assert changed[y0 : y1 + 1, x0 : x1 + 1].max() > 3.0
        assert 6 < max(x1 - x0, y1 - y0) < 50  # a third of a metre to 2.5 m
        assert np.hypot(*(0.5 * (box[:2] + box[2:]) - [315.0, 250.0])) > 40.0
    assert np.nanmax(changed[240:261, 300:331]) < 1e-3


def test_overlaps_and_boxes():
    first = torch.tensor([[0.0, 0.0, 2.0, 2.0]])
    iou, giou = overlap(first, torch.tensor([[1.0, 0.0, 3.0, 2.0]]))
    assert iou.item() == pytest.approx(1 / 3)
    assert giou.item() == pytest.approx(1 / 3)
    _, apart = overlap(first, torch.tensor([[8.0, 0.0, 10.0, 2.0]]))
    assert apart.item() == pytest.approx(-0.6)
    box = boxes_of(torch.tensor([0.5, -0.5, 0.0, np.log(2.0)]), torch.tensor([11.5, 19.5]))
    assert box.tolist() == pytest.approx([7.5, -0.5, 23.5, 31.5])


def test_training_learns_and_the_export_is_what_was_trained(tmp_path):
    torch.manual_seed(0)
    path = drawn_map(tmp_path / "flight_1_0.npz", people=9)
    rng = np.random.default_rng(1)
    net = PersonNet()
    optimizer = torch.optim.AdamW(net.parameters(), lr=2e-3)
    losses = []
    batch = collate(visit(path, rng, 8))
    for _ in range(12):
        parts = loss_of(net, batch)
        loss = parts["score"] + parts["box"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert np.mean(losses[-3:]) < 0.6 * losses[0]
    model = tmp_path / "person.onnx"
    export(net, model, 0.01, {"recipe": "test"})
    assert model.stat().st_size < 4_000_000
    detector = Detector(model)
    assert detector.layout == "hsvaos"
    assert detector.score == pytest.approx(0.01)
    image = rng.normal(100.0, 5.0, (96, 128, 3)).astype(np.float32)
    image[40:60, 50:80] += 60.0
    found = detector.detect(image)
    trained = Exported(net).eval()(_input(image))[1]
    boxes, scores = Exported(blended(net, model, 1.0)).eval()(_input(image))  # 16 bits a weight
    best = int(scores.argmax())
    assert found.scores[0] == pytest.approx(float(trained.detach().max()), rel=1e-3)
    assert found.scores[0] == pytest.approx(float(scores[0, best].detach()), rel=1e-4)
    assert found.boxes_xyxy[0] == pytest.approx(
        np.clip(boxes[0, best].detach().numpy(), -0.5, [127.5, 95.5] * 2), abs=0.02
    )


def test_an_exported_network_comes_back_as_it_was_and_can_be_trained(tmp_path):
    torch.manual_seed(3)
    batch = collate(visit(drawn_map(tmp_path / "flight_1_0.npz"), np.random.default_rng(2), 6))
    net = PersonNet()
    with torch.no_grad():
        for _ in range(3):  # fills the running means and deviations
            net(batch[0])
        for norm in (m for m in net.modules() if isinstance(m, torch.nn.BatchNorm2d)):
            norm.weight.uniform_(0.5, 1.5)
            norm.bias.normal_(0.0, 0.3)
    model = tmp_path / "person.onnx"
    export(net, model, 0.5, {"recipe": "test"})
    back = unfolded(model, [batch[0]])
    x = batch[0][:2]
    with torch.no_grad():
        for ours, theirs in zip(Exported(back).eval()(x), Exported(net).eval()(x), strict=True):
            assert np.allclose(ours, theirs, rtol=1e-3, atol=1e-3)
        # measured on this very batch, its own means and deviations are those of use
        resting, moving = back.eval()(batch[0])[0], back.train()(batch[0])[0]
    assert float((resting - moving).abs().max()) < 0.02 * float(resting.std()) + 1e-3


def test_a_stopped_run_goes_on_from_its_own_weights_only(tmp_path):
    drawn_map(tmp_path / "flight_1_0.npz")
    crops = partial(Crops, tmp_path)
    fit(crops, tmp_path / "out", steps=1)
    with pytest.raises(ValueError, match=r"goes on from new weights, asked was .*person\.onnx"):
        fit(crops, tmp_path / "out", steps=2, start_from=tmp_path / "person.onnx")


def test_an_older_network_comes_back_blind_to_newer_channels(tmp_path):
    torch.manual_seed(4)
    older = PersonNet(channels=len(CHANNELS) - 1).eval()
    export(older, tmp_path / "older.onnx", 0.5, {}, CHANNELS[:-1])
    batch = collate(visit(drawn_map(tmp_path / "flight_1_0.npz"), np.random.default_rng(2), 3))[0]
    back = unfolded(tmp_path / "older.onnx", [batch]).eval()
    with torch.no_grad():
        want, have = older(batch[:, :-1]), back(batch)
    for ours, theirs in zip(have, want, strict=True):
        assert np.allclose(ours, theirs, rtol=1e-3, atol=1e-3)


def _narrow(tmp_path):
    """Return a network narrower than today's, its file, and what it may be shown."""
    narrow = PersonNet(widths=(24, 40, 72, 96, 64))
    batch = collate(visit(drawn_map(tmp_path / "flight_1_0.npz"), np.random.default_rng(2), 6))[0]
    with torch.no_grad():
        for _ in range(3):
            narrow(batch)
        for norm in (m for m in narrow.modules() if isinstance(m, torch.nn.BatchNorm2d)):
            norm.weight.uniform_(0.5, 1.5)
            norm.bias.normal_(0.0, 0.3)
    path = tmp_path / "narrow.onnx"
    export(narrow.eval(), path, 0.5, {})
    return narrow, path, batch


def _far(ours, theirs):
    """Return how far scores and boxes are apart, in deviations."""
    parts = zip(ours, theirs, strict=True)
    return max(float((a - b).abs().max()) / float(b.std()) for a, b in parts)


def test_a_narrower_network_comes_back_wider_and_gives_the_same(tmp_path):
    torch.manual_seed(6)
    narrow, path, batch = _narrow(tmp_path)
    back = unfolded(path, [batch])
    sizes = [sum(p.numel() for p in net.parameters()) for net in (narrow, back)]
    assert sizes[1] > 1.5 * sizes[0]
    with torch.no_grad():
        assert _far(back.eval()(batch[:2]), narrow(batch[:2])) < 0.01
    loss = (back.train()(batch)[0] ** 2).mean()  # the new parts learn from the first step on
    loss.backward()
    assert float(back.head[0].weight.grad[:64, 96 - 10 :].abs().max()) > 0.0


@pytest.mark.parametrize("share", [0.0, 0.35, 1.0])
def test_a_network_lies_between_what_it_was_and_what_it_became(tmp_path, share):
    torch.manual_seed(5)
    before, after = PersonNet(), PersonNet()
    batch = torch.randn(2, len(CHANNELS), 64, 64)
    with torch.no_grad():
        for net in (before, after):
            for _ in range(3):
                net(batch)
            net.score.bias.normal_(0.0, 1.0)
            net.eval()
    export(before, tmp_path / "before.onnx", 0.5, {})
    mixed = blended(after, tmp_path / "before.onnx", share).eval()
    bias = torch.lerp(after.score.bias, before.score.bias, share)
    assert torch.allclose(mixed.score.bias, bias, atol=1e-5)
    with torch.no_grad():
        outputs = [net(batch) for net in (mixed, before, after)]
    for whole, first, last in zip(*outputs, strict=True):
        assert torch.allclose(whole, first, rtol=1e-3, atol=1e-3) == (share == 1.0)
        assert torch.allclose(whole, last, rtol=1e-3, atol=1e-3) == (share == 0.0)


def test_a_wide_network_lies_between_a_narrower_file_and_what_became_of_it(tmp_path):
    torch.manual_seed(8)
    narrow, path, batch = _narrow(tmp_path)
    after = unfolded(path, [batch]).train()
    learning = torch.optim.SGD(after.parameters(), lr=0.05)
    for _ in range(5):
        learning.zero_grad()
        (after(batch)[0] ** 2).mean().backward()
        learning.step()
    after.eval()
    with torch.no_grad():
        first, last = narrow(batch), after(batch)
        mixed = {share: blended(after, path, share)(batch) for share in (0.0, 0.5, 1.0)}
    assert _far(last, first) > 0.1
    assert _far(mixed[1.0], first) < 0.01
    assert _far(mixed[0.0], last) < 0.01
    assert min(_far(mixed[0.5], first), _far(mixed[0.5], last)) > 0.02


def test_a_file_of_another_network_is_not_brought_back(tmp_path):
    other = PersonNet(widths=(48, 64, 96, 128, 96))
    export(other, tmp_path / "other.onnx", 0.5, {})
    with pytest.raises(ValueError, match=r"expected the layers .* of PersonNet"):
        unfolded(tmp_path / "other.onnx", [])


def _input(image):
    return torch.from_numpy(network_input(image))[None]


def test_conditions_disturb_poses_as_much_as_they_say():
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, 0, 3] = np.arange(40.0)
    assert np.array_equal(disturbed(poses, Condition(), rng), poses)
    errors = []
    for _ in range(30):
        changed = disturbed(poses, Condition(drift_m=0.3, turn_deg=0.5), rng)
        turns = changed[:, :3, :3]
        assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-9)
        away = changed[:, :3, 3] - poses[:, :3, 3]
        assert np.abs(away.mean(axis=0)).max() < 1e-9
        errors.append(away.std())
    assert 0.2 < np.mean(errors) < 0.32
    assert len(conditions(rng)) == CONDITIONS


def test_seeds_of_training_tuning_and_tables_are_apart():
    from bench.paper_flights import FIRST_SEED

    assert FIRST_SEED + 1000 < FIRST_TRAINING_SEED < FIRST_TUNING_SEED
    one, again, other = (flight_settings(seed) for seed in (100_000, 100_000, 100_001))
    assert one.fingerprint() == again.fingerprint() != other.fingerprint()
