from __future__ import annotations

from pathlib import Path

import pytest

from hsvaos.benchmark.stages import Sizes
from hsvaos.detect.network_input import CHANNELS
from tests.detect.nets import own_net

SMALL = Sizes(photo=96, flight=5, window=3, view=64, planes=2)


@pytest.fixture(scope="session")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small network of our own layout."""
    path = tmp_path_factory.mktemp("model") / "own.onnx"
    path.write_bytes(own_net([1.0] + [0.0] * (len(CHANNELS) - 1), -5.0))
    return path
