"""What the command line shows people: progress, notes and finds, on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console as Terminal
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from hsvaos.kernels import device

if TYPE_CHECKING:
    from hsvaos.result import Result

Step = Callable[[str, int, int], None]

_MOST_FINDS = 12


class Console:
    """Progress to stderr, outcomes to stdout; nothing at all where quiet.

    Args:
        quiet: For machines that read JSON.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self._err = Terminal(stderr=True, quiet=quiet)
        self._out = Terminal(quiet=quiet)
        device.quiet_start()
        device.on_slow_load = None if quiet else self._compiling
        self._told = False

    def _compiling(self) -> None:
        if not self._told:
            self._told = True
            self._err.print("compiling kernels for this machine (once, then cached) ...")

    @contextmanager
    def progress(self) -> Iterator[Step]:
        """Give a function (stage, done, total) that draws a bar a stage."""
        if not self._err.is_terminal:  # a file or a pipe: a line a stage
            yield self._lines()
            return
        with Progress(
            TextColumn("{task.description:32s}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=self._err,
            transient=True,
        ) as bars:
            tasks: dict[str, Any] = {}

            def step(stage: str, done: int, total: int) -> None:
                name, _, part = stage.partition(": ")
                if name not in tasks:
                    tasks[name] = bars.add_task(name, total=total)
                shown = f"{name}: {part}" if part and done < total else name
                bars.update(tasks[name], completed=done, total=total, description=shown)

            yield step

    def _lines(self) -> Step:
        seen: set[str] = set()

        def step(stage: str, done: int, total: int) -> None:
            name = stage.partition(": ")[0]
            if name not in seen:
                seen.add(name)
                self._err.print(f"{name} ...")

        return step

    @staticmethod
    def counted(items: Iterable[Any], stage: str, total: int, step: Step) -> Iterator[Any]:
        """Pass items through and tell of each."""
        for done, item in enumerate(items):
            step(stage, done, total)
            yield item
        step(stage, total, total)

    def notes(self, notes: Iterable[str]) -> None:
        """Print what the user should know."""
        for note in notes:
            self._err.print(
                f"note: {escape(note)}", style="yellow", highlight=False, soft_wrap=True
            )

    def say(self, text: str) -> None:
        """Print a line on how far the work is."""
        self._err.print(escape(text), highlight=False, soft_wrap=True)

    def show(self, *parts: Any) -> None:
        """Print an outcome: tables, or lines as they are."""
        for part in parts:
            shown = escape(part) if isinstance(part, str) else part
            self._out.print(shown, highlight=False, soft_wrap=isinstance(part, str))

    def result(self, result: Result, out: Path) -> None:
        """Print the finds of a run and where to look."""
        self.notes(result.notes)
        if result.detected:
            self._finds(result)
        stages = ", ".join(f"{name} {value:.1f}" for name, value in result.timings_s.items())
        self._out.print(f"{len(result.flight)} photos, seconds: {stages}", highlight=False)
        self._out.print(f"look at {out / 'report.html'}", highlight=False, soft_wrap=True)

    def _finds(self, result: Result) -> None:
        if not result.persons:
            self._out.print("no finds: nothing person-sized stands out by its colour")
            return
        table = Table(title=f"{len(result.persons)} finds, strongest first", title_justify="left")
        for name in ("score", "north m", "east m", "std m", "views", "latitude", "longitude"):
            table.add_column(name, justify="right")
        for p in result.persons[:_MOST_FINDS]:
            place = [f"{p.lat_deg:.7f}", f"{p.lon_deg:.7f}"] if p.lat_deg is not None else ["", ""]
            row = [p.score_text, f"{p.north_m:.2f}", f"{p.east_m:.2f}", f"{p.std_m:.2f}"]
            table.add_row(*row, str(p.views), *place)
        self._out.print(table)
        if len(result.persons) > _MOST_FINDS:
            self._out.print(f"... and {len(result.persons) - _MOST_FINDS} weaker, see the report")
