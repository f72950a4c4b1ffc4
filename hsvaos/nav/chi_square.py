"""Quantiles of the chi-square distribution: gates, and bounds of NIS and NEES."""

from __future__ import annotations

import math


def chi_square_cdf(x: float, dof: float) -> float:
    """Return the probability that a chi-square variable is below x.

    The regularised lower incomplete gamma function P(dof/2, x/2): its power series below the mean,
    the continued fraction of its complement above (Abramowitz & Stegun 6.5.29 and 6.5.31).
    """
    a, x = 0.5 * dof, 0.5 * x
    if x <= 0.0:
        return 0.0
    front = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        n = a
        while abs(term) > 1e-16 * abs(total):
            n += 1.0
            term *= x / n
            total += term
        return front * total
    # Lentz's evaluation of the continued fraction
    b = x + 1.0 - a
    c, d = 1e300, 1.0 / b
    fraction = d
    for i in range(1, 100_000):
        factor = -i * (i - a)
        b += 2.0
        d = 1.0 / (factor * d + b)
        c = b + factor / c
        fraction *= d * c
        if abs(d * c - 1.0) < 1e-15:
            break
    return 1.0 - front * fraction


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the value that a chi-square variable stays below with a probability.

    Args:
        probability: Between 0 and 1, both excluded.
        dof: Degrees of freedom, positive.

    Raises:
        ValueError: If an argument is out of its range.
    """
    if not (0.0 < probability < 1.0 and dof > 0.0):
        raise ValueError(
            f"expected a probability in (0, 1) and dof > 0, got {probability!r} and {dof!r}"
        )
    low, high = 0.0, dof + 10.0
    while chi_square_cdf(high, dof) < probability:
        high *= 2.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if chi_square_cdf(middle, dof) < probability:
            low = middle
        else:
            high = middle
        if high - low <= 1e-12 * high:
            break
    return 0.5 * (low + high)


def mean_bounds(probability: float, dof: float, count: float) -> tuple[float, float]:
    """Return where the mean of `count` independent chi-square variables of `dof` should lie.

    Args:
        probability: Two-sided coverage, 0.95 for the usual bounds.
        dof: Degrees of freedom of each.
        count: How many are averaged.
    """
    tail = 0.5 * (1.0 - probability)
    total = dof * count
    low = chi_square_quantile(tail, total) / count
    return low, chi_square_quantile(1.0 - tail, total) / count
