from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Any

import pytest

# One core for everyone: BLAS threads only spin on 15 x 15 matrices.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from hsvaos.kernels.device import quiet_start  # noqa: E402 - after the line above

quiet_start()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One benchmark a contender, for every race that a bench file defines."""
    if "contender" in metafunc.fixturenames:
        races = metafunc.module.RACES
        pairs = [(race, name) for race in races for name in races[race]()]
        metafunc.parametrize("contender", pairs, ids=[f"{r} | {n}" for r, n in pairs])


def bench_files() -> list[Any]:
    """Every module of this folder that defines races."""
    names = sorted(path.stem for path in Path(__file__).parent.glob("bench_*.py"))
    return [importlib.import_module(f"bench.{name}") for name in names]
