"""The outcome of a benchmark: measured stages on a machine, as values and as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hsvaos.benchmark.limits import Limits, measure, measure_limits
from hsvaos.benchmark.machine import Machine, available_memory, detect_machine
from hsvaos.benchmark.roofline import Estimate, estimates
from hsvaos.benchmark.stages import Sizes, Stage, stages

BUDGETS_HZ = (10.0, 15.0, 30.0)
FORMAT = "hsvaos bench 1"
PAPER = Sizes()

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Measured:
    """One stage, measured.

    Args:
        name: What it does.
        per: What one unit is.
        ms: Median of the rounds [ms a unit].
        best_ms: Least [ms a unit].
        rate_hz: Units a second, by the median.
        limit: What it is held against: "bandwidth", "sampling", or "" for neither.
        share: Share of that limit, by the median; 0 where there is none.
    """

    name: str
    per: str
    ms: float
    best_ms: float
    rate_hz: float
    limit: str
    share: float


@dataclass(frozen=True)
class Outcome:
    """What a benchmark found.

    Args:
        machine: Where it ran.
        limits: What that hardware can do at most.
        sizes: How large the work was.
        quick: Whether time was spared: fewer rounds.
        stages: The stages measured.
        skipped: Stages left out, and why, one line each.
        estimates: What Jetson boards might need: estimates.
    """

    machine: Machine
    limits: Limits
    sizes: Sizes
    quick: bool
    stages: tuple[Measured, ...]
    skipped: tuple[str, ...]
    estimates: tuple[Estimate, ...]

    def to_json(self, budgets_hz: Sequence[float] = BUDGETS_HZ) -> str:
        """Return everything as JSON, with the verdict on each budget.

        Args:
            budgets_hz: Rates that the stages are held against [Hz].
        """
        record = {"format": FORMAT} | asdict(self)
        for row in record["stages"]:
            row["within"] = {f"{hz:g}": row["rate_hz"] >= hz for hz in budgets_hz}
        return json.dumps(record, indent=2)


def read_outcome(path: str | Path) -> Outcome:
    """Read what an earlier benchmark found.

    Args:
        path: File that `hsvaos bench --json` or `-o` wrote.

    Raises:
        ValueError: If the file is no such thing; names the file.
        OSError: If it cannot be read.
    """
    text = Path(path).read_text(encoding="utf-8", errors="replace")
    try:
        record = json.loads(text)
        if record["format"] != FORMAT:
            raise ValueError(f"format {record['format']!r}")
        return Outcome(
            machine=_filled(Machine, record["machine"]),
            limits=_filled(Limits, record["limits"]),
            sizes=_filled(Sizes, record["sizes"]),
            quick=bool(record["quick"]),
            stages=tuple(_filled(Measured, row) for row in record["stages"]),
            skipped=tuple(map(str, record["skipped"])),
            estimates=tuple(_filled(Estimate, row) for row in record["estimates"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{path}: expected what `hsvaos bench -o FILE` writes ({FORMAT}), "
            f"got something else: {type(error).__name__}: {error}"
        ) from None


def _filled(kind: Any, record: dict[str, Any]) -> Any:
    """Dataclass from a record, whose numbers must be numbers; what is unknown is ignored."""
    values = {field.name: record[field.name] for field in fields(kind)}
    for field in fields(kind):
        numeric = field.type in ("float", "int")
        if numeric and not isinstance(values[field.name], int | float):
            raise TypeError(f"{field.name} must be a number, got {values[field.name]!r}")
    return kind(**values)


def run_benchmark(
    device: Any,
    *,
    quick: bool = False,
    sizes: Sizes | None = None,
    model: Path | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Measure the hardware's limits, and every stage.

    Args:
        device: Warp device on which the kernels run.
        quick: Spend less time on each stage.
        sizes: How large the work is; the paper's by default.
        model: ONNX network that looks for people; our own by default.
        progress: Told of every stage.
    """
    sizes = PAPER if sizes is None else sizes
    seconds = 0.2 if quick else 1.5
    tell = progress or (lambda stage, done, total: None)
    with TemporaryDirectory(prefix="hsvaos-bench-") as folder:
        listed = stages(sizes, device, Path(folder), model)
        steps = len(listed) + 1
        tell("measuring: memory and sampling limit", 0, steps)
        limits = measure_limits(device, seconds)
        measured: list[Measured] = []
        skipped: list[str] = []
        for done, stage in enumerate(listed, 1):
            tell(f"measuring: {stage.name}", done, steps)
            free = available_memory(device)
            if stage.memory > free:
                need, have = stage.memory / 2**30, free / 2**30
                skipped.append(f"{stage.name}: needs {need:.1f} GiB of memory, {have:.1f} are free")
                continue
            try:
                timing = measure(stage.make(), device, seconds, 2 if quick else 3)
            except ValueError as error:  # no network in this installation, or none that fits
                skipped.append(f"{stage.name}: {error}")
                continue
            measured.append(_measured(stage, timing.median_s, timing.best_s, limits))
        tell("measuring", steps, steps)
    machine = detect_machine(device)
    guesses = tuple(estimates(listed))
    return Outcome(machine, limits, sizes, quick, tuple(measured), tuple(skipped), guesses)


def _measured(stage: Stage, median_s: float, best_s: float, limits: Limits) -> Measured:
    limit, share = "", 0.0
    if stage.samples > 0.0:
        limit, share = "sampling", 1e-9 * stage.samples / median_s / limits.samples_g_s
    elif stage.moved > 0.0:
        limit, share = "bandwidth", 1e-9 * stage.moved / median_s / limits.copy_gb_s
    return Measured(
        name=stage.name,
        per=stage.per,
        ms=1e3 * median_s / stage.units,
        best_ms=1e3 * best_s / stage.units,
        rate_hz=stage.units / median_s,
        limit=limit,
        share=share,
    )
