"""The second look's recipe: its looks, labels, and fit, on drawn maps (extra `train`)."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'hsvaos[train]'")
pytest.importorskip("onnx", reason="needs pip install 'hsvaos[train]'")

from hsvaos.detect.network import Network  # noqa: E402
from hsvaos.detect.network_input import CHANNELS  # noqa: E402
from hsvaos.detect.second_look import (  # noqa: E402
    FLOOR,
    LOOK_PX,
    SECOND_CHANNELS,
    SecondLook,
    facts_of,
    moved,
)
from tests.detect.nets import own_net  # noqa: E402
from tests.train.test_recipe import drawn_map  # noqa: E402
from train.classes import CLASS_SHARES  # noqa: E402
from train.looks import Look, make_look, read_look  # noqa: E402
from train.second_fit import (  # noqa: E402
    Candidates,
    collate,
    drawn,
    fit_second,
    loss_of,
    shifted,
)
from train.second_judge import (  # noqa: E402
    looked_again,
    matched_again,
    most_expected,
    threshold_shift,
)
from train.second_net import (  # noqa: E402
    ExportedSecond,
    MeanOfNets,
    SecondNet,
    export_second,
)
from train.teacher import opinions, teach  # noqa: E402
from train.warm import blended_second, stored_seconds, unfolded_seconds  # noqa: E402

_SIXTEEN_BITS = {"rtol": 2e-3, "atol": 4e-3}
"""What stored weights may change: each by up to 2^-11 of itself."""


def first_network(path):
    weights = [0.0] * len(CHANNELS)
    weights[CHANNELS.index("ground light")] = 2.0
    path.write_bytes(own_net(weights, -2.0))
    return Network(path)


def a_look(people, boxes, reach=None, classes=None):
    boxes = np.array(boxes, np.float32).reshape(-1, 4)
    layers = np.zeros((100, 100, len(SECOND_CHANNELS)), np.float16)
    reach = np.full(len(people), 9.0) if reach is None else np.array(reach)
    people = np.array(people, np.float32).reshape(-1, 4)
    rays = np.full((100, 100), 30.0, np.float16)
    scores = np.full(len(boxes), 0.3, np.float32)
    classes = np.array(classes or ["half"] * len(people), dtype="U8")
    return Look(layers, rays, boxes, scores, people, reach, classes)


def test_candidates_are_people_nobody_or_not_taught():
    people = [[20, 20, 40, 40], [60, 60, 80, 80]]
    boxes = [
        [20, 20, 40, 40],  # the first
        [62, 60, 82, 80],  # the second, whom no ray reaches
        [0, 60, 20, 80],  # nobody
        [33, 20, 53, 40],  # 7 / 33 of the first: still
        [37, 20, 57, 40],  # 3 / 37: neither
        [29, 29, 31, 31],  # in the middle of the first, but a hundredth of it
    ]
    found = a_look(people, boxes, reach=[9.0, 0.5])
    assert found.whose.tolist() == [0, -2, -1, 0, -2, -2]
    assert a_look([], boxes).whose.tolist() == [-1] * len(boxes)


def test_rare_classes_of_people_are_drawn_as_often_as_in_a_search(tmp_path, monkeypatch):
    """Of 40 people 37 are half hidden; only the one under a bush has a square box."""
    names = ["half"] * 37 + ["bush", "open", "open"]
    sides = {"half": 10.0, "bush": 20.0, "open": 40.0}
    people = [[30.0, 30.0, 30.0 + sides[name], 50.0] for name in names]
    look = a_look(people, [*people, [70.0, 70.0, 75.0, 90.0]], classes=names)
    look.__dict__["whose"] = np.append(np.arange(40), -1)  # boxes lie over each other
    monkeypatch.setattr("train.look_batches.read_look", lambda path: look)
    batches = iter(Candidates([tmp_path / "one"], seed=3))
    drawn_ones = [next(batches) for _ in range(4)]
    boxes = np.concatenate([batch[3].numpy()[batch[4].numpy() > 0] for batch in drawn_ones])
    # turned and resized, a patch keeps a box's ratio of sides: .5, 1 and 2, or the inverse
    ratio = np.abs(np.log2((boxes[:, 2] - boxes[:, 0]) / (boxes[:, 3] - boxes[:, 1])))
    assert 120 < len(boxes) < 190
    square = np.mean(ratio < 0.2)
    expected = CLASS_SHARES["bush"] / (1.0 - CLASS_SHARES["full"])
    assert square == pytest.approx(expected, abs=0.1)  # 1 in 40 if all were drawn alike


@pytest.mark.parametrize("seed", range(5))
def test_variations_keep_the_box_over_what_it_shows(seed):
    rng = np.random.default_rng(seed)
    look = a_look([[40, 30, 62, 44]], [[38, 30, 60, 46]])
    look.layers[30:45, 40:63, 0] = 1.0
    for _ in range(20):
        view, facts, box, person, is_person, taught = drawn(look, 0, rng)
        assert taught == -1.0
        assert view.shape == (LOOK_PX, LOOK_PX, len(SECOND_CHANNELS) + 1)
        assert is_person
        x0, y0, x1, y1 = np.rint(person).astype(int)
        assert view[y0 + 1 : y1, x0 + 1 : x1, 0].min() > 0.4
        assert view[: y0 - 2, :, 0].max(initial=0.0) < 0.1
        assert view[:, : x0 - 2, 0].max(initial=0.0) < 0.1
        rows, columns = np.nonzero(view[..., -1] > 0.5)
        edges = [columns.min(), rows.min(), columns.max(), rows.max()]
        # whole pixels lie up to one within the box, enlarged by 80 / 72, and are interpolated
        np.testing.assert_allclose(edges, box, atol=80 / 72 + 0.5)
        np.testing.assert_allclose(0.5 * (box[:2] + box[2:]), 0.5 * (LOOK_PX - 1), atol=0.6)
        assert np.exp(facts[1]) * 32.0 == pytest.approx(box[2] - box[0], rel=0.35)


def test_boxes_move_in_training_as_in_use():
    rng = np.random.default_rng(1)
    corners = rng.uniform(0, 90, (40, 2))
    boxes = np.concatenate([corners, corners + rng.uniform(3, 40, (40, 2))], 1).astype(np.float32)
    shifts = rng.normal(0.0, 0.8, (40, 4)).astype(np.float32)
    have = shifted(torch.from_numpy(boxes), torch.from_numpy(shifts)).numpy()
    np.testing.assert_allclose(have, moved(boxes, shifts), rtol=1e-4, atol=1e-3)


def test_a_new_network_has_the_first_ones_opinion():
    net = SecondNet().eval()
    views, facts = torch.randn(3, len(SECOND_CHANNELS) + 1, LOOK_PX, LOOK_PX), torch.randn(3, 3)
    with torch.no_grad():
        logits, shifts = net(views, facts)
    assert torch.equal(logits, facts[:, 0])
    assert not shifts.any()


def test_the_second_look_learns_and_is_exported_as_it_was_trained(tmp_path):
    first = first_network(tmp_path / "first.onnx")
    looks = tmp_path / "looks"
    looks.mkdir()
    for seed in range(2):
        made = drawn_map(tmp_path / f"flight_{seed}_0.npz", seed=seed)
        make_look(made, looks, first)
    paths = sorted(looks.glob("*.npz"))
    whole = [read_look(path) for path in paths]
    assert all((one.whose >= 0).any() for one in whole)
    assert all((one.scores < FLOOR).any() for one in whole)  # weaker ones than in use
    net = fit_second(paths, tmp_path / "out", steps=25, workers=0, rate=3e-3)
    rng = np.random.default_rng(5)
    chosen = [(one, int(k)) for one in whole for k in np.flatnonzero(one.whose != -2)]
    batch = collate([drawn(one, k, rng) for one, k in chosen])
    torch.manual_seed(0)
    before, after = (
        {k: float(v.detach()) for k, v in loss_of(some.eval(), batch).items()}
        for some in (SecondNet(), net)
    )
    assert after["score"] < before["score"]
    matches = matched_again(net, whole)
    assert len(matches[0.25].curve().recall)
    export_second(net, tmp_path / "second.onnx", 0.4, {"recipe": "test"})
    shipped = SecondLook(tmp_path / "second.onnx")
    look = whole[0]
    planes = np.moveaxis(look.layers, 2, 0).astype(np.float32)
    boxes, scores = shipped((planes,), look.boxes, look.scores)
    views = [np.float32(one) for one in (look.boxes, look.scores)]
    with torch.no_grad():
        patches = torch.from_numpy(_patches(look))
        want = ExportedSecond(net)(patches, torch.from_numpy(facts_of(*views)))
    logits = np.log(scores / (1.0 - scores)) - 0.4
    np.testing.assert_allclose(1.0 / (1.0 + np.exp(-logits)), want[0].numpy(), atol=2e-3)
    np.testing.assert_allclose(boxes, moved(look.boxes, want[1].numpy()), atol=0.05)
    assert len(looked_again(net, look)[0]) <= len(boxes)
    meta = json.loads(Network(tmp_path / "second.onnx").metadata["training"])
    assert meta == {"recipe": "test"}


def _patches(look):
    from hsvaos.detect.second_look import patch

    return np.stack([patch((np.moveaxis(look.layers, 2, 0),), box) for box in look.boxes])


def test_two_networks_are_asked_together():
    torch.manual_seed(4)
    nets = [SecondNet().eval(), SecondNet().eval()]
    for net in nets:
        torch.nn.init.normal_(net.score.weight)
        torch.nn.init.normal_(net.box.weight)
    views, facts = torch.randn(3, len(SECOND_CHANNELS) + 1, LOOK_PX, LOOK_PX), torch.randn(3, 3)
    with torch.no_grad():
        (a, to_a), (b, to_b) = (net(views, facts) for net in nets)
        logits, shifts = MeanOfNets(nets)(views, facts)
    assert not torch.allclose(a, b)
    torch.testing.assert_close(logits, 0.5 * (a + b))
    torch.testing.assert_close(shifts, 0.5 * (to_a + to_b))
    with torch.no_grad():
        logits, shifts = MeanOfNets(nets, [3.0, 1.0])(views, facts)
        score, same = MeanOfNets(nets, [3.0, 1.0], first=0.4)(views, facts)
    torch.testing.assert_close(logits, 0.75 * a + 0.25 * b)
    torch.testing.assert_close(shifts, 0.75 * to_a + 0.25 * to_b)
    torch.testing.assert_close(score, 0.6 * logits + 0.4 * facts[:, 0])
    assert torch.equal(same, shifts)  # boxes are put right without the first


def test_networks_of_several_kinds_come_back_from_one_file_as_they_were(tmp_path):
    kinds = {"widths": (16, 24, 32, 40, 20), "depths": (1, 0, 2, 1), "channels": len(CHANNELS)}
    (small, other), (views, facts) = _ready(11, **kinds)
    (large, _), _ = _ready(12)
    weights = [0.5, 0.2, 0.3]
    nets = MeanOfNets([small, large, other], weights)
    export_second(nets, tmp_path / "second.onnx", 0.0, {})
    back = stored_seconds(tmp_path / "second.onnx")
    assert [net.channels for net in back] == [len(CHANNELS), len(SECOND_CHANNELS), len(CHANNELS)]
    with torch.no_grad():
        for have, want in zip(back, nets.nets, strict=True):
            torch.testing.assert_close(have(views, facts), want(views, facts), **_SIXTEEN_BITS)
        views[:, len(CHANNELS) : -1] += 1.0  # the colours, which two of them do not see
        changed = [net(views, facts)[0] for net in back]
        views[:, len(CHANNELS) : -1] -= 1.0
        same = [
            torch.equal(net(views, facts)[0], one) for net, one in zip(back, changed, strict=True)
        ]
    assert same == [True, False, True]


def _ready(seed, **kind):
    """Two networks with means and deviations of their own, and what they were shown."""
    torch.manual_seed(seed)
    nets = [SecondNet(**kind), SecondNet(**kind)]
    views, facts = torch.randn(24, len(SECOND_CHANNELS) + 1, LOOK_PX, LOOK_PX), torch.randn(24, 3)
    with torch.no_grad():
        for net in nets:
            for _ in range(3):
                net(views, facts)
            for norm in (m for m in net.modules() if isinstance(m, torch.nn.BatchNorm2d)):
                norm.weight.uniform_(0.5, 1.5)
                norm.bias.normal_(0.0, 0.3)
            for layer in (net.score, net.box):
                torch.nn.init.normal_(layer.weight)
            net.eval()
    return nets, (views, facts)


def test_exported_networks_come_back_as_they_were_and_can_be_trained(tmp_path):
    nets, shown = _ready(6)
    export_second(MeanOfNets(nets), tmp_path / "second.onnx", 0.7, {})
    back = unfolded_seconds(tmp_path / "second.onnx", [shown])
    assert len(back) == 2
    with torch.no_grad():
        for net, again in zip(nets, back, strict=True):
            for have, want in zip(again(*shown), net(*shown), strict=True):
                torch.testing.assert_close(have, want, **_SIXTEEN_BITS)
            again.dropout.p = 0.0
            resting, moving = again(*shown)[0], again.train()(*shown)[0]
            assert float((resting - moving).abs().max()) < 0.05 * float(resting.std())


def test_a_network_of_another_size_is_trained_further_as_it_is(tmp_path):
    kinds = {"widths": (16, 24, 32, 40, 20), "depths": (1, 0, 2, 1), "channels": len(CHANNELS)}
    (small, _), shown = _ready(13, **kinds)
    first = first_network(tmp_path / "first.onnx")
    (tmp_path / "looks").mkdir()
    make_look(drawn_map(tmp_path / "flight_0_0.npz"), tmp_path / "looks", first)
    with torch.no_grad():
        before = small(*shown)[0]
    paths = [tmp_path / "looks" / "flight_0_0.npz"]
    net = fit_second(paths, tmp_path / "out", steps=2, workers=0, rate=1e-3, start=small)
    assert net.channels == len(CHANNELS)
    with torch.no_grad():
        after = net(*shown)[0]
    assert not torch.equal(after, before)
    assert float((after - before).std()) < float(before.std())
    assert torch.load(tmp_path / "out" / "second_state.pt")["step"] == 2


@pytest.mark.parametrize("index", [0, 1])
def test_a_second_look_lies_between_what_it_was_and_what_it_became(tmp_path, index):
    before, shown = _ready(7)
    after = _ready(8)[0][index]
    export_second(MeanOfNets(before), tmp_path / "second.onnx", 0.0, {})
    mixed = {s: blended_second(after, tmp_path / "second.onnx", index, s) for s in (0.0, 0.4, 1.0)}
    with torch.no_grad():
        found = {share: net(*shown)[0] for share, net in mixed.items()}
        torch.testing.assert_close(found[0.0], after(*shown)[0], rtol=1e-3, atol=1e-3)
        torch.testing.assert_close(found[1.0], before[index](*shown)[0], **_SIXTEEN_BITS)
        assert not torch.allclose(found[0.4], found[1.0], rtol=1e-2, atol=1e-2)
    bias = torch.lerp(after.score.bias, before[index].score.bias, 0.4)
    torch.testing.assert_close(mixed[0.4].score.bias, bias)


def test_a_file_of_other_networks_is_no_second_look(tmp_path):
    from train.export import export
    from train.net import PersonNet

    export(PersonNet(), tmp_path / "person.onnx", 0.5, {})
    with pytest.raises(ValueError, match="expected the layers of SecondNet, got filters"):
        unfolded_seconds(tmp_path / "person.onnx", [])


def test_the_threshold_leaves_room_for_false_finds_that_did_not_come():
    """Precision .95 where six in ten people lie, with as many false finds as there may well be."""
    people = [[20 * k, 20, 20 * k + 10, 40] for k in range(4)]
    wrong = [20, 60, 30, 80]

    def shift(sure, faint, false):
        looks = []
        for k in range(sure + faint):
            look = a_look(people[:1], [people[0], *([wrong] * (k < false))])
            look.scores[0] = 0.9 if k < sure else 0.4
            look.scores[1:] = 0.6
            looks.append(look)
        return threshold_shift(matched_again(SecondNet(), looks), 0.5)

    low, high = (-float(np.log(p / (1.0 - p))) for p in (0.4, 0.9))
    assert shift(100, 30, 0) == pytest.approx(low, abs=1e-3)  # 78 and at most 3: .963
    assert shift(100, 30, 1) == pytest.approx(high, abs=1e-3)  # 78 and 4.7: .943; 60 and 3: .952
    assert shift(100, 60, 1) == pytest.approx(low, abs=1e-3)  # 96 and 4.7: .953


def test_how_many_more_there_may_be():
    table = {0: 2.996, 1: 4.744, 2: 6.296, 5: 10.513, 20: 29.062}  # Garwood's
    for count, limit in table.items():
        assert most_expected(count) == pytest.approx(limit, abs=2e-3)


def test_other_cameras_change_all_colours_alike_and_nothing_that_is_not_known():
    rng = np.random.default_rng(3)
    look = a_look([[40, 30, 62, 44]], [[38, 30, 60, 46]])
    levels = look.layers[..., len(CHANNELS) :]
    levels[20:60, 20:80] = np.tile([0.5, 0.2, -0.3], 3)
    seen = []
    for _ in range(30):
        view = drawn(look, 0, rng)[0][..., len(CHANNELS) : -1]
        inner = view[np.abs(view).min(axis=2) > 0.0]
        middle = np.median(inner, axis=0)
        np.testing.assert_allclose(middle[3:], np.tile(middle[:3], 2), atol=1e-5)
        assert (view == 0.0).all(axis=2).any()
        seen.append(middle[:3])
    assert (np.std(seen, axis=0) > 0.05).all()
    np.testing.assert_allclose(np.mean(seen, axis=0), [0.5, 0.2, -0.3], atol=0.1)


def test_a_teacher_says_what_it_was_trained_to_say(tmp_path):
    first = first_network(tmp_path / "first.onnx")
    path = tmp_path / "flight_0_0.npz"
    (tmp_path / "maps").mkdir()
    make_look(drawn_map(tmp_path / "maps" / path.name), tmp_path, first)
    look = read_look(path)
    assert look.taught is None
    nets, _ = _ready(9)
    for net in nets:  # not so sure
        torch.nn.init.normal_(net.score.weight, std=0.02)
    export_second(MeanOfNets(nets), tmp_path / "second.onnx", 0.7, {"shift": 0.7})
    assert teach(path, tmp_path / "second.onnx") == "flight_0_0"
    with torch.no_grad():
        patches = torch.from_numpy(_patches(look).astype(np.float32))
        facts = torch.from_numpy(facts_of(look.boxes, look.scores))
        want = torch.sigmoid(MeanOfNets(nets)(patches, facts)[0]).numpy()
    taught = read_look(path).taught
    assert taught is not None
    assert np.ptp(want) > 0.01
    np.testing.assert_allclose(taught, want, atol=2e-3)
    assert drawn(read_look(path), 1, np.random.default_rng(0))[-1] == taught[1]
    before = path.stat().st_mtime, (tmp_path / "flight_0_0.taught.npy").stat().st_mtime
    teach(path, tmp_path / "missing.onnx")  # is there already, and not asked again
    assert before == (path.stat().st_mtime, (tmp_path / "flight_0_0.taught.npy").stat().st_mtime)
    with pytest.raises(ValueError, match="expected channels of a second look, got ''"):
        opinions(first_network(tmp_path / "other.onnx"), look)


def test_a_score_aims_at_the_truth_and_a_little_at_the_teacher():
    views, facts = torch.zeros(2, len(SECOND_CHANNELS) + 1, LOOK_PX, LOOK_PX), torch.zeros(2, 3)
    boxes = torch.tensor([[30.0, 30.0, 50.0, 50.0]] * 2)
    person = torch.tensor([1.0, 0.0])
    net = SecondNet().eval()  # says what facts say

    def score(*taught):
        batch = views, facts, boxes, boxes * person[:, None], person, torch.tensor(taught)
        facts[:, 0] = logit
        return float(loss_of(net, batch)["score"].detach())

    logit = 1.0
    unsure, sure = -np.log(1 / (1 + np.exp(-1.0))), -np.log(1 / (1 + np.exp(1.0)))
    assert score(-1.0, -1.0) == pytest.approx(0.5 * (unsure + sure), abs=0.02)
    assert score(-1.0, 1.0) == pytest.approx(0.5 * (unsure + 0.7 * sure + 0.3 * unsure), abs=0.02)
    assert score(0.0, -1.0) == pytest.approx(0.5 * (0.7 * unsure + 0.3 * sure + sure), abs=0.02)
