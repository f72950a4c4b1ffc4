"""Two benchmarks side by side: ratios of the times, and what differs between the machines."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from hsvaos.benchmark.outcome import Outcome


def ratios(ours: Outcome, other: Outcome) -> dict[str, float]:
    """Return how many times as long each stage takes there as here; above 1 we are faster.

    Args:
        ours: What was measured here.
        other: What was measured elsewhere, or before. Stages that it lacks are left out.
    """
    theirs = {stage.name: stage.ms for stage in other.stages}
    return {
        stage.name: theirs[stage.name] / stage.ms
        for stage in ours.stages
        if stage.name in theirs and stage.ms > 0.0
    }


def differences(ours: Outcome, other: Outcome) -> list[str]:
    """Return what differs in hardware, versions and work, one line each.

    Args:
        ours: What was measured here.
        other: What was measured elsewhere, or before.
    """
    here, there = _facts(ours), _facts(other)
    lines = [
        f"{name}: {here.get(name) or 'none'} (other: {there.get(name) or 'none'})"
        for name in {**here, **there}
        if here.get(name) != there.get(name)
    ]
    if ours.sizes != other.sizes:
        lines.append("sizes of the work: the ratios mean nothing")
    if ours.quick != other.quick:
        lines.append("rounds: one of the two was quick")
    return lines


def _facts(outcome: Outcome) -> dict[str, Any]:
    """Hardware and versions by name."""
    record = asdict(outcome.machine)
    versions: dict[str, Any] = record.pop("versions")
    return {name.replace("_", " "): value for name, value in record.items()} | versions
