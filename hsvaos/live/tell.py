"""What people are told of a live flight: a line now and then, a table at the end."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from hsvaos.detect.detections import Person
from hsvaos.live.integrator import LiveIntegrator
from hsvaos.live.memory import resident_mb
from hsvaos.live.play import Player


def line(live: LiveIntegrator) -> str:
    """Return how it goes, in one line; latencies are those since the last one."""
    stats, recent = live.stats(), live.recent_latency()
    parts = [f"{stats.integrated} photos, {len(live.window)} in the window"]
    if recent["count"]:
        times = " ".join(f"{recent[f'p{q}_ms']:.0f}" for q in (50, 95, 99))
        parts.append(f"latency p50 p95 p99 {times} ms")
    parts.append(f"dropped {stats.dropped}")
    if stats.without_pose:
        parts.append(f"without pose {stats.without_pose}")
    if stats.detected:
        parts.append(f"looked at {stats.detected}")
    persons = live.persons()
    if persons:
        parts.append(f"{len(persons)} found")
    return ", ".join(parts)


def summary(live: LiveIntegrator, player: Player) -> tuple[Table, str]:
    """Return the table that ends a flight, and a line on lateness and memory."""
    stats = live.stats()
    title = (
        f"{stats.arrived} photos came, {stats.integrated} integrated, {stats.dropped} dropped"
        + (f", {stats.without_pose} without pose" if stats.without_pose else "")
    )
    table = Table(title=title, title_justify="left")
    for name in ("", "count", "p50 ms", "p95 ms", "p99 ms", "max ms"):
        table.add_column(name, justify="right" if name else "left")
    rows = {"photo to picture": stats.latency, "of it work": stats.work}
    if stats.detected:
        rows["looking for people"] = stats.detection
    for name, times in rows.items():
        values = [times[key] for key in ("p50_ms", "p95_ms", "p99_ms", "max_ms")]
        table.add_row(name, str(times["count"]), *("" if v is None else f"{v:.1f}" for v in values))
    rest = (
        f"photos came up to {1e3 * player.behind_s:.0f} ms late to the queue; memory "
        f"{resident_mb():.0f} MB, {live.window.nbytes / 1e6:.0f} MB of it the window"
    )
    return table, rest


def persons_table(persons: Sequence[Person]) -> Table:
    """Return who was found, likeliest first."""
    table = Table(title=f"{len(persons)} found on the ground", title_justify="left")
    for name in ("", "score", "north m", "east m", "within m", "latitude", "longitude", "searches"):
        table.add_column(name, justify="right")
    for number, one in enumerate(persons, start=1):
        place = ("", "")
        if one.lat_deg is not None and one.lon_deg is not None:
            place = (f"{one.lat_deg:.6f}", f"{one.lon_deg:.6f}")
        metres = (f"{value:.1f}" for value in (one.north_m, one.east_m, one.std_m))
        table.add_row(str(number), f"{one.score:.2f}", *metres, *place, str(one.views))
    return table
