"""hsvaos: colour-aware airborne optical sectioning, the public names.

Nothing heavy is imported until a name is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hsvaos.camera import Camera as Camera
    from hsvaos.camera import VirtualCamera as VirtualCamera
    from hsvaos.detect.detections import Detections as Detections
    from hsvaos.detect.detections import Person as Person
    from hsvaos.detect.yolo import Detector as Detector
    from hsvaos.flight import Flight as Flight
    from hsvaos.flight import FlightError as FlightError
    from hsvaos.flight import Frame as Frame
    from hsvaos.flight import Origin as Origin
    from hsvaos.formats.open import open_flight as open_flight
    from hsvaos.kernels.anomaly import rx_masks as rx_masks
    from hsvaos.kernels.color import brighten as brighten
    from hsvaos.kernels.color import hsv_to_rgb as hsv_to_rgb
    from hsvaos.kernels.color import rgb_to_hsv as rgb_to_hsv
    from hsvaos.kernels.hue_mask import hue_masks as hue_masks
    from hsvaos.kernels.integrate import Integrator as Integrator
    from hsvaos.kernels.rarity import rarity_weights as rarity_weights
    from hsvaos.kernels.sweep import best_focus as best_focus
    from hsvaos.kernels.sweep import focus_measure as focus_measure
    from hsvaos.live.integrator import LiveIntegrator as LiveIntegrator
    from hsvaos.nav.error_state_ekf import ErrorStateEkf as ErrorStateEkf
    from hsvaos.nav.estimate import estimate_trajectory as estimate_trajectory
    from hsvaos.nav.online import OnlineFilter as OnlineFilter
    from hsvaos.nav.paper_ekf import PaperEkf as PaperEkf
    from hsvaos.nav.smoother import smooth as smooth
    from hsvaos.nav.trajectory import Trajectory as Trajectory
    from hsvaos.pipeline import run as run
    from hsvaos.result import Result as Result
    from hsvaos.settings import Settings as Settings
    from hsvaos.surface import FocalPlane as FocalPlane
    from hsvaos.surface import FocalTerrain as FocalTerrain

__version__ = "0.1.0"

_HOME = {
    "Integrator": "hsvaos.kernels.integrate",
    "LiveIntegrator": "hsvaos.live.integrator",
    "hue_masks": "hsvaos.kernels.hue_mask",
    "rarity_weights": "hsvaos.kernels.rarity",
    "rgb_to_hsv": "hsvaos.kernels.color",
    "hsv_to_rgb": "hsvaos.kernels.color",
    "brighten": "hsvaos.kernels.color",
    "rx_masks": "hsvaos.kernels.anomaly",
    "focus_measure": "hsvaos.kernels.sweep",
    "best_focus": "hsvaos.kernels.sweep",
    "Settings": "hsvaos.settings",
    "run": "hsvaos.pipeline",
    "Result": "hsvaos.result",
    "Detector": "hsvaos.detect.yolo",
    "Detections": "hsvaos.detect.detections",
    "Person": "hsvaos.detect.detections",
    "Camera": "hsvaos.camera",
    "VirtualCamera": "hsvaos.camera",
    "Flight": "hsvaos.flight",
    "FlightError": "hsvaos.flight",
    "Frame": "hsvaos.flight",
    "Origin": "hsvaos.flight",
    "open_flight": "hsvaos.formats.open",
    "ErrorStateEkf": "hsvaos.nav.error_state_ekf",
    "OnlineFilter": "hsvaos.nav.online",
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
