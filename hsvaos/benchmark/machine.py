"""What machine this is: processor, memory, GPU and versions."""

from __future__ import annotations

import os
import platform
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hsvaos.kernels.device import free_memory, threads
from hsvaos.summary import installed_versions

_GIB = 1024.0**3


@dataclass(frozen=True)
class Machine:
    """Hardware and versions, as far as they decide speed.

    Args:
        cpu: Name of the processor.
        cores: Cores that the operating system shows.
        threads: Threads that our kernels use.
        memory_gib: Main memory [GiB]; 0 where the system does not tell.
        device: Where the kernels ran: "cpu", "cuda:0", ...
        gpu: Name of that GPU; "" on the CPU.
        gpu_memory_gib: Its memory [GiB].
        system: Operating system and architecture.
        versions: Of Python, of hsvaos and of the packages that do the work.
    """

    cpu: str
    cores: int
    threads: int
    memory_gib: float
    device: str
    gpu: str
    gpu_memory_gib: float
    system: str
    versions: dict[str, str]


def detect_machine(device: Any) -> Machine:
    """Return what this machine is.

    Args:
        device: Warp device on which the kernels run.
    """
    return Machine(
        cpu=_processor(),
        cores=os.cpu_count() or 1,
        threads=threads(),
        memory_gib=round(_memory() / _GIB, 1),
        device=str(device.alias),
        gpu=str(device.name) if device.is_cuda else "",
        gpu_memory_gib=round(device.total_memory / _GIB, 1) if device.is_cuda else 0.0,
        system=f"{platform.system()} {platform.machine()}",
        versions=installed_versions(),
    )


def available_memory(device: Any) -> float:
    """Return the memory that is free on a device [bytes]; infinity where nobody tells.

    Args:
        device: Warp device.
    """
    if device.is_cuda:
        return float(device.free_memory)
    free = free_memory()
    return float("inf") if free is None else float(free)


def _processor() -> str:
    """Name of the processor, as Linux tells it on x86 and on Arm boards."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    for key in ("model name", "Model", "Hardware"):
        for line in lines:
            name, _, value = line.partition(":")
            if name.strip() == key and value.strip():
                return value.strip()
    try:  # Jetson and other boards name themselves in the device tree
        return Path("/proc/device-tree/model").read_text(encoding="utf-8").strip("\0 \n")
    except OSError:
        return platform.processor() or sys.platform


def _memory() -> float:
    """Main memory [bytes]; 0 where the system does not tell."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not a POSIX system
        return 0.0
