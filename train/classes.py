"""People drawn by occlusion class, as often as a search has them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

CLASS_SHARES = {"bush": 0.25, "full": 0.1, "half": 0.45, "open": 0.2}
"""Of each occlusion class among people who are learnt from, as in a search: drawn evenly, three of
four would be half hidden, as they are the most in flights whose places are drawn blindly."""


class ByClass:
    """Who may be drawn: in which look, and which of its boxes.

    Attributes:
        found: Looks and boxes, by occlusion class; classes of nobody not.

    Args:
        people: Look, box and occlusion class of everybody.
    """

    def __init__(self, people: Iterable[tuple[int, int, str]]) -> None:
        found: dict[str, list[tuple[int, int]]] = {name: [] for name in CLASS_SHARES}
        for look, box, name in people:
            found[name].append((look, box))
        self.found = {name: own for name, own in found.items() if own}
        shares = np.array([CLASS_SHARES[name] for name in self.found])
        self._shares: NDArray[np.float64] = shares / shares.sum()

    def drawn(self, count: int, rng: np.random.Generator) -> list[tuple[int, int]]:
        """Return looks and boxes of some, with replacement; nobody where there is nobody.

        Args:
            count: How many.
            rng: Draws them.
        """
        if not self.found:
            return []
        names = rng.choice(list(self.found), count, p=self._shares)
        return [self.found[name][rng.integers(len(self.found[name]))] for name in names]
