"""Average precision against pycocotools, and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos.detect.overlap import overlaps
from hsvaos.evaluate.detection import Matches, match_boxes
from tests.evaluate.strategies import View, coco_ap, views


def matched(made: list[View], iou: float, most: int = 100) -> Matches:
    return Matches.join(
        [
            match_boxes(
                v.boxes, v.scores, v.truth, iou, ignore=v.ignore, regions=v.regions, most=most
            )
            for v in made
        ]
    )


@settings(max_examples=150)
@given(
    made=views(), iou=st.sampled_from([0.10, 0.25, 0.50, 0.75, 1.0]), most=st.sampled_from([3, 100])
)
def test_average_precision_is_that_of_pycocotools(made: list[View], iou: float, most: int) -> None:
    want = coco_ap(made, iou, most)
    matches = matched(made, iou, most)
    got = matches.curve().ap_coco101
    if want is None:
        assert matches.positives == 0 or len(matches.scores) == 0 or got == 0.0
    else:
        assert got == pytest.approx(want, abs=1e-6)


@given(made=views())
def test_only_the_order_of_scores_matters(made: list[View]) -> None:
    # a network's probabilities, local z, anything
    wide = [v._replace(scores=np.arctan(v.scores) * 1e-3 - 7.0) for v in made]
    one, other = matched(made, 0.25).curve(), matched(wide, 0.25).curve()
    assert one.hit.tolist() == other.hit.tolist()
    for form in ("ap_coco101", "ap_voc11", "ap_all"):
        assert getattr(one, form) == getattr(other, form)


def test_the_three_forms_by_hand() -> None:
    # hits at ranks 1 and 3 of four true boxes: recall .25 at precision 1, .5 at 2/3
    matches = Matches(
        np.array([4.0, 3.0, 2.0]), np.array([0, -1, 1]), np.zeros(3, np.bool_), positives=4
    )
    curve = matches.curve()
    assert curve.ap_all == pytest.approx(0.25 * 1.0 + 0.25 * 2 / 3)
    assert curve.ap_voc11 == pytest.approx((3 * 1.0 + 3 * 2 / 3) / 11)
    assert curve.ap_coco101 == pytest.approx((26 * 1.0 + 25 * 2 / 3) / 101)
    np.testing.assert_allclose(curve.envelope, [1.0, 2 / 3, 2 / 3])


def test_counts_at_a_threshold() -> None:
    matches = Matches(
        np.array([9.0, 7.0, 6.0, 5.0]),
        np.array([0, -1, 1, 2]),
        np.array([False, False, True, False]),
        positives=3,
    )
    at_all, at_seven = matches.counts(), matches.counts(7.0)
    assert (at_all.tp, at_all.fp, at_all.fn) == (2, 1, 1)
    assert (at_seven.tp, at_seven.fp, at_seven.fn) == (1, 1, 2)
    assert at_seven.precision == 0.5
    assert at_seven.recall == pytest.approx(1 / 3)
    nothing = matches.counts(10.0)
    assert nothing.precision is None
    assert nothing.recall == 0.0


def test_nothing_to_find_has_no_average_precision() -> None:
    curve = match_boxes([[0, 0, 4, 4]], [1.0], [], 0.5).curve()
    assert curve.ap_coco101 is None
    assert curve.ap_voc11 is None
    assert curve.ap_all is None
    assert Matches.join([]).curve().ap_all is None
    missed = match_boxes([], [], [[0, 0, 4, 4]], 0.5)
    assert missed.counts().fn == 1
    assert missed.curve().ap_coco101 == missed.curve().ap_all == missed.curve().ap_voc11 == 0.0


def test_perfect_finds_are_worth_one_in_every_form() -> None:
    truth = np.array([[0, 0, 4, 4], [10, 10, 14, 19]])
    curve = match_boxes(truth, [-3.0, 70.0], truth, 0.5).curve()
    assert curve.ap_coco101 == curve.ap_voc11 == curve.ap_all == 1.0


def test_what_is_to_be_ignored_takes_only_what_fits_nothing_else() -> None:
    truth = [[0, 0, 10, 10], [0, 0, 10, 9]]
    # the first overlaps the ignored one more, but the other is to be found
    matches = match_boxes([[0, 0, 10, 9]], [1.0], truth, 0.5, ignore=[False, True])
    assert matches.truth.tolist() == [0]
    assert not matches.ignored.any()
    # two finds on one ignored person: the second is false; in a region both are passed over
    twice = [[0, 0, 10, 10], [0, 0, 10, 9]]
    plain = match_boxes(twice, [2.0, 1.0], truth[:1], 0.5, ignore=[True])
    assert plain.ignored.tolist() == [True, False]
    assert plain.counts().fp == 1
    region = match_boxes(twice, [2.0, 1.0], truth[:1], 0.5, regions=[True])
    assert region.ignored.tolist() == [True, True]


def test_a_greater_threshold_never_finds_more() -> None:
    rng = np.random.default_rng(3)
    truth = np.array([[0, 0, 20, 20], [30, 30, 50, 60], [60, 0, 80, 25]], float)
    boxes = np.repeat(truth, 3, axis=0) + rng.normal(0.0, 4.0, (9, 4))
    hits = [match_boxes(boxes, np.arange(9.0), truth, t).counts().tp for t in (0.1, 0.5, 0.9)]
    assert hits == sorted(hits, reverse=True)


def test_overlap_of_boxes() -> None:
    share = overlaps([[0, 0, 2, 2]], [[1, 0, 3, 2], [5, 5, 6, 6], [1, 1, 1, 1]])
    np.testing.assert_allclose(share, [[2 / 6, 0.0, 0.0]])
    np.testing.assert_allclose(overlaps([[0, 0, 2, 2]], [[1, 0, 3, 2]], [True]), [[0.5]])
    assert overlaps([[1, 1, 1, 1]], [[1, 1, 1, 1]]).tolist() == [[0.0]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scores": [1.0, 2.0]}, "a score for each of 1 boxes"),
        ({"scores": [float("nan")]}, "NaN"),
        ({"boxes": [[0, 0, float("inf"), 1]]}, "finite"),
        ({"iou": 0.0}, "iou must be above 0"),
        ({"iou": 1.5}, "iou must be above 0"),
        ({"most": 0}, "most must be at least 1"),
        ({"ignore": [True, True]}, "ignore must have one flag for each of 1"),
    ],
)
def test_bad_input_is_named(changes: dict[str, object], message: str) -> None:
    given_: dict[str, object] = {
        "boxes": [[0, 0, 1, 1]],
        "scores": [1.0],
        "truth": [[0, 0, 1, 1]],
        "iou": 0.5,
    }
    with pytest.raises(ValueError, match=message):
        match_boxes(**{**given_, **changes})  # type: ignore[arg-type]
