"""Tables of a benchmark for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from hsvaos.benchmark.compare import ratios
from hsvaos.benchmark.outcome import Outcome
from hsvaos.benchmark.roofline import ATTAINED


def machine_lines(outcome: Outcome) -> list[str]:
    """Return what machine it was and what its hardware can do at most.

    Args:
        outcome: What was measured.
    """
    machine, limits = outcome.machine, outcome.limits
    lines = [
        f"{machine.cpu}, {machine.cores} cores, {machine.threads} threads used, "
        f"{machine.memory_gib:.1f} GiB, {machine.system}",
        f"GPU: {machine.gpu}, {machine.gpu_memory_gib:.1f} GiB"
        if machine.gpu
        else f"GPU: none used, the kernels ran on {machine.device}",
        ", ".join(f"{name} {version}" for name, version in machine.versions.items()),
        f"limits measured here: large copy {limits.copy_gb_s:.1f} GB/s (read + written), "
        f"sampling {limits.samples_g_s:.2f} G samples/s (corners read from cache)",
    ]
    return lines


def stage_table(outcome: Outcome, budgets_hz: Sequence[float], other: Outcome | None) -> Table:
    """Return the table of the stages.

    Args:
        outcome: What was measured.
        budgets_hz: Rates to hold the stages against [Hz].
        other: Another benchmark to compare with; None for none.
    """
    table = Table(title="stages, median times", title_justify="left")
    table.add_column("stage")
    for name in ("ms", "a second", "share of limit"):
        table.add_column(name, justify="right")
    for hz in budgets_hz:
        table.add_column(f"{hz:g} Hz", justify="center")
    if other is not None:
        table.add_column("other / this", justify="right")
    times = {} if other is None else ratios(outcome, other)
    for stage in outcome.stages:
        share = f"{100 * stage.share:.0f} % {stage.limit}" if stage.limit else ""
        row = [stage.name, f"{stage.ms:.2f}", f"{stage.rate_hz:.1f} {stage.per}s", share]
        for hz in budgets_hz:
            row.append("[green]yes[/]" if stage.rate_hz >= hz else "[red]no[/]")
        if other is not None:
            ratio = times.get(stage.name)
            row.append("" if ratio is None else f"{ratio:.2f}")
        table.add_row(*row)
    return table


def estimate_table(outcome: Outcome) -> Table:
    """Return the table of what Jetson boards might need.

    Args:
        outcome: What was measured, with its estimates.
    """
    boards = list(dict.fromkeys(row.board for row in outcome.estimates))
    table = Table(
        title=f"ESTIMATE, nothing measured: ms on Jetson GPUs at {ATTAINED:.0%} of the roofline",
        title_justify="left",
    )
    table.add_column("stage")
    for board in boards:
        table.add_column(board, justify="right")
    for name in dict.fromkeys(row.stage for row in outcome.estimates):
        rows = {row.board: row for row in outcome.estimates if row.stage == name}
        table.add_row(name, *(f"{rows[b].ms:.2f} ({rows[b].bound})" for b in boards))
    return table
