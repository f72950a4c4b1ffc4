"""The pictures of every view of a flight, one file a view."""

from __future__ import annotations

from pathlib import Path

from hsvaos.report.atomic import check_writable, write_bytes
from hsvaos.report.draw import draw_boxes
from hsvaos.report.figures import encode, stretch
from hsvaos.result import ViewResult


class ViewWriter:
    """Writes `views/NAME.png`, the integral image with its finds, as views are rendered.

    Args:
        folder: Output folder of the run.

    Raises:
        FlightError: If the folder cannot be written to.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = check_writable(Path(folder) / "views")

    def __call__(self, view: ViewResult) -> None:
        """Write the picture of one view.

        Raises:
            OSError: If it cannot be written.
        """
        picture = draw_boxes(stretch(view.integral, view.footprint), view.detections)
        write_bytes(self.folder / f"{Path(view.frame).stem}.png", encode(picture))
