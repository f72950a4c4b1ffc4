"""The command `hsvaos bench`: how fast this machine is at each stage."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from hsvaos.cli_options import Device, Json


def bench(
    budget: Annotated[
        list[float] | None,
        typer.Option(metavar="HZ", help="Rate to hold against; repeatable. (default: 10 15 30)"),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", help="Write the outcome as JSON.")
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(metavar="FILE.json", help="Outcome of another machine, to compare with."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer rounds, coarser figures.")] = False,
    model: Annotated[
        Path | None, typer.Option(metavar="FILE", help="ONNX network instead of the built-in one.")
    ] = None,
    device: Device = "cpu",
    as_json: Json = False,
) -> None:
    """Measure this machine at every stage, at the paper's sizes, against rates a drone needs."""
    from hsvaos.benchmark.compare import differences
    from hsvaos.benchmark.outcome import BUDGETS_HZ, read_outcome, run_benchmark
    from hsvaos.benchmark.tables import estimate_table, machine_lines, stage_table
    from hsvaos.console import Console
    from hsvaos.kernels.device import resolve_device
    from hsvaos.report.atomic import check_writable, write_bytes

    budgets = tuple(sorted(budget)) if budget else BUDGETS_HZ
    if not all(math.isfinite(hz) and hz > 0.0 for hz in budgets):
        raise ValueError(f"--budget must be a positive rate in Hz, got {budget}")
    other = None if compare is None else read_outcome(compare)
    if out is not None:
        check_writable(out.parent, (out.name,))
    console = Console(quiet=as_json)
    place = resolve_device(device)
    with console.progress() as progress:
        outcome = run_benchmark(place, quick=quick, model=model, progress=progress)
    text = outcome.to_json(budgets)
    if out is not None:
        write_bytes(out, text.encode("utf-8"))
    if as_json:
        typer.echo(text)
        return
    console.show(*machine_lines(outcome), stage_table(outcome, budgets, other))
    console.notes(f"left out: {line}" for line in outcome.skipped)
    if other is not None:
        changed = differences(outcome, other)
        console.show(f"compared with {compare}: " + ("differs in" if changed else "same machine"))
        console.show(*(f"  {line}" for line in changed))
    console.show(estimate_table(outcome))
    if out is not None:
        console.show(f"written to {out}")
