"""Write a simulated flight: photo by photo into a workshop folder, then whole as a native flight.

The workshop `.NAME.simulating` lies beside the target. Every photo in it is complete (written
under a temporary name and renamed), with its ground truth beside it, so a run that was stopped by
Ctrl-C, a crash or a full disk continues where it was. The target folder appears at the end, whole.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import Flight, FlightError, Frame
from hsvaos.formats.native_write import write_native
from hsvaos.formats.poses import PosedName, write_poses_csv
from hsvaos.kernels.device import threads
from hsvaos.simulate.estimate import estimated_poses
from hsvaos.simulate.occlusion import label, mean_fraction
from hsvaos.simulate.settings import SimulationSettings
from hsvaos.simulate.simulation import MOUNTING, ORIGIN, Photo, Simulation

Progress = Callable[[int, int], None]
"""Called with photos done and photos in all."""

_MOST_WORKERS = 4


def simulate_flight(
    settings: SimulationSettings,
    folder: str | Path,
    *,
    device: str = "cpu",
    progress: Progress | None = None,
    simulation: Simulation | None = None,
) -> Path:
    """Simulate a flight and write it as a native flight folder with truth.json.

    Beside the format's own files it holds `poses_ekf.csv`, the poses as the package's error-state
    filter and smoother see them, and `truth_terrain.npz`, the true ground.

    Args:
        settings: What to simulate.
        folder: The new folder; it must not exist, or be empty.
        device: Warp device that draws.
        progress: Told how many photos are done.
        simulation: The simulation of these settings, if it was built before.

    Returns:
        The folder.

    Raises:
        ValueError: If the settings cannot be met.
        FlightError: If the folder cannot be used, or a workshop of other settings lies there.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FlightError(f"{folder}: expected a new or empty folder to write to")
    workshop = folder.with_name(f".{folder.name}.simulating")
    _check_workshop(workshop, settings)
    simulation = simulation or Simulation(settings, device)
    _open_workshop(workshop, settings)
    names = simulation.names()
    _take_photos(simulation, workshop, names, progress)
    counts = [json.loads((workshop / f"{name}.json").read_text())["people"] for name in names]
    flight = Flight(
        name=folder.name,
        camera=simulation.camera,
        frames=tuple(
            Frame(name, workshop / name, pose, float(t))
            for name, pose, t in zip(
                names, simulation.poses, simulation.flown.triggers_s, strict=True
            )
        ),
        origin=ORIGIN,
        ground_down_m=0.0,
        sensors={
            "body_from_camera_q": MOUNTING.body_from_camera_q,
            "camera_lever_arm_m": MOUNTING.camera_lever_arm,
            "antenna_lever_arm_m": MOUNTING.antenna_lever_arm,
        },
    )
    truth = _truth(simulation, counts)
    try:
        estimate = estimated_poses(simulation.log, settings.sensors, simulation.flown.triggers_s)
    except ValueError as error:
        # Outages or very short flights can leave a log that no filter can start on.
        estimate, truth["poses_ekf"] = None, f"none: {error}"
    write_native(flight, folder, logs=simulation.tables(), truth=truth)
    if estimate is not None:
        times = simulation.flown.triggers_s.tolist()
        rows = [PosedName(n, p, t) for n, p, t in zip(names, estimate, times, strict=True)]
        write_poses_csv(folder / "poses_ekf.csv", rows)
    _write_terrain(simulation, folder / "truth_terrain.npz")
    shutil.rmtree(workshop, ignore_errors=True)
    return folder


def _check_workshop(workshop: Path, settings: SimulationSettings) -> None:
    state = workshop / "settings.json"
    if state.exists() and state.read_text(encoding="utf-8") != settings.fingerprint():
        raise FlightError(
            f"{workshop}: an unfinished simulation of other settings lies here; repeat it with "
            "those settings, or remove the folder"
        )


def _open_workshop(workshop: Path, settings: SimulationSettings) -> None:
    try:
        workshop.mkdir(parents=True, exist_ok=True)
        _write_whole(workshop / "settings.json", settings.fingerprint().encode())
    except OSError as error:
        raise FlightError(f"{workshop}: cannot be written ({error})") from None


def _write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _encode(name: str, image: NDArray[np.uint8], quality: int) -> bytes:
    pixels = np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if quality else [cv2.IMWRITE_PNG_COMPRESSION, 4]
    done, data = cv2.imencode(Path(name).suffix, pixels, options)
    if not done:
        raise FlightError(f"{name}: cannot be encoded")
    return bytes(data.tobytes())


def _save(workshop: Path, name: str, photo: Photo, quality: int) -> None:
    try:
        _write_whole(workshop / name, _encode(name, photo.image, quality))
        # The truth comes last: a photo counts as taken when it is there.
        _write_whole(workshop / f"{name}.json", json.dumps({"people": photo.people}).encode())
    except OSError as error:
        raise FlightError(
            f"{workshop / name}: cannot be written ({error.strerror}); what is there is kept, and "
            "the same command continues"
        ) from None


def _take_photos(
    simulation: Simulation, workshop: Path, names: list[str], progress: Progress | None
) -> None:
    missing = [k for k, n in enumerate(names) if not (workshop / f"{n}.json").exists()]
    done = len(names) - len(missing)
    if progress is not None:
        progress(done, len(names))
    if not missing:
        return
    simulation.prepare()
    quality = simulation.settings.jpeg_quality

    def take(index: int) -> None:
        _save(workshop, names[index], simulation.photo(index), quality)

    workers = min(threads(), _MOST_WORKERS) if simulation.device == "cpu" else 1
    with ThreadPoolExecutor(workers) as pool:
        waiting: set[Future[None]] = {pool.submit(take, k) for k in missing}
        try:
            while waiting:
                finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in finished:
                    future.result()
                    done += 1
                if progress is not None:
                    progress(done, len(names))
        finally:
            # After an error or Ctrl-C only the photos in work are finished.
            pool.shutdown(wait=True, cancel_futures=True)


def people_truth(
    simulation: Simulation, counts: list[list[tuple[int, int]]]
) -> list[dict[str, Any]]:
    """Return the people's part of truth.json.

    Args:
        simulation: The flight.
        counts: For each photo and person (pixels shown, pixels without anything else).
    """
    people = []
    for k, person in enumerate(simulation.cast.people):
        visible = mean_fraction([tuple(photo[k]) for photo in counts])  # type: ignore[misc]
        middle = 0.5 * (person.outline.min(axis=0) + person.outline.max(axis=0))
        people.append(
            {
                "id": f"person_{person.number}",
                "north_m": round(float(middle[0]), 4),
                "east_m": round(float(middle[1]), 4),
                "down_m": round(float(person.place[2]), 4),
                "occlusion": None if visible is None else label(visible, simulation.cast.bush[k]),
                "asked": person.asked,
                "clothes": person.outfit.name,
                "outline_ned_m": np.round(person.outline, 4).tolist(),
                "visible_fraction_mean": None if visible is None else round(visible, 5),
            }
        )
    return people


def _truth(simulation: Simulation, counts: list[list[tuple[int, int]]]) -> dict[str, Any]:
    return {
        "people": people_truth(simulation, counts),
        "stakes": [
            {"id": f"stake_{k}", "north_m": n, "east_m": e, "down_m": d}
            for k, (n, e, d) in enumerate(np.round(simulation.stakes, 4).tolist())
        ],
        "pixels": {
            "columns": ["shown", "unoccluded"],
            "by_photo": counts,
        },
        "season": simulation.settings.forest.season,
        "stems": len(simulation.forest.stems),
        "settings": json.loads(simulation.settings.fingerprint()),
    }


def _write_terrain(simulation: Simulation, path: Path) -> None:
    """Write the true ground as north_m, east_m, down_m (`FocalTerrain.from_file` reads it)."""
    import io

    ground = simulation.forest.ground
    axis = -ground.half_m + ground.spacing_m * np.arange(len(ground.down_m))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, north_m=axis, east_m=axis, down_m=ground.down_m.astype(np.float32))
    _write_whole(path, buffer.getvalue())


def preview(simulation: Simulation, index: int) -> NDArray[np.uint8]:
    """Return one photo with the outlines of the people drawn in, shape (H, W, 3), RGB."""
    photo = simulation.photo(index)
    image = photo.image if photo.image.ndim == 3 else np.repeat(photo.image[..., None], 3, axis=2)
    image = np.ascontiguousarray(image)
    pose = simulation.poses[index]
    for k, person in enumerate(simulation.cast.people):
        pixels = simulation.camera.project((person.outline - pose[:3, 3]) @ pose[:3, :3])
        if not np.isfinite(pixels).all():
            continue
        shown, alone = photo.people[k]
        if alone == 0:
            continue
        cv2.polylines(
            image, [np.rint(pixels).astype(np.int32)], True, (255, 60, 200), 1, cv2.LINE_AA
        )
        text = f"{person.asked} {100.0 * shown / alone:.0f}%"
        place = (np.rint(pixels.max(axis=0)).astype(int) + 2).tolist()
        cv2.putText(
            image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 60, 200), 1, cv2.LINE_AA
        )
    return image
