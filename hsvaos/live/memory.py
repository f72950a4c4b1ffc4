"""Memory of this process."""

from __future__ import annotations

from pathlib import Path


def resident_mb() -> float:
    """Return the memory of this process that is in RAM [MB]; NaN where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return float("nan")
    return next(int(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmRSS"))
