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
    from hsvaos.nav.error_state_ekf import ErrorStateEkf as ErrorStateEkf
    from hsvaos.nav.estimate import estimate_trajectory as estimate_trajectory
    from hsvaos.nav.paper_ekf import PaperEkf as PaperEkf
    from hsvaos.nav.smoother import smooth as smooth
    from hsvaos.nav.trajectory import Trajectory as Trajectory
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
    "ErrorStateEkf": "hsvaos.nav.error_state_ekf",
    "PaperEkf": "hsvaos.nav.paper_ekf",
    "Trajectory": "hsvaos.nav.trajectory",
    "estimate_trajectory": "hsvaos.nav.estimate",
    "smooth": "hsvaos.nav.smoother",
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
