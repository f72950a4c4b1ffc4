"""Photos found for the names in a pose file, and those left out that do not fit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from hsvaos.flight import FlightError, Frame
from hsvaos.formats.header import ImageHeader, is_image
from hsvaos.formats.images import image_header
from hsvaos.formats.poses import PosedName

SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp"}
_NAMED = 3
"""So many names a note gives before it only counts."""


def skipped_note(count: int, what: str, names: Sequence[str]) -> str:
    """Return a note on photos left out: their number, why, and the first names."""
    listed = ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
    return f"{count} photo{'s' if count != 1 else ''} left out: {what} ({listed})"


def images_in(folder: Path) -> list[Path]:
    """Return the image files of a folder, by name; empty where there is no such folder.

    Raises:
        FlightError: If the folder may not be listed.
    """
    if not folder.is_dir():
        return []
    try:
        paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
    except OSError as error:
        raise FlightError(f"{folder}: cannot be listed ({error.strerror})") from None
    return [path for path in paths if not path.name.startswith(".")]


def starts_like_image(path: Path) -> bool:
    """Whether a file begins like a JPEG, PNG or TIFF, whatever its name."""
    try:
        with path.open("rb") as file:
            return is_image(file.read(16))
    except OSError:
        return False


class PhotoFinder:
    """Finds the file that a pose file means, where extension or case differ too.

    Args:
        folders: Where to look, the first that has it wins.
    """

    def __init__(self, folders: Iterable[Path]) -> None:
        self.folders = list(folders)
        self._by_name: dict[str, Path] = {}
        self._by_stem: dict[str, list[Path]] = {}
        for folder in self.folders:
            stems: dict[str, list[Path]] = {}
            for path in images_in(folder):
                self._by_name.setdefault(path.name.lower(), path)
                stems.setdefault(path.stem.lower(), []).append(path)
            for stem, paths in stems.items():
                self._by_stem.setdefault(stem, paths)

    def find(self, name: str) -> Path | None:
        """Return the image file of a name, or None if there is none or more than one."""
        for folder in self.folders:
            path = folder / name
            if path.is_file():
                return path
        plain = Path(name.replace("\\", "/")).name
        if plain.lower() in self._by_name:
            return self._by_name[plain.lower()]
        # Only an image's extension is taken away: "a.b" is not another name of "a".
        stem = Path(plain).stem if Path(plain).suffix.lower() in SUFFIXES else plain
        candidates = self._by_stem.get(stem.lower(), [])
        return candidates[0] if len(candidates) == 1 else None


def select_frames(
    posed: Sequence[PosedName],
    finder: PhotoFinder,
    source: Path,
    *,
    camera_size: tuple[int, int] | None = None,
    masks: Mapping[str, Path] | None = None,
) -> tuple[tuple[Frame, ...], tuple[int, int], list[str]]:
    """Return the frames that can be used, the size of their photos, and notes on the others.

    Left out are names listed before, poses that cannot be used, photos that are absent or no
    images, and photos of another size or number of channels than `camera_size`, or than most.

    Args:
        posed: Names and poses.
        finder: Finds their files.
        source: The flight, for messages.
        camera_size: Width and height the camera was calibrated for, where known [px].
        masks: Masks of single photos by the stem of their name.

    Raises:
        FlightError: If no frame is left.
    """
    notes: list[str] = []
    reasons: list[str] = []

    def leave_out(what: str, names: Sequence[str], reason: str | None = None) -> None:
        if names:
            notes.append(skipped_note(len(names), what, names))
            reasons.append(reason or notes[-1])

    counts = Counter(entry.name for entry in posed)
    leave_out("listed more than once", [n for n, c in counts.items() for _ in range(c - 1)])
    first: dict[str, PosedName] = {}
    for entry in posed:
        first.setdefault(entry.name, entry)
    entries = list(first.values())
    bad = [entry for entry in entries if entry.problem]
    leave_out("pose not usable", [e.name for e in bad], bad[0].problem if bad else None)
    if bad:
        notes[-1] += f"; {bad[0].problem}"

    absent, broken, headers = [], [], {}
    paths: dict[str, Path] = {}
    problem = ""
    for entry in entries:
        if entry.problem:
            continue
        path = finder.find(entry.name)
        if path is None:
            absent.append(entry.name)
            continue
        try:
            headers[entry.name] = image_header(path)
            paths[entry.name] = path
        except FlightError as error:
            broken.append(entry.name)
            problem = problem or str(error)
    where = ", ".join(str(folder) for folder in finder.folders)
    leave_out(f"no such image in {where}", absent)
    leave_out("not a readable image", broken, problem)

    kept, size, odd = _of_one_kind(headers, camera_size)
    if odd and size is not None:
        shape = f"{size[0]} x {size[1]} px"
        like = "and kind like the others" if kept else f"like the camera, but {_sizes(headers)}"
        leave_out(f"not of {shape} {like}", odd)
    frames = tuple(
        Frame(
            entry.name,
            paths[entry.name],
            entry.world_from_camera,
            entry.t_s,
            (masks or {}).get(Path(entry.name).stem.lower()),
            entry.covariance,
        )
        for entry in entries
        if entry.name in kept
    )
    if not frames or size is None:
        raise FlightError(
            f"{source}: no photo can be used: {'; '.join(reasons) or 'the list of poses is empty'}"
        )
    return frames, size, notes


def _sizes(headers: Mapping[str, ImageHeader]) -> str:
    sizes = Counter(f"{h.width} x {h.height}" for h in headers.values())
    return ", ".join(size for size, _ in sizes.most_common(_NAMED))


def _of_one_kind(
    headers: Mapping[str, ImageHeader], camera_size: tuple[int, int] | None
) -> tuple[set[str], tuple[int, int] | None, list[str]]:
    """Return names of the kind that most have, its size, and the other names."""
    fitting = [h for h in headers.values() if camera_size is None or h[:2] == camera_size]
    if not fitting:
        return set(), camera_size, list(headers)
    most = Counter(fitting).most_common(1)[0][0]
    kept = {name for name, header in headers.items() if header == most}
    return kept, most[:2], [name for name in headers if name not in kept]
