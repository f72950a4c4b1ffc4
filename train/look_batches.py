"""Batches drawn from looks: what both networks that learn from looks share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from torch.utils.data import IterableDataset, get_worker_info

from train.looks import Look, read_look


class LookBatches(IterableDataset[Any]):
    """Endless batches from looks; each process draws others.

    Args:
        paths: Of looks.
        seed: Of everything that is drawn.
    """

    def __init__(self, paths: Sequence[Path], seed: int) -> None:
        super().__init__()
        self.paths = list(paths)
        self.seed = seed

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        rng = np.random.default_rng([self.seed, worker.id if worker else 0])
        return self.batches([read_look(path) for path in self.paths], rng)

    def batches(self, looks: Sequence[Look], rng: np.random.Generator) -> Iterator[Any]:
        """Yield batches without end.

        Args:
            looks: To draw from.
            rng: Draws everything.
        """
        raise NotImplementedError


def nobodies(looks: Sequence[Look]) -> list[tuple[int, int]]:
    """Return looks and candidates that are nobody.

    Args:
        looks: The looks.
    """
    return [(k, i) for k, one in enumerate(looks) for i in np.flatnonzero(one.whose == -1)]
