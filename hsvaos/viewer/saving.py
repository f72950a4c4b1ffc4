"""What can be taken away from the viewer: settings, pictures and films, as contents of files."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from hsvaos.settings import Settings
from hsvaos.viewer.picture import Rgb
from hsvaos.viewer.request import Request
from hsvaos.viewer.session import Session

FILMS = ("mp4", "gif")

_FPS = 10


def settings_of(session: Session, request: Request) -> Settings:
    """Return the settings with which `hsvaos run` renders what a request shows, where it can.

    The view becomes that of the nearest photo. A centre of the aperture, a subset of the photos,
    and a shift of the relief that was found, have no settings; `settings_toml` says so.

    Args:
        session: The flight.
        request: What is shown.
    """
    base, focus = session.settings, request.focus
    if focus.terrain and session.start.terrain:
        table = {"down_m": None, "autofocus": False, "offset_m": focus.down_m}
        table |= {"pitch_deg": 0.0, "roll_deg": 0.0}
    elif focus.terrain:  # the relief that was found about the plane at the start
        start = session.start
        table = {"down_m": start.down_m, "autofocus": False, "relief": True, "offset_m": 0.0}
        table |= {"pitch_deg": start.pitch_deg, "roll_deg": start.roll_deg}
    else:
        table = {"down_m": focus.down_m, "terrain": None, "autofocus": False, "offset_m": 0.0}
        table |= {"relief": None}  # a plane that is named is kept
        table |= {"pitch_deg": focus.pitch_deg, "roll_deg": focus.roll_deg}
    frame = session.flight.frames[session.nearest(request.view)].name
    radius = request.aperture.radius_m if request.aperture.centre is None else None
    view = replace(base.view, frame=frame, aperture_m=radius)
    return replace(base.with_focus(table), mask=request.mask, view=view)


def settings_toml(session: Session, request: Request) -> str:
    """Return the settings of a request as TOML that `hsvaos run --settings` takes.

    What has no setting is written down as comments.
    """
    aperture, pose = request.aperture, request.view.world_from_camera
    lines = [f"# {session.flight.name}: seen in hsvaos view"]
    if aperture.centre is not None and aperture.radius_m is not None:
        north, east = aperture.centre
        lines.append(
            f"# photos within {aperture.radius_m:g} m of north {north:g} m, east {east:g} m: "
            f"hsvaos run has no centre of the aperture and takes all photos"
        )
    end = len(session.flight) - 1
    last = end if aperture.last is None else min(aperture.last, end)
    if (aperture.first, last, aperture.every) != (0, end, 1):
        lines.append(
            f"# photos {aperture.first} to {last}, every {aperture.every}: hsvaos run has "
            f"no such choice and takes all photos"
        )
    focus = request.focus
    if focus.terrain and not session.start.terrain and focus.down_m != 0.0:
        lines.append(
            f"# {focus.down_m:g} m below the relief of the ground: hsvaos run finds the relief, "
            f"and does not shift it"
        )
    numbers = ", ".join(f"{value:.4f}" for value in pose[:3].ravel())
    lines.append(f"# world_from_camera (3 x 4) = {numbers}")
    text = settings_of(session, request).to_toml()
    comments = "\n".join(re.sub(r"[\x00-\x1f\x7f-\x9f]", " ", line) for line in lines)
    return f"{comments}\n\n{text}"


def film(pictures: Sequence[Rgb], suffix: str) -> bytes:
    """Return pictures as a film.

    Args:
        pictures: Shape (H, W, 3), uint8, all of one size.
        suffix: "mp4" (MPEG-4, for video players) or "gif" (256 colours, for browsers and chats).

    Raises:
        ValueError: If the kind is not known, or this build of OpenCV cannot write it.
    """
    if suffix not in FILMS:
        raise ValueError(f"a film must be one of {', '.join(FILMS)}, got {suffix!r}")
    bgr = [np.ascontiguousarray(picture[..., ::-1]) for picture in pictures]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"film.{suffix}"
        good = _write_gif(path, bgr) if suffix == "gif" else _write_mp4(path, bgr)
        if not good or not path.is_file():
            other = next(kind for kind in FILMS if kind != suffix)
            raise ValueError(
                f"this OpenCV ({cv2.__version__}) writes no {suffix}: take {other}, or another "
                f"build of opencv-python-headless"
            )
        return path.read_bytes()


def _write_mp4(path: Path, pictures: list[Rgb]) -> bool:
    height, width = (side - side % 2 for side in pictures[0].shape[:2])  # what codecs take
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), code, _FPS, (width, height))
    try:
        if not writer.isOpened():
            return False
        for picture in pictures:
            writer.write(np.ascontiguousarray(picture[:height, :width]))
    finally:
        writer.release()
    return True


def _write_gif(path: Path, pictures: list[Rgb]) -> bool:
    if not hasattr(cv2, "Animation"):
        return False
    animation = cv2.Animation()
    animation.frames = pictures
    animation.durations = [1000 // _FPS] * len(pictures)
    try:
        return bool(cv2.imwriteanimation(str(path), animation))
    except cv2.error:
        return False
