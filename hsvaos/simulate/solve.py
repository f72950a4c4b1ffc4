"""Forests that reach a wanted canopy closure or a wanted visible share of the ground."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.simulate.forest import Forest, ForestSettings, grow_forest
from hsvaos.simulate.occlusion import closure, visibility_map
from hsvaos.simulate.scene import Scene

Array = NDArray[np.float64]


def _bisect(
    measure: Callable[[float], float], low: float, high: float, wanted: float, tolerance: float
) -> tuple[float, float] | None:
    """Return knob and value of a falling function within tolerance of wanted; None if outside."""
    at_low, at_high = measure(low), measure(high)
    if abs(at_low - wanted) <= tolerance:
        return low, at_low
    if abs(at_high - wanted) <= tolerance:
        return high, at_high
    if not at_high < wanted < at_low:
        return None
    best = (low, at_low)
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        value = measure(middle)
        if abs(value - wanted) < abs(best[1] - wanted):
            best = (middle, value)
        if abs(value - wanted) <= tolerance:
            break
        low, high = (middle, high) if value > wanted else (low, middle)
    return best


def _plain_scene(settings: ForestSettings, device: str) -> tuple[Forest, Scene]:
    forest = grow_forest(settings)
    return forest, forest.scene(device=device)


def solve_visible(
    settings: ForestSettings,
    wanted: float,
    camera: Camera,
    poses: Array,
    half_m: float,
    *,
    device: str = "cpu",
    tolerance: float = 0.01,
) -> tuple[ForestSettings, float]:
    """Change the leaf density until the photos see a wanted share of the ground.

    Args:
        settings: The forest; its leaf density is the knob.
        wanted: Mean visible fraction of the ground, between 0 and 1.
        camera: Of the photos.
        poses: Shape (N, 4, 4); 25 of them, evenly chosen, are looked at.
        half_m: Half the side of the square that counts [m].
        device: Warp device.
        tolerance: How near is near enough.

    Returns:
        The settings and the measured share.

    Raises:
        ValueError: If no leaf density reaches it.
    """
    if not 0.0 < wanted < 1.0:
        raise ValueError(f"visible must lie between 0 and 1, got {wanted!r}")
    some = poses[np.unique(np.linspace(0, len(poses) - 1, 25).round().astype(int))]

    def measure(leaf_density: float) -> float:
        _, scene = _plain_scene(settings.replace(leaf_density=leaf_density), device)
        return visibility_map(scene, camera, some, half_m).mean

    found = _bisect(measure, 0.1, 4.0, wanted, tolerance)
    if found is None or abs(found[1] - wanted) > 3.0 * tolerance:
        raise ValueError(
            f"a visible fraction of {wanted:g} cannot be reached with {settings.density:g} stems "
            f"a hectare: leaf densities from 0.1 to 4 give {measure(0.1):.3f} to "
            f"{measure(4.0):.3f}; change density or glades"
        )
    return settings.replace(leaf_density=found[0]), found[1]


def solve_closure(
    settings: ForestSettings,
    wanted: float,
    half_m: float,
    *,
    device: str = "cpu",
    tolerance: float = 0.01,
) -> tuple[ForestSettings, float]:
    """Change the number of stems until the canopy closes to a wanted share.

    Args:
        settings: The forest; its density is the knob.
        wanted: Canopy closure, between 0 and 1.
        half_m: Half the side of the square that counts [m].
        device: Warp device.
        tolerance: How near is near enough.

    Returns:
        The settings and the measured closure.

    Raises:
        ValueError: If no density reaches it.
    """
    if not 0.0 < wanted < 1.0:
        raise ValueError(f"closure must lie between 0 and 1, got {wanted!r}")

    def measure(density: float) -> float:
        _, scene = _plain_scene(settings.replace(density=density), device)
        return 1.0 - closure(scene, half_m)

    low, high = 20.0, 900.0
    found = _bisect(measure, low, high, 1.0 - wanted, tolerance)
    if found is None or abs(found[1] - (1.0 - wanted)) > 3.0 * tolerance:
        raise ValueError(
            f"a canopy closure of {wanted:g} cannot be reached: densities from {low:g} to {high:g} "
            f"stems a hectare give {1.0 - measure(low):.2f} to {1.0 - measure(high):.2f}; change "
            f"glades ({settings.glades:g})"
        )
    return settings.replace(density=found[0]), 1.0 - found[1]
