from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

# The first example of a kernel test compiles the kernel: no deadline, and few examples each.
# Checks of a change must not hang on luck: there the examples are the same ones every time.
settings.register_profile("hsvaos", deadline=None, max_examples=20, derandomize="CI" in os.environ)
settings.load_profile("hsvaos")

SHARED = Path(__file__).parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def data() -> Callable[[str], Path]:
    """Path of a real data set by name; the test is skipped where it is not there."""

    def find(name: str) -> Path:
        path = SHARED / name
        if not path.exists():
            pytest.skip(f"real data not here: ../shared/data/{name}")
        return path

    return find


def _devices() -> list[str]:
    from hsvaos.kernels.device import quiet_start

    quiet_start()
    import warp as wp

    return [device.alias for device in wp.get_devices()]


@pytest.fixture(scope="session", params=_devices())
def device(request: pytest.FixtureRequest) -> str:
    """Run a kernel test on the CPU and, where there is one, on CUDA."""
    return str(request.param)
