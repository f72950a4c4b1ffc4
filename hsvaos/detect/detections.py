"""What was found: boxes in a view, and persons on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes found in one view, strongest first.

    Args:
        boxes_xyxy: Shape (K, 4), float32, left, top, right, bottom [px], pixel centres at integers.
        scores: Shape (K,), float32; a probability for a network, a local z for peaks.
        class_ids: Shape (K,), int64; 0 is a person.

    Raises:
        ValueError: If the lengths differ.
    """

    boxes_xyxy: NDArray[np.float32]
    scores: NDArray[np.float32]
    class_ids: NDArray[np.int64]

    def __post_init__(self) -> None:
        count = len(self.scores)
        if self.boxes_xyxy.shape != (count, 4) or len(self.class_ids) != count:
            raise ValueError(
                f"expected boxes (K, 4) and K scores and class ids, got {self.boxes_xyxy.shape}, "
                f"{count} and {len(self.class_ids)}"
            )

    def __len__(self) -> int:
        return len(self.scores)

    def above(self, score: float) -> Detections:
        """Return those that score at least so much."""
        kept = self.scores >= score
        return Detections(self.boxes_xyxy[kept], self.scores[kept], self.class_ids[kept])

    @classmethod
    def none(cls) -> Detections:
        """Return no detections."""
        return cls(
            np.zeros((0, 4), np.float32), np.zeros(0, np.float32), np.zeros(0, dtype=np.int64)
        )


@dataclass(frozen=True)
class Person:
    """One find on the ground, merged over the views that show it.

    Args:
        north_m: World NED [m].
        east_m: World NED [m].
        down_m: World NED [m].
        lat_deg: WGS-84 latitude [deg], None where the flight has no origin.
        lon_deg: WGS-84 longitude [deg], None where the flight has no origin.
        std_m: Horizontal standard deviation of the place, one axis [m].
        score: Mean of the best score in each view that holds the place, 0 where none was found.
        views: Number of views that show it.
        covariance_m2: Of the place, north and east [m^2]; None where it is not known. std_m is the
            root of half its trace.
    """

    north_m: float
    east_m: float
    down_m: float
    lat_deg: float | None
    lon_deg: float | None
    std_m: float
    score: float
    views: int
    covariance_m2: tuple[tuple[float, float], tuple[float, float]] | None = None

    @property
    def score_text(self) -> str:
        """The score as people read it: a probability in hundredths, a local z in tenths."""
        return f"{self.score:.2f}" if self.score < 1.0 else f"{self.score:.1f}"
