from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import hsvaos
from hsvaos.demo import FOLDER
from hsvaos.formats.native_write import write_native
from hsvaos.settings import PhotoSettings, Settings
from hsvaos.viewer.live import Live
from hsvaos.viewer.request import Request
from hsvaos.viewer.session import Session

SMALL = Settings(photos=PhotoSettings(scale=0.25))


@pytest.fixture(scope="package")
def session() -> Session:
    """The demo flight with small photos."""
    return Session.open(hsvaos.open_flight(FOLDER), SMALL)


@pytest.fixture(scope="package")
def request_(session: Session) -> Request:
    """The view of the middle photo on the ground."""
    return Request(session.flight.view(session.flight.centre_index), session.start)


@pytest.fixture
def live(session: Session) -> Iterator[Live]:
    made = Live(session)
    yield made
    made.close()


@pytest.fixture(scope="package")
def grey(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Thermal photos: one channel."""
    return Session.open(_made(tmp_path_factory.mktemp("grey"), 3, colour=False))


def _made(folder: Path, count: int, colour: bool = True) -> hsvaos.Flight:
    """A flight over noise, without origin."""
    rng = np.random.default_rng(7)
    camera = hsvaos.Camera.from_fov(48, 40, 60.0)
    frames, photos = [], []
    for i in range(count):
        pose = np.eye(4)
        pose[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
        pose[:3, 3] = [0.5 * i, -0.5 * i, -20.0]
        frames.append(hsvaos.Frame(f"{i}.png", Path(f"{i}.png"), pose, float(i)))
        photos.append(rng.integers(0, 255, (40, 48, 3) if colour else (40, 48)).astype(np.uint8))
    flight = hsvaos.Flight("noise", camera, tuple(frames), ground_down_m=0.0)
    write_native(flight, folder / "flight", images=photos)
    return hsvaos.open_flight(folder / "flight")


@pytest.fixture(scope="package")
def lone(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """One photo only."""
    return Session.open(_made(tmp_path_factory.mktemp("lone"), 1))
