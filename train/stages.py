"""Parts of the recipes that many processes share: flights and their maps."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from hsvaos.detect.fragments import FragmentNet
from hsvaos.kernels.device import quiet_start
from train.flights import FIRST_TUNING_SEED, make_flight
from train.maps import CONDITIONS, SEARCH_CONDITIONS, make_maps


def flight_stage(flights: Path, seed: int) -> str:
    """Simulate a flight, if it is not there; return its name.

    Args:
        flights: Folder.
        seed: Of the flight.
    """
    quiet_start()
    return make_flight(seed, flights).name


def maps_stage(flights: Path, maps: Path, nets: list[Path], seed: int) -> str:
    """Integrate a flight in all conditions, if that was not done; return its name.

    Args:
        flights: Folder of the flights.
        maps: Folder of the maps.
        nets: Networks of fragments; the seed's remainder says which.
        seed: Of the flight.
    """
    quiet_start()
    flight, search = flights / f"flight_{seed}", seed >= FIRST_TUNING_SEED
    count = SEARCH_CONDITIONS if search else CONDITIONS
    done = [maps / f"{flight.name}_{k}.npz" for k in range(count)]
    if not all(path.exists() for path in done):
        net = FragmentNet(nets[seed % len(nets)], threads=1)
        make_maps(flight, maps, search=search, fragments=net)
    return flight.name


def each(what: str, make: Callable[[int], str], seeds: Sequence[int], workers: int) -> None:
    """Do a part for all seeds, and tell how far it is.

    Args:
        what: Its name.
        make: Does it for a seed, returns a name.
        seeds: Of the flights.
        workers: Processes.
    """
    with ProcessPoolExecutor(workers) as pool:
        began = time.monotonic()
        for number, name in enumerate(pool.map(make, seeds)):
            past = time.monotonic() - began
            print(f"{what} [{number + 1}/{len(seeds)}] {name}, {past:.0f} s", flush=True)


def seeds_of(maps: Path) -> str:
    """Return the seeds of maps, as ranges.

    Args:
        maps: Their folder.
    """
    seeds = sorted({int(path.stem.split("_")[1]) for path in maps.glob("*_0.npz")})
    jumps = np.flatnonzero(np.diff(seeds) != 1)
    starts = [seeds[0], *(seeds[k + 1] for k in jumps)]
    ends = [*(seeds[k] for k in jumps), seeds[-1]]
    return ", ".join(f"{a}-{b}" for a, b in zip(starts, ends, strict=True))
