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
    if "contender" not in metafunc.fixturenames:
        return
    import warp as wp

    races = dict(getattr(metafunc.module, "RACES", {}))
    params: list[Any] = []
    for race, make in getattr(metafunc.module, "GPU_RACES", {}).items():
        if wp.is_cuda_available():
            races[race] = make
        else:
            skip = pytest.mark.skip(reason="no CUDA device on this machine")
            params.append(pytest.param((race, ""), marks=skip, id=race))
    for race, make in races.items():
        params += [pytest.param((race, name), id=f"{race} | {name}") for name in make()]
    metafunc.parametrize("contender", params)


def bench_files() -> list[Any]:
    """Every module of this folder that defines races."""
    names = sorted(path.stem for path in Path(__file__).parent.glob("bench_*.py"))
    return [importlib.import_module(f"bench.{name}") for name in names]
