"""Where kernels run: devices, and launches in row bands on the threads of the CPU."""

import contextlib
import itertools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import warp as wp

PIXEL_GRAIN = 4096
"""Pixels below which a band is not worth a thread's wake-up."""

ROW_GRAIN = 32
"""The same for kernels whose elements are rows of pixels."""

_lock = threading.Lock()
_pool: ThreadPoolExecutor | None = None
_threads = 0
_here = threading.local()
_loaded: set[tuple[str, str]] = set()

on_slow_load: Callable[[], None] | None = None
"""Called where loading a kernel takes long: it is then being compiled, once, for the cache."""

_SLOW_S = 0.5


def resolve_device(device: Any = "cpu") -> Any:
    """Return the Warp device of that name.

    Args:
        device: "cpu", "cuda", "cuda:0", ... or a Warp device.

    Raises:
        ValueError: If the machine has no such device. There is no silent fallback.
    """
    try:
        return wp.get_device(device)
    except (RuntimeError, ValueError, TypeError) as error:
        names = ", ".join(d.alias for d in wp.get_devices())
        raise ValueError(f"device {device!r} is not on this machine, which has: {names}") from error


def quiet_start() -> None:
    """Start Warp without its banner and without the native warning on machines without CUDA.

    For command lines only: a library must not change a user's logging. The warning is written by
    native code straight to file descriptor 2, so that descriptor is turned away for the moment.
    """
    wp.config.log_level = wp.LOG_WARNING
    saved, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        wp.init()
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)


def in_vectors(device: Any) -> bool:
    """Whether a device runs the forms written in C for the vectors of a CPU.

    All others run the forms for every device. So does the CPU where HSVAOS_PORTABLE is 1 in the
    environment: slowly, on one thread, but just what CUDA would run.
    """
    return bool(device.is_cpu) and os.environ.get("HSVAOS_PORTABLE") != "1"


def free_memory() -> int | None:
    """Return the bytes that programs can still get, or None where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("MemAvail")) * 1024
    except (OSError, ValueError, IndexError, StopIteration):
        return None


def threads() -> int:
    """Return the number of CPU threads that kernels use."""
    if getattr(_here, "alone", False):
        return 1
    if _threads:
        return _threads
    asked = os.environ.get("HSVAOS_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


def set_threads(count: int) -> None:
    """Set the number of CPU threads that kernels use; 0 means one a core.

    Raises:
        ValueError: If count is negative.
    """
    global _threads, _pool
    if count < 0:
        raise ValueError(f"count must be 0 or more threads, got {count!r}")
    with _lock:
        _threads = count
        if _pool is not None:
            _pool.shutdown(wait=True)
        _pool = None


@contextlib.contextmanager
def on_one_thread() -> Iterator[None]:
    """Let what is launched from this thread meanwhile run in it, and on no other.

    For work beside other work: its bands would wait before those of the others.
    """
    before = getattr(_here, "alone", False)
    _here.alone = True
    try:
        yield
    finally:
        _here.alone = before


def bands(size: int, device: Any, grain: int = PIXEL_GRAIN) -> list[tuple[int, int]]:
    """Return (offset, length) of the parts of a 1-D launch: one on CUDA, one a thread on the CPU.

    Kernels that reduce keep one accumulator a band, because Warp's CPU atomics are plain adds.
    """
    count = max(1, min(threads(), size // grain)) if in_vectors(device) else 1
    edges = [size * i // count for i in range(count + 1)]
    return [(a, b - a) for a, b in itertools.pairwise(edges)]


def load(kernel: Any, device: Any) -> None:
    """Compile and load a kernel once, before threads would race for it."""
    key = (str(kernel.module.name) + kernel.key, device.alias)
    if key in _loaded:
        return
    with _lock:
        notice = threading.Timer(_SLOW_S, on_slow_load) if on_slow_load is not None else None
        if notice is not None:
            notice.daemon = True
            notice.start()
        wp.load_module(kernel.module, device=device, block_dim=1 if device.is_cpu else 256)
        _loaded.add(key)
        if notice is not None:
            notice.cancel()


def launch(
    kernel: Any, size: int, inputs: Sequence[Any], device: Any, grain: int = PIXEL_GRAIN
) -> None:
    """Launch a 1-D kernel whose first two arguments are `offset` and `band`.

    On the CPU Warp runs a launch on one thread and lets go of Python's lock meanwhile, so bands
    launched from a thread pool use all cores; results do not depend on their number, as long as
    no tile operations are used. This is the one place that relies on it.

    Args:
        kernel: Warp kernel; element number = wp.tid() + offset.
        size: Number of elements.
        inputs: Arguments after `offset` and `band`.
        device: Warp device.
        grain: Elements below which a band is not worth a thread.
    """
    global _pool
    if size == 0:
        return
    load(kernel, device)
    parts = bands(size, device, grain)

    def part(band: int) -> None:
        offset, length = parts[band]
        wp.launch(kernel, dim=length, inputs=[offset, band, *inputs], device=device)

    if len(parts) == 1:
        part(0)
        return
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(threads(), thread_name_prefix="hsvaos")
        pool = _pool
    for done in [pool.submit(part, band) for band in range(len(parts))]:
        done.result()
