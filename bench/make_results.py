"""Run every race with its contenders taking turns and write `bench/RESULTS.md`.

    python -m bench.make_results [--rounds 7] [--without WORD ...] [--only WORD ...] [--print]

--without leaves contenders out by name (the NumPy twins take most of the time), --only runs only
the races with one of these words in their names, --print writes nothing.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench.conftest import bench_files
from bench.harness import Clock, Contenders, cpu_clock, race, wall_clock
from hsvaos.benchmark.machine import Machine, detect_machine
from hsvaos.kernels.device import resolve_device

RESULTS = Path(__file__).with_name("RESULTS.md")

KEPT = "<!-- What follows comes from the commands that it names. -->"
"""What stands below this line in the results is left as it is."""

NO_GPU = """No GPU was at hand: nothing of the CUDA path has been measured. Where there is one, the
command above runs these races too, by the wall clock and with the device synchronised: {races}.
`hsvaos bench --device cuda:0` tells the share of bandwidth and sampling limit, measured there."""

THERE = [
    "OpenCV's best form took 3.5 to 4.4 CPU milliseconds a photo of 1024 x 1024 where that was",
    "measured: its row of 117 photos tells how fast this machine is beside that one.",
    "",
]
"""What makes the figures of the table before it comparable."""

Medians = dict[str, float]


class Runner:
    """Runs races and remembers what could not be run."""

    def __init__(self, rounds: int, only: list[str], without: list[str]) -> None:
        self.rounds = rounds
        self.only = only
        self.without = without
        self.left_out: list[str] = []

    def __call__(
        self, races: dict[str, Callable[[], Contenders]], clock: Clock = cpu_clock
    ) -> Iterator[tuple[str, Medians]]:
        for name, make in races.items():
            if self.only and not any(word in name for word in self.only):
                continue
            sys.stderr.write(f"{name} ...\n")
            try:
                contenders = {
                    contender: work
                    for contender, work in make().items()
                    if not any(word in contender for word in self.without)
                }
                medians = race(contenders, self.rounds, clock)
            except ValueError as error:  # e.g. no network that fits
                self.left_out.append(f"{name}: {error}")
                sys.stderr.write(f"  left out: {error}\n")
                continue
            for contender, seconds in medians.items():
                sys.stderr.write(f"  {contender:45s} {1e3 * seconds:10.1f} ms\n")
            yield name, medians


def race_table(races: Iterator[tuple[str, Medians]], unit: str) -> list[str]:
    """Lines of a table: a row a contender."""
    lines = [f"| work | contender | {unit} | times hsvaos |", "| --- | --- | ---: | ---: |"]
    for name, medians in races:
        ours = next(iter(medians.values()))
        lines += [
            f"| {name} | {contender} | {1e3 * seconds:.1f} | {seconds / ours:.2f} |"
            for contender, seconds in medians.items()
        ]
    return [*lines, ""]


def growth_table(title: str, grown: dict[Any, Medians]) -> list[str]:
    """Lines of a table: a row a size, a column a contender."""
    names = list(next(iter(grown.values())))
    lines = [
        f"| {title} | {' | '.join(names)} | ratio |",
        f"| ---: |{' ---: |' * (len(names) + 1)}",
    ]
    for value, medians in grown.items():
        numbers = [medians[name] for name in names]
        cells = " | ".join(f"{1e3 * seconds:.1f}" for seconds in numbers)
        lines.append(f"| {value} | {cells} | {numbers[-1] / numbers[0]:.2f} |")
    return [*lines, ""]


def elsewhere_table(peer: str, printed: dict[str, Any], medians: dict[str, Medians]) -> list[str]:
    """Lines of a table beside a peer that cannot run here, by nanoseconds a sample."""
    lines = [
        f"| work | samples | hsvaos, ns a sample | {peer}, measured before | ratio |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for name, (samples, theirs_ms) in printed.items():
        if name in medians:
            ours = 1e9 * next(iter(medians[name].values())) / samples
            theirs = 1e6 * theirs_ms / samples
            lines.append(
                f"| {name} | {samples / 1e6:.1f} M | {ours:.1f} | {theirs:.1f} | "
                f"{theirs / ours:.1f} |"
            )
    return [*lines, "", *THERE] if len(lines) > 2 else []


def heading(machine: Machine, rounds: int, command: str) -> list[str]:
    """Where and how it was measured."""
    versions = ", ".join(f"{name} {version}" for name, version in machine.versions.items())
    return [
        "# Measured speed",
        "",
        f"{machine.cpu}, {machine.cores} cores, {machine.threads} threads for every contender; "
        f"{machine.memory_gib:.0f} GiB, {machine.system}; {versions}"
        + (f"; {machine.gpu}" if machine.gpu else "")
        + ".",
        "",
        f"CPU milliseconds of all threads (process time), medians of {rounds} rounds in which the "
        "contenders take turns; photos are 1024 x 1024 where nothing else is said. Read the "
        f"ratios: the machine was shared. Made by `{command}`.",
        "",
    ]


def measured(run: Runner) -> list[str]:
    """All tables."""
    modules = bench_files()
    races = {n: make for m in modules for n, make in getattr(m, "RACES", {}).items()}
    gpu_races = {n: make for m in modules for n, make in getattr(m, "GPU_RACES", {}).items()}
    scalings = {t: x for m in modules for t, x in getattr(m, "SCALINGS", {}).items()}
    elsewhere = {p: x for m in modules for p, x in getattr(m, "ELSEWHERE", {}).items()}
    growing = {name for by in scalings.values() for name in by.values()}
    medians = dict(run(races))
    alone = ((name, found) for name, found in medians.items() if name not in growing)
    lines = ["## Kernels on the CPU", "", *race_table(alone, "CPU ms")]
    lines += ["## How the cost grows", ""]
    for title, by in scalings.items():
        grown = {value: medians[name] for value, name in by.items() if name in medians}
        lines += growth_table(title, grown) if grown else []
    for peer, printed in elsewhere.items():
        lines += elsewhere_table(peer, printed, medians)
    lines += ["## On CUDA", ""]
    if any(device.is_cuda for device in _devices()):
        lines += race_table(run(gpu_races, wall_clock), "ms")
    else:
        lines += [NO_GPU.format(races="; ".join(gpu_races)), ""]
    if run.left_out:
        lines += ["Left out:", "", *(f"- {line}" for line in run.left_out), ""]
    return lines


def _devices() -> list[Any]:
    import warp as wp

    return list(wp.get_devices())


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD")
    parser.add_argument("--print", action="store_true")
    parser.add_argument("--without", nargs="*", default=[], metavar="WORD")
    asked = parser.parse_args()
    lines = measured(Runner(asked.rounds, asked.only, asked.without))
    if asked.print:
        sys.stdout.write("\n".join(lines))
        return
    gpu = next((device for device in _devices() if device.is_cuda), resolve_device("cpu"))
    command = f"python -m bench.make_results {shlex.join(sys.argv[1:])}".strip()
    lines = [*heading(detect_machine(gpu), asked.rounds, command), *lines]
    old = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else ""
    _, marker, rest = old.partition(KEPT)
    RESULTS.write_text("\n".join([*lines, ""]) + f"{marker}{rest}", "utf-8")


if __name__ == "__main__":
    main()
