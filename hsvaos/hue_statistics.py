"""Mean and spread of a hue histogram, circular or linear, and whether hue says anything at all."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

BINS = 1440
"""Bins of a hue histogram: a quarter of a degree each."""

MIN_CHROMA = 0.03
"""Mean of saturation x value below which an image counts as grey: its hue is sensor noise.

Thermal images have exactly 0; dull, dark conifer photos measured 0.05, a meadow in the sun 0.18."""

MAX_HALF_WIDTH_DEG = 120.0
"""Half width of a circular cut above which it would take two thirds of the colour circle."""


@dataclass(frozen=True)
class HueStatistics:
    """What a hue histogram says.

    Args:
        mean_deg: Mean hue [deg], [0, 360).
        sigma_deg: Standard deviation of hue [deg].
        chroma: Mean of saturation x value over the valid pixels, 0..1.
        statistics: "circular" or "linear".
        sigmas: Half width of the cut in sigmas.
        informative: Whether hue separates anything; if not, every pixel is kept.
        reason: Why hue says nothing; empty where it does.
        within: Share of the histogram's weight inside mean +- sigmas sigma, 0..1.
    """

    mean_deg: float
    sigma_deg: float
    chroma: float
    statistics: str
    sigmas: float
    informative: bool
    reason: str
    within: float

    @property
    def half_width_deg(self) -> float:
        """Half width of the cut [deg]; half a bin is added, to which the mean is known."""
        return self.sigmas * self.sigma_deg + 180.0 / BINS

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as a dictionary for JSON."""
        return asdict(self)


def hue_statistics(
    histogram: ArrayLike, chroma: float, *, statistics: str = "circular", sigmas: float = 2.0
) -> HueStatistics:
    """Return mean and standard deviation of a hue histogram.

    Circular: mean = arg(sum w e^(i h)), sigma = sqrt(-2 ln R) with R the length of the mean vector
    (Mardia and Jupp, Directional Statistics, 2000, eq. 2.3.9). Linear, as in the paper: the plain
    mean and standard deviation of hue on [0, 360).

    Hue says nothing where the mean chroma (saturation x value) is below MIN_CHROMA, or where the
    cut of +- sigmas sigma is wider than +- MAX_HALF_WIDTH_DEG (circular) or takes all of [0, 360)
    (linear).

    Args:
        histogram: Shape (B,), weight of each of B equal bins over [0, 360) degrees.
        chroma: Mean of saturation x value over the pixels, 0..1.
        statistics: "circular" or "linear".
        sigmas: Half width of the cut in sigmas.

    Raises:
        ValueError: If the name of the statistics is not known or sigmas is not positive.
    """
    check_statistics(statistics, sigmas)
    weights = np.asarray(histogram, dtype=np.float64)
    centres = (np.arange(weights.size) + 0.5) * (360.0 / weights.size)
    total = weights.sum()
    if total <= 0.0:
        return HueStatistics(
            0.0, 0.0, chroma, statistics, sigmas, False, "no pixel has a colour", 0.0
        )
    if statistics == "circular":
        vector = (weights * np.exp(1j * np.radians(centres))).sum() / total
        mean = float(np.degrees(np.angle(vector)) % 360.0)
        length = min(abs(vector), 1.0)
        sigma = float(np.degrees(np.sqrt(-2.0 * np.log(max(length, 1e-300)))))
        distance = np.abs((centres - mean + 180.0) % 360.0 - 180.0)
    else:
        mean = float((weights * centres).sum() / total)
        sigma = float(np.sqrt((weights * (centres - mean) ** 2).sum() / total))
        distance = np.abs(centres - mean)
    within = float(weights[distance <= sigmas * sigma + 180.0 / weights.size].sum() / total)
    reason = ""
    if chroma < MIN_CHROMA:
        reason = f"mean chroma {chroma:.3f} is below {MIN_CHROMA} (grey images)"
    elif _takes_all(mean, sigmas * sigma, statistics):
        reason = (
            f"hue is spread too far (sigma {sigma:.0f} deg): a cut of {sigmas:g} sigma would take "
            f"most of the colour circle"
        )
    return HueStatistics(mean, sigma, chroma, statistics, sigmas, not reason, reason, within)


def _takes_all(mean: float, half_width: float, statistics: str) -> bool:
    if statistics == "circular":
        return half_width > MAX_HALF_WIDTH_DEG
    return mean - half_width <= 0.0 and mean + half_width >= 360.0


def check_statistics(statistics: str, sigmas: float) -> None:
    """Raise ValueError where the parameters of a hue cut make no sense."""
    if statistics not in ("circular", "linear"):
        raise ValueError(f'statistics must be "circular" or "linear", got {statistics!r}')
    if not (np.isfinite(sigmas) and sigmas > 0.0):
        raise ValueError(f"sigmas must be a positive number, got {sigmas!r}")
