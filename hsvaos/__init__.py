"""hsvaos: colour-aware airborne optical sectioning, the public names.

Nothing heavy is imported until a name is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hsvaos.camera import Camera as Camera
    from hsvaos.camera import VirtualCamera as VirtualCamera
    from hsvaos.flight import Flight as Flight
    from hsvaos.flight import FlightError as FlightError
    from hsvaos.flight import Frame as Frame
    from hsvaos.flight import Origin as Origin
    from hsvaos.formats.open import open_flight as open_flight
    from hsvaos.surface import FocalPlane as FocalPlane
    from hsvaos.surface import FocalTerrain as FocalTerrain

__version__ = "0.1.0"

_HOME = {
    "Camera": "hsvaos.camera",
    "VirtualCamera": "hsvaos.camera",
    "Flight": "hsvaos.flight",
    "FlightError": "hsvaos.flight",
    "Frame": "hsvaos.flight",
    "Origin": "hsvaos.flight",
    "open_flight": "hsvaos.formats.open",
    "FocalPlane": "hsvaos.surface",
    "FocalTerrain": "hsvaos.surface",
}

__all__ = [*sorted(_HOME), "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'hsvaos' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
