"""Clothes, skin and hair of many colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Outfit:
    """Colours of a person, linear RGB.

    Args:
        name: Plain name of the clothes.
        top: Jacket or shirt.
        bottom: Trousers.
        shoe: Shoes.
        skin: Skin.
        hair: Hair or hat.
        short_sleeves: Whether forearms show skin.
    """

    name: str
    top: Rgb
    bottom: Rgb
    shoe: Rgb
    skin: Rgb
    hair: Rgb
    short_sleeves: bool = False


_TOPS: dict[str, Rgb] = {
    "red": (0.42, 0.030, 0.028),
    "blue": (0.030, 0.075, 0.34),
    "orange": (0.60, 0.16, 0.015),
    "white": (0.62, 0.62, 0.60),
    "black": (0.018, 0.018, 0.020),
    "olive": (0.070, 0.078, 0.030),
    "dark green": (0.022, 0.050, 0.024),
    "yellow": (0.58, 0.44, 0.030),
    "purple": (0.16, 0.035, 0.22),
    "grey": (0.15, 0.15, 0.16),
    "brown": (0.11, 0.060, 0.030),
    "light blue": (0.22, 0.38, 0.58),
}
_BOTTOMS: tuple[Rgb, ...] = (
    (0.035, 0.060, 0.14),
    (0.020, 0.020, 0.022),
    (0.17, 0.13, 0.08),
    (0.060, 0.065, 0.035),
    (0.11, 0.11, 0.115),
    (0.05, 0.035, 0.025),
)
_SKINS: tuple[Rgb, ...] = (
    (0.56, 0.34, 0.24),
    (0.46, 0.26, 0.17),
    (0.32, 0.17, 0.10),
    (0.17, 0.085, 0.050),
    (0.085, 0.045, 0.028),
)
_HAIRS: tuple[Rgb, ...] = (
    (0.020, 0.015, 0.012),
    (0.060, 0.035, 0.020),
    (0.20, 0.13, 0.060),
    (0.30, 0.29, 0.28),
)
OUTFITS: tuple[str, ...] = tuple(_TOPS)
"""Names of the colours of tops."""


def dress(seed: list[int], top: str | None = None) -> Outfit:
    """Choose clothes, skin and hair.

    Args:
        seed: Of the choice.
        top: Colour of the top by name; any if None.

    Raises:
        ValueError: If there is no such colour.
    """
    rng = np.random.default_rng(seed)
    if top is not None and top not in _TOPS:
        raise ValueError(f"clothes must be one of {', '.join(_TOPS)}, got {top!r}")
    name = top if top is not None else str(rng.choice(list(_TOPS)))
    bottom = _BOTTOMS[int(rng.integers(len(_BOTTOMS)))]
    shoe = float(np.exp(rng.uniform(-4.2, -1.5)))
    return Outfit(
        name,
        _TOPS[name],
        bottom,
        (shoe, 0.9 * shoe, 0.8 * shoe),
        _SKINS[int(rng.integers(len(_SKINS)))],
        _HAIRS[int(rng.integers(len(_HAIRS)))],
        bool(rng.uniform() < 0.3),
    )
