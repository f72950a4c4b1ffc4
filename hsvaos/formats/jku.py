"""Flights of Johannes Kepler University Linz (JKU-ICG/AOS): poses.json beside the photos."""

from __future__ import annotations

from pathlib import Path

from hsvaos.flight import Flight, FlightError
from hsvaos.formats.options import MASK_NOTE, NO_INTRINSICS, Options, camera_from_table
from hsvaos.formats.poses import is_jku, read_poses
from hsvaos.formats.select import PhotoFinder, select_frames
from hsvaos.formats.text import read_json, read_toml


def find_pose_lists(path: Path) -> list[Path]:
    """Return the files of JKU poses that a path names or holds.

    Raises:
        FlightError: If poses.json is there but malformed.
    """
    if path.is_file():
        candidates = [path] if path.suffix.lower() == ".json" else []
    else:
        candidates = sorted(path.glob("*.json"))
    found = []
    for candidate in candidates:
        try:
            if is_jku(read_json(candidate)):
                found.append(candidate)
        except FlightError:
            # Other JSON files may lie there; the one that must be right says what is wrong.
            if path.is_file() or candidate.name == "poses.json":
                raise
    return found


def recognise(path: Path, options: Options) -> bool:
    """Whether a folder, or a file, holds JKU poses."""
    return bool(find_pose_lists(path))


def read(path: Path, options: Options) -> Flight:
    """Read a flight of JKU's.

    Photos lie beside poses.json or in `images`; the camera comes from the caller or from [camera]
    of a flight.toml there; `mask.png` there is the user mask.

    Raises:
        FlightError: If it cannot be used.
    """
    lists = find_pose_lists(path)
    folder = path.parent if path.is_file() else path
    if options.poses is None and len(lists) > 1:
        lists = [p for p in lists if p.name == "poses.json"] or lists
        if len(lists) > 1:
            names = ", ".join(p.name for p in lists)
            raise FlightError(f"{path}: expected one pose list, got {names}: choose with --poses")
    return read_posed_photos(folder, options.poses or lists[0], options, path, "jku")


def read_posed_photos(
    folder: Path, pose_file: Path, options: Options, source: Path, name: str
) -> Flight:
    """Read photos in a folder whose poses are in a file, with no origin on the Earth.

    Args:
        folder: Where the photos lie, in itself or in `images`.
        pose_file: poses.csv or poses.json.
        options: What the caller said.
        source: What was opened.
        name: Name of the format.

    Raises:
        FlightError: If it cannot be used.
    """
    mask = options.mask
    notes: list[str] = []
    meshes = sorted(path.name for path in folder.glob("*.obj"))
    if meshes:
        notes.append(
            f"terrain mesh beside the photos, not used unless asked: --terrain {meshes[0]}"
        )
    if mask is None and (folder / "mask.png").is_file():
        mask = folder / "mask.png"
        notes.append(MASK_NOTE)
    described = folder / "flight.toml"
    table = read_toml(described).get("camera") if described.is_file() else None
    where = f"{described}: [camera]"
    if table is not None and not isinstance(table, dict):
        raise FlightError(f"{where} must be a table, got {table!r}")
    if not options.gives_camera and table is None:
        raise FlightError(f"{source}: camera without intrinsics: {NO_INTRINSICS}")
    camera = options.camera
    if camera is None and options.fov_deg is None and table is not None:
        camera = camera_from_table(table, where, None)
    frames, size, skipped = select_frames(
        read_poses(pose_file),
        PhotoFinder([folder, folder / "images"]),
        source,
        camera_size=(camera.width, camera.height) if camera else None,
    )
    if camera is None and not options.gives_camera and table is not None:
        camera = camera_from_table(table, where, size)
    return Flight(
        name=folder.resolve().name,
        camera=camera or options.camera_for(*size),
        frames=frames,
        ground_down_m=options.ground_down_m,
        mask=mask,
        source=source,
        format=name,
        notes=(*skipped, *notes),
    )
