"""The flight in the package: a simulated summer forest with two people, one of them hidden."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hsvaos.flight import Flight
from hsvaos.formats.open import open_flight

FOLDER = Path(__file__).with_name("data") / "demo_flight"


def demo_flight() -> Flight:
    """Return the flight without its true poses, so that they come from its sensor log.

    Raises:
        FlightError: If the package was installed without its data.
    """
    flight = open_flight(FOLDER)
    frames = tuple(replace(frame, world_from_camera=None) for frame in flight.frames)
    return flight.replace(name="hsvaos demo", frames=frames)
