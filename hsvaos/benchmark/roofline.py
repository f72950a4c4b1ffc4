"""What a Jetson Orin might need, from bytes and operations: an estimate, nothing measured.

A kernel cannot be faster than its bytes over the bandwidth, or its operations over the arithmetic
(Williams, Waterman, Patterson 2009, "Roofline"). Figures of the boards: NVIDIA, "Jetson AGX Orin
Series" technical brief v1.2 and data sheets of the Jetson Orin Nano (8 GB) and of its Super mode;
arithmetic = CUDA cores x 2 (fused multiply-add) x clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hsvaos.benchmark.stages import Stage

ATTAINED = 0.6
"""Share of the roof that the estimate takes for granted: what a good kernel reaches."""


@dataclass(frozen=True)
class Board:
    """Published figures of a board.

    Args:
        name: What it is called.
        bandwidth_gb_s: Of its memory [GB/s].
        cores: CUDA cores.
        clock_ghz: Greatest clock of the GPU [GHz].
    """

    name: str
    bandwidth_gb_s: float
    cores: int
    clock_ghz: float

    @property
    def tflops(self) -> float:
        """Arithmetic in single precision [1e12/s]."""
        return 2e-3 * self.cores * self.clock_ghz


BOARDS = (
    Board("Orin Nano 8 GB", 68.0, 1024, 0.625),
    Board("Orin Nano 8 GB, Super", 102.0, 1024, 1.02),
    Board("AGX Orin 64 GB", 204.8, 2048, 1.3),
)


@dataclass(frozen=True)
class Estimate:
    """Estimated time of a stage on a board.

    Args:
        stage: Its name.
        board: Its name.
        ms: Milliseconds a unit, at `ATTAINED` of the roof.
        bound: What holds it up: "memory" or "arithmetic".
    """

    stage: str
    board: str
    ms: float
    bound: str


def estimates(stages: Sequence[Stage], boards: Sequence[Board] = BOARDS) -> list[Estimate]:
    """Return estimates of all stages whose operations are counted.

    Args:
        stages: The stages.
        boards: The boards.
    """
    found = []
    for stage in stages:
        for board in boards:
            if stage.operations <= 0.0:
                continue
            memory = stage.moved / (1e9 * board.bandwidth_gb_s)
            arithmetic = stage.operations / (1e12 * board.tflops)
            seconds = max(memory, arithmetic) / ATTAINED / stage.units
            bound = "memory" if memory >= arithmetic else "arithmetic"
            found.append(Estimate(stage.name, board.name, 1e3 * seconds, bound))
    return found
