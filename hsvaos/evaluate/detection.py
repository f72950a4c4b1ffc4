"""Boxes against true boxes: matching, precision-recall curves and average precision.

The rules are those of COCO (Lin et al. 2014, as its reference implementation has them): from the
strongest box down, each takes the free true box it overlaps most, if by the threshold at least;
what is to be ignored is taken only where nothing else fits, and then counts neither way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.detect.overlap import overlaps

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Matches:
    """Which finds are true, in one view or in many joined.

    Args:
        scores: Shape (K,), strongest first in each view; of any range, greater is surer.
        truth: Shape (K,), int64, number of the matched truth in its view, -1 for none.
        ignored: Shape (K,), bool, matched with something that is to be ignored.
        positives: True boxes that are to be found.
    """

    scores: Array
    truth: NDArray[np.int64]
    ignored: Flags
    positives: int

    @classmethod
    def join(cls, parts: Sequence[Matches]) -> Matches:
        """Return the matches of several views as one."""
        if not parts:
            return cls(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.bool_), 0)
        return cls(
            np.concatenate([part.scores for part in parts]),
            np.concatenate([part.truth for part in parts]),
            np.concatenate([part.ignored for part in parts]),
            sum(part.positives for part in parts),
        )

    @property
    def hit(self) -> Flags:
        """Shape (K,), bool, finds that are true."""
        return (self.truth >= 0) & ~self.ignored

    def counts(self, score: float | None = None) -> Counts:
        """Return hits, false finds and misses.

        Args:
            score: Least score that counts; all finds count if None.
        """
        keep = ~self.ignored
        if score is not None:
            keep &= self.scores >= score
        hits = int((self.hit & keep).sum())
        return Counts(hits, int(keep.sum()) - hits, self.positives - hits)

    def curve(self) -> Curve:
        """Return precision over recall."""
        keep = ~self.ignored
        order = np.argsort(-self.scores[keep], kind="stable")
        return Curve(self.scores[keep][order], self.hit[keep][order], self.positives)


@dataclass(frozen=True)
class Counts:
    """Hits, false finds and misses.

    Args:
        tp: True positives.
        fp: False positives.
        fn: False negatives.
    """

    tp: int
    fp: int
    fn: int

    @property
    def precision(self) -> float | None:
        """Share of the finds that are true; None without finds."""
        return self.tp / (self.tp + self.fp) if self.tp + self.fp else None

    @property
    def recall(self) -> float | None:
        """Share of the truth that was found; None without any."""
        return self.tp / (self.tp + self.fn) if self.tp + self.fn else None


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision over recall as the score threshold falls.

    The three forms of average precision differ in where they read the envelope p(r), the greatest
    precision at recall r or more. All are None where there is nothing to find.

    Args:
        scores: Shape (K,), falling.
        hit: Shape (K,), bool, true finds.
        positives: What is to be found.
    """

    scores: Array
    hit: Flags
    positives: int

    @cached_property
    def recall(self) -> Array:
        """Shape (K,), recall down to each find."""
        return np.asarray(np.cumsum(self.hit) / max(self.positives, 1), dtype=np.float64)

    @cached_property
    def precision(self) -> Array:
        """Shape (K,), precision down to each find."""
        return np.asarray(np.cumsum(self.hit) / np.arange(1, len(self.hit) + 1), dtype=np.float64)

    @cached_property
    def envelope(self) -> Array:
        """Shape (K,), greatest precision from each find on."""
        return np.asarray(np.maximum.accumulate(self.precision[::-1])[::-1])

    def precision_at(self, recalls: ArrayLike) -> Array:
        """Return the envelope at some recalls, 0 beyond the last."""
        at = np.searchsorted(self.recall, np.asarray(recalls, dtype=np.float64), side="left")
        return np.append(self.envelope, 0.0)[at]

    @property
    def ap_coco101(self) -> float | None:
        """Mean of p at recalls 0, 0.01, ... 1 (COCO)."""
        return self._mean_at(np.linspace(0.0, 1.0, 101))

    @property
    def ap_voc11(self) -> float | None:
        """Mean of p at recalls 0, 0.1, ... 1 (Pascal VOC 2007)."""
        return self._mean_at(np.arange(11) / 10.0)

    @property
    def ap_all(self) -> float | None:
        """Area under p, every point of it (Pascal VOC 2010 and later)."""
        if self.positives == 0:
            return None
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.envelope))

    def _mean_at(self, recalls: Array) -> float | None:
        return float(np.mean(self.precision_at(recalls))) if self.positives else None


def match_boxes(
    boxes: ArrayLike,
    scores: ArrayLike,
    truth: ArrayLike,
    iou: float,
    *,
    ignore: ArrayLike | None = None,
    regions: ArrayLike | None = None,
    most: int = 100,
) -> Matches:
    """Match the boxes of one view with the true ones.

    Args:
        boxes: Shape (K, 4), left, top, right, bottom [px].
        scores: Shape (K,), of any range, greater is surer.
        truth: Shape (T, 4) [px].
        iou: Least intersection over union of a match, 0 < iou <= 1.
        ignore: Shape (T,), bool, true boxes that need not be found: one find may take each.
        regions: Shape (T,), bool, the same, but any number of finds may lie in each, and the share
            of the find's area that does so counts as its overlap (COCO's crowds).
        most: Strongest boxes that count.

    Raises:
        ValueError: If shapes do not fit, a number is NaN, or iou or most is out of range.
    """
    found, values, true = (np.asarray(a, dtype=np.float64) for a in (boxes, scores, truth))
    found, true = found.reshape(-1, 4), true.reshape(-1, 4)
    if values.shape != (len(found),):
        raise ValueError(f"expected a score for each of {len(found)} boxes, got {values.shape}")
    if np.isnan(values).any() or not (np.isfinite(found).all() and np.isfinite(true).all()):
        raise ValueError("boxes must be finite and scores no NaN")
    if not 0.0 < iou <= 1.0:
        raise ValueError(f"iou must be above 0 and at most 1, got {iou!r}")
    if most < 1:
        raise ValueError(f"most must be at least 1, got {most!r}")
    loose = _flags(regions, len(true), "regions")
    passed = _flags(ignore, len(true), "ignore") | loose
    order = np.argsort(-values, kind="stable")[:most]
    share = overlaps(found[order], true, loose)
    taken = _assign(share, iou, passed, loose)
    ignored = np.zeros(len(order), np.bool_)
    ignored[taken >= 0] = passed[taken[taken >= 0]]
    return Matches(values[order], taken, ignored, int((~passed).sum()))


def _flags(flags: ArrayLike | None, count: int, name: str) -> Flags:
    if flags is None:
        return np.zeros(count, np.bool_)
    values = np.asarray(flags, dtype=np.bool_)
    if values.shape != (count,):
        raise ValueError(f"{name} must have one flag for each of {count} boxes, got {values.shape}")
    return values


def _assign(share: Array, iou: float, ignore: Flags, regions: Flags) -> NDArray[np.int64]:
    """Give each find, strongest first, the truth it overlaps most, or -1."""
    least = min(iou, 1.0 - 1e-10)
    truth = np.full(len(share), -1, np.int64)
    by_need = np.argsort(ignore, kind="stable")  # what is to be found comes first
    free = np.ones(share.shape[1], np.bool_)
    for k in np.flatnonzero((share >= least).any(axis=1)):
        best, most = -1, least
        for t in by_need:
            if best >= 0 and ignore[t] and not ignore[best]:
                break
            if (free[t] or regions[t]) and share[k, t] >= most:
                best, most = int(t), float(share[k, t])
        if best >= 0:
            free[best] = False
            truth[k] = best
    return truth
