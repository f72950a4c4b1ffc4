"""The pictures of every view of a flight, one file a view."""

from __future__ import annotations

from pathlib import Path

from hsvaos.report.atomic import check_writable, write_bytes
from hsvaos.report.draw import draw_boxes
from hsvaos.report.figures import encode, stretch
from hsvaos.result import ViewResult

_LIST = "views.txt"
"""Names of the pictures that a run wrote: only these are removed by the next one."""


def remove_views(folder: str | Path) -> None:
    """Remove the pictures of views that an earlier run left in an output folder.

    Args:
        folder: Output folder of the run.

    Raises:
        OSError: If one cannot be removed.
    """
    listed = Path(folder) / "views" / _LIST
    if not listed.is_file():
        return
    for name in listed.read_text(encoding="utf-8").splitlines():
        if Path(name).name == name:
            (listed.parent / name).unlink(missing_ok=True)
    listed.unlink()
    if not any(listed.parent.iterdir()):
        listed.parent.rmdir()


class ViewWriter:
    """Writes `views/NAME.png`, the integral image with its finds, as views are rendered.

    Args:
        folder: Output folder of the run.

    Raises:
        FlightError: If the folder cannot be written to.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = check_writable(Path(folder) / "views")
        self._names: list[str] = []

    def __call__(self, view: ViewResult) -> None:
        """Write the picture of one view.

        Raises:
            OSError: If it cannot be written.
        """
        picture = draw_boxes(stretch(view.integral, view.footprint), view.detections)
        name = f"{Path(view.frame).stem}.png"
        self._names.append(name)
        write_bytes(self.folder / _LIST, "\n".join(self._names).encode("utf-8"))
        write_bytes(self.folder / name, encode(picture))
