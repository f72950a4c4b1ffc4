"""Run every race with its contenders taking turns and write `bench/RESULTS.md`.

python -m bench.make_results [--rounds 7]
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

from bench.conftest import bench_files
from bench.harness import race
from hsvaos import __version__
from hsvaos.kernels.device import threads

RESULTS = Path(__file__).with_name("RESULTS.md")

KEPT = "<!-- What follows comes from the commands that it names. -->"
"""What stands below this line in the results is left as it is."""


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        name = platform.processor()
    return f"{name}, {os.cpu_count()} cores"


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    names = ("warp-lang", "numpy", "opencv-python-headless")
    versions = ", ".join([f"hsvaos {__version__}", *(f"{name} {version(name)}" for name in names)])
    lines = [
        "# Measured speed",
        "",
        f"{processor()}; {threads()} threads for the kernels; Python {platform.python_version()}, "
        f"{versions}. No GPU was at hand: the CUDA path has not been measured.",
        "",
        f"Medians of {rounds} rounds in which the contenders take turns; photos are 1024 x 1024 "
        "where nothing else is said. Read the ratios: the machine was shared. Remake with "
        f"`python -m bench.make_results --rounds {rounds}`.",
        "",
        "| work | contender | ms | times hsvaos |",
        "| --- | --- | ---: | ---: |",
    ]
    for module in bench_files():
        for name, make in getattr(module, "RACES", {}).items():
            sys.stderr.write(f"{name} ...\n")
            medians = race(make(), rounds)
            ours = next(iter(medians.values()))
            lines += [
                f"| {name} | {contender} | {1e3 * seconds:.1f} | {seconds / ours:.2f} |"
                for contender, seconds in medians.items()
            ]
    old = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else ""
    _, marker, rest = old.partition(KEPT)
    RESULTS.write_text("\n".join(lines) + "\n" + (f"\n{marker}{rest}" if marker else ""), "utf-8")


if __name__ == "__main__":
    main()
