"""What is known of a training flight."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def flight_truth(folder: Path) -> tuple[dict[str, Any], np.random.Generator]:
    """Return the truth of a flight, and what draws everything of its maps.

    Args:
        folder: The flight.
    """
    truth = json.loads((folder / "truth.json").read_text())
    return truth, np.random.default_rng([int(truth["settings"]["forest"]["seed"]), 302])


def outlines(truth: dict[str, Any]) -> list[NDArray[np.float64]]:
    """Return the outline of everyone, shape (K, 3), NED [m].

    Args:
        truth: Of a flight.
    """
    return [np.array(person["outline_ned_m"]) for person in truth["people"]]
