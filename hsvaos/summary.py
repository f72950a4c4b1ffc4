"""What a flight holds, and what this installation has."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import platform
import sys
from typing import Any

import numpy as np

from hsvaos.flight import Flight

EXTRAS = {
    "geo": ("rasterio", "pyproj"),
    "logs": ("pyulog", "pymavlink"),
    "plot": ("matplotlib",),
    "sim": ("mujoco",),
    "viewer": ("viser",),
    "train": ("torch", "onnx"),
}
"""Modules that each extra brings."""


def flight_summary(flight: Flight) -> dict[str, Any]:
    """Return what a flight holds, for people and machines.

    Args:
        flight: The flight.
    """
    camera = flight.camera
    lens = "with distortion" if camera.has_distortion else "no distortion"
    summary: dict[str, Any] = {
        "name": flight.name,
        "format": flight.format,
        "photos": len(flight),
        "camera": f"{camera.width} x {camera.height} px, {camera.fov_deg:.2f} deg, {lens}",
    }
    if flight.has_poses:
        places = flight.poses[:, :3, 3]
        spans = ", ".join(f"{side:.1f}" for side in np.ptp(places, axis=0))
        summary["extent"] = f"{spans} m north, east, down"
        summary["height"] = (
            f"cameras at down {places[:, 2].min():.1f} to {places[:, 2].max():.1f} m"
        )
        summary["centre frame"] = flight.frames[flight.centre_index].name
    else:
        summary["poses"] = "none: they come from the sensor log"
    origin = flight.origin
    summary["origin"] = (
        "none" if origin is None else f"{origin.lat_deg:.7f}, {origin.lon_deg:.7f} (WGS-84)"
    )
    ground = flight.ground_down_m
    summary["ground"] = "not known" if ground is None else f"down {ground:.2f} m"
    summary["terrain"] = "none" if flight.terrain is None else str(flight.terrain)
    summary["sensors"] = ", ".join(sorted(flight.sensors)) or "none"
    summary["notes"] = list(flight.notes)
    return summary


def doctor_summary() -> dict[str, dict[str, str]]:
    """Return versions, devices, kernel cache and what each extra lacks."""
    import warp as wp

    from hsvaos.kernels.device import threads

    versions = installed_versions()
    devices = {device.alias: str(device.name) for device in wp.get_devices()}
    devices["cpu"] = f"{platform.machine()}, {threads()} threads"
    extras = {}
    for extra, modules in EXTRAS.items():
        missing = [name for name in modules if importlib.util.find_spec(name) is None]
        lack = f"lacks {', '.join(missing)}: pip install 'hsvaos[{extra}]'"
        extras[extra] = lack if missing else "complete"
    return {
        "versions": versions,
        "devices": devices,
        "kernel cache": {"folder": str(wp.config.kernel_cache_dir)},
        "extras": extras,
    }


def installed_versions() -> dict[str, str]:
    """Return the versions of hsvaos, of Python and of what does the work."""
    from hsvaos import __version__

    versions = {"hsvaos": __version__, "python": sys.version.split()[0]}
    for name in ("warp-lang", "numpy", "opencv-python-headless", "onnxruntime", "typer"):
        versions[name] = _version(name)
    return versions


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
