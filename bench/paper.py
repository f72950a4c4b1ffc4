"""The paper's experiment on unseen seeds: who is found, by which method, with which poses.

    python bench/paper_flights.py FLIGHTS          simulates the flights (see there)
    python bench/paper.py run FLIGHTS RESULTS      one JSON a flight and method; resumable
    python bench/paper.py poses FLIGHTS RESULTS    errors of the poses against the truth
    python bench/paper.py table RESULTS            bench/PAPER.md and its figures from what is there
    python bench/paper.py ablation RESULTS         its ablation alone, of the flights that have one
    python bench/paper.py persons RESULTS          what it says of persons alone

Every twelfth stored pose is a virtual camera, drawn at 5 cm a pixel, the sampling at which the
network looks anyway. A ground point shows the same from all of them, so more views are not more
evidence. For persons on the ground come as many more stored poses as it takes to see whom any
stored pose sees.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import hsvaos
from hsvaos.camera import VirtualCamera
from hsvaos.detect.anomaly import find_persons
from hsvaos.detect.detections import Detections
from hsvaos.detect.fragments import FragmentNet, PhotoEvidence
from hsvaos.detect.locate import ViewFinds, box_places, merge_views
from hsvaos.detect.surroundings import REACH_M, with_surroundings
from hsvaos.detect.yolo import PACKAGED, Detector
from hsvaos.evaluate.results import FlightResult, JudgedView
from hsvaos.evaluate.seen import ground_seen_ha
from hsvaos.evaluate.truth import TruthPerson, read_truth, truth_boxes
from hsvaos.finding import Scores
from hsvaos.flight import Flight
from hsvaos.formats.poses import read_poses
from hsvaos.ground_map import GroundMap, Layer, grid_for
from hsvaos.kernels.device import quiet_start
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.rays import focal_points
from hsvaos.masking import Masks, make_masks
from hsvaos.photos import Photos, load_photos
from hsvaos.relief.find import find_relief
from hsvaos.rendering import evidence_integrators, look_at_photos, make_integrators
from hsvaos.settings import DetectSettings, Settings, ViewSettings
from hsvaos.surface import FocalPlane, FocalSurface
from hsvaos.viewing import covering_poses

try:
    from paper_flights import FIRST_SEED  # run as a script
except ImportError:
    from bench.paper_flights import FIRST_SEED

STRIDE = 12
ABLATION_SEEDS = 2
"""Seeds on which the parts are taken away one by one, with true poses."""

GSD_M = 0.05
FLOOR = 0.02
"""Least score of a box: precision-recall curves need the weak ones too."""

COCO_WINDOW_PX = 160
"""Side of the windows that a network trained on COCO sees, enlarged to its own input."""

_IMAGES = ("plain", "hue")
"""Layers of the paper's own methods, which are measured on every flight."""

Layers = Mapping[str, Layer]


@dataclass(frozen=True)
class Method:
    """A way of finding people.

    Args:
        find: Called with the layers of a view; returns boxes down to weak ones.
        scores: From which a box is reported, and from which it counts for a person.
        tracks: Poses with which it is tried.
        everywhere: Whether on all seeds, or only on those of the ablation.
        wide: Whether it sees what lies around a view, as `hsvaos.run` shows it.
        relief: Whether it sees the ground where its relief was found, as `hsvaos.run` does, or on a
            plane.
    """

    find: Callable[[Layers], Detections]
    scores: Scores
    tracks: tuple[str, ...] = ("true",)
    everywhere: bool = False
    wide: bool = False
    relief: bool = False


@dataclass(frozen=True, eq=False)
class Measured:
    """What a method finds in a flight.

    Args:
        name: Of the flight.
        judged: The views that boxes are judged in.
        finds: Of these views and of those that are looked at for persons only, down to weak ones.
        people: The truth.
        area_ha: Ground that the photos see [ha].
    """

    name: str
    judged: tuple[JudgedView, ...]
    finds: tuple[ViewFinds, ...]
    people: tuple[TruthPerson, ...]
    area_ha: float

    def result(self, person_score: float) -> FlightResult:
        """Return the result, with the persons that a score makes.

        Args:
            person_score: From which a find counts for a person.
        """
        detect, kept = DetectSettings(), [one.above(person_score) for one in self.finds]
        persons = merge_views(kept, detect.person_m, person_score * detect.min_agreement, None)
        return FlightResult(self.name, self.judged, persons, self.people, self.area_ha)


def methods(coco: Path | None = None) -> dict[str, Method]:
    """Return all methods by name.

    Args:
        coco: A network trained on COCO, as ONNX; windows of half its input are enlarged for it,
            since people are 10 x 34 pixels here.
    """
    detector = Detector(score=FLOOR)
    own = Detector()
    score = Scores(own.score, own.person_score())
    twice = Scores(own.score, own.person_score(all_known=True))
    once = Detector(PACKAGED.read_bytes(), score=FLOOR)
    peaks = DetectSettings()

    def image(name: str) -> Callable[[Layers], Detections]:
        return lambda layers: detector.detect(layers[name][0], footprint=layers[name][1])

    def everything(
        *,
        rays: bool = True,
        rarity: bool = True,
        coherence: bool = True,
        fragments: bool = True,
        agreeing: bool = True,
        ground: bool = True,
        network: Detector = detector,
    ) -> Callable[[Layers], Detections]:
        def find(layers: Layers) -> Detections:
            rare, count = layers["rarity_map"]
            return network.detect(
                layers["rarity"][0],
                footprint=count if rays else None,
                rarity=rare[..., 0] if rarity else None,
                plain=layers["plain"][0],
                coherence=layers["coherence"] if coherence else None,
                fragments=layers["fragments"][0][..., 0] if fragments else None,
                fragment_coherence=layers["fragment_coherence"] if fragments and agreeing else None,
                ground=layers["ground"] if fragments and ground else None,
            )

        return find

    def of_peaks(name: str) -> Callable[[Layers], Detections]:
        low = replace(peaks, min_z=0.5 * peaks.min_z)
        return lambda layers: find_persons(layers[name][0][..., 0], layers[name][1], GSD_M, low)

    def of_coco() -> dict[str, Method]:
        network = Detector(coco, score=FLOOR, slice_px=COCO_WINDOW_PX)
        own = Detector(coco)
        score = Scores(own.score, own.person_score())

        def find(name: str) -> Callable[[Layers], Detections]:
            return lambda layers: network.detect(layers[name][0])

        return {
            "COCO network, AOS": Method(find("plain"), score),
            "COCO network, HSV-AOS": Method(find("hue"), score),
            "COCO network, ground": Method(find("ground"), score),
        }

    both = ("true", "ekf")
    return {
        "AOS": Method(image("plain"), score, both, True),
        "HSV-AOS": Method(image("hue"), score, both, True),
        "hsvaos": Method(everything(), twice, both, True, wide=True, relief=True),
        "hsvaos on a plane": Method(everything(), twice, wide=True),
        "all but surroundings": Method(everything(), twice, relief=True),
        "hue, not brightened": Method(image("hue_dark"), score),
        "ground image": Method(image("ground"), score),
        "rarity image": Method(image("rarity"), score),
        "rarity x hue image": Method(image("rarity_hue"), score),
        "one look": Method(everything(network=once), score, wide=True, relief=True),
        "all but rays": Method(everything(rays=False), score, wide=True, relief=True),
        "all but rarity map": Method(everything(rarity=False), score, wide=True, relief=True),
        "all but coherence": Method(everything(coherence=False), score, wide=True, relief=True),
        "all but fragments and ground": Method(
            everything(fragments=False), score, wide=True, relief=True
        ),
        "all but fragment colours": Method(
            everything(agreeing=False), score, wide=True, relief=True
        ),
        "all but ground": Method(everything(ground=False), score, wide=True, relief=True),
        "peaks of rarity": Method(of_peaks("rarity_map"), Scores(peaks.min_z, peaks.min_z)),
        "peaks of RX": Method(of_peaks("anomaly_map"), Scores(peaks.min_z, peaks.min_z)),
        **({} if coco is None else of_coco()),
    }


def integrators(
    photos: Photos, masks: Masks, evidence: PhotoEvidence, ablation: bool
) -> dict[str, Integrator]:
    """Return the integrators of a flight, by layer."""
    by = make_integrators(photos, masks, "hue")
    found = {"plain": by.plain, "rarity": by.rarity, "rarity_map": by.rarity_map}
    found |= evidence_integrators(photos, evidence, masks.gains)._asdict()
    if by.hue is not None:
        found["hue"] = by.hue
    if ablation and by.anomaly_map is not None:
        camera, poses = photos.flight.camera, photos.flight.poses
        product = masks.rarity.numpy() * (masks.hue.numpy() > 0)
        found |= {
            "hue_dark": Integrator(camera, photos.images, poses, masks.hue, gains=masks.gains),
            "rarity_hue": Integrator(camera, photos.images, poses, product, gains=masks.gains),
            "anomaly_map": by.anomaly_map,
        }
    return found


def measure(
    folder: Path, wanted: Mapping[str, Mapping[str, Method]], device: str = "cpu"
) -> Iterator[tuple[str, str, Measured]]:
    """Yield track, method and what was found by every method that is wanted with these poses."""
    true = hsvaos.open_flight(folder)
    photos = load_photos(true, device=device)
    ablation = any(not m.everywhere for methods in wanted.values() for m in methods.values())
    settings = Settings().with_values(mask={"statistics": "linear"}, detect={"method": "anomaly"})
    masks = make_masks(photos, settings)
    evidence = look_at_photos(photos, masks, FragmentNet())
    # nothing but the poses differs between the tracks
    by_name = integrators(photos, masks, evidence, ablation)
    for track, use in wanted.items():
        flight = posed(photos.flight, folder, track)
        plane = FocalPlane(flight.ground_down_m or 0.0)
        there = replace(photos, flight=flight)
        surfaces: dict[bool, FocalSurface] = {False: plane}
        if any(method.relief for method in use.values()):
            relief, _ = find_relief(there, evidence.ground, masks.gains, plane)
            surfaces[True] = relief or plane
        for name, found in _measure_track(true, flight, by_name, surfaces, use).items():
            yield track, name, found


def _measure_track(
    true: Flight,
    flight: Flight,
    by_name: dict[str, Integrator],
    surfaces: Mapping[bool, FocalSurface],
    use: Mapping[str, Method],
) -> dict[str, Measured]:
    """Return what every method finds with the poses of a flight.

    Args:
        true: The flight with its truth.
        flight: The flight with the poses to use.
        by_name: The integrators of all layers, whatever their poses.
        surfaces: By whether a method sees the relief.
        use: The methods.
    """
    people = read_truth(true)
    judged_poses = range(0, len(flight), STRIDE)
    chosen = [*judged_poses, *covering_poses(flight, surfaces[False], judged_poses)]
    side = round(flight.camera.width * _shrink(flight))
    small = flight.camera.without_distortion().scaled(side, side)
    views = [VirtualCamera(small, flight.poses[k]) for k in chosen]
    wanted = {method.relief: set(_IMAGES) for method in use.values()}
    for method in use.values():
        if method.wide or method.relief or not method.everywhere:
            wanted[method.relief] = {*by_name, "coherence", "fragment_coherence"}
    grounds = {
        which: _ground(flight, views, surfaces[which], by_name, names)
        for which, names in wanted.items()
    }
    area = ground_seen_ha(flight, surfaces[False])
    judged: dict[str, list[JudgedView]] = {name: [] for name in use}
    finds: dict[str, list[ViewFinds]] = {name: [] for name in use}
    for k, view in zip(chosen, views, strict=True):
        around = with_surroundings(view, GSD_M, REACH_M)
        truth = truth_boxes(people, view)
        for which, ground in grounds.items():
            device = by_name["plain"].device
            hits = focal_points(around.view, surfaces[which], device=device).numpy()
            hits = hits.reshape(around.view.height, around.view.width, 4)
            own_hits = around.cut(hits)
            seen = ground.seen_from(around.view, hits)
            cut = {name: (around.cut(a), around.cut(b)) for name, (a, b) in seen.items()}
            for name, method in use.items():
                if method.relief != which:
                    continue
                found = around.within(method.find(seen)) if method.wide else method.find(cut)
                if k in judged_poses:
                    judged[name].append(JudgedView(flight.frames[k].name, found, truth))
                finds[name].append(ViewFinds(view, found, *box_places(found, own_hits, view)))
    return {
        name: Measured(true.name, tuple(judged[name]), tuple(finds[name]), people, area)
        for name in use
    }


def _ground(
    flight: Flight,
    views: list[VirtualCamera],
    surface: FocalSurface,
    by_name: dict[str, Integrator],
    names: Collection[str],
) -> GroundMap:
    """Integrate the ground once, in every way that is named."""
    grid = grid_for(flight, views, surface, ViewSettings())
    if grid is None:
        raise RuntimeError(f"{flight.name}: no ground grid can stand for the views")
    layers: dict[str, Layer] = {}
    for name, integrator in by_name.items():
        if name == "pieces" or name not in names:
            continue
        image, footprint = integrator.at_poses(flight.poses).integrate(grid, surface)
        integrator.release()  # all of them packed take several times the photos
        layers[name] = (np.asarray(image.numpy()), np.asarray(footprint.numpy()))
    for name, of in (("coherence", "rarity"), ("fragment_coherence", "pieces")):
        if name not in names:
            continue
        agreed, coherence = by_name[of].at_poses(flight.poses).coherence(grid, surface)
        by_name[of].release()
        layers[name] = (np.asarray(agreed.numpy()), np.asarray(coherence.numpy()))
    return GroundMap(grid, layers)


def posed(flight: Flight, folder: Path, track: str) -> Flight:
    """Return the flight with true poses, or those of the package's filter and smoother."""
    if track == "true":
        return flight
    by_name = {row.name: row.world_from_camera for row in read_poses(folder / "poses_ekf.csv")}
    return flight.at_poses([by_name[frame.name] for frame in flight.frames])


def _shrink(flight: Flight) -> float:
    height = float(np.median(-flight.poses[:, 2, 3]))
    return min(1.0, height / flight.camera.fx / GSD_M)


def run(
    flights: Path,
    results: Path,
    part: int,
    parts: int,
    coco: Path | None,
    ablate: bool,
    only: Collection[str],
) -> None:
    """Measure what is missing."""
    results.mkdir(parents=True, exist_ok=True)
    known = {
        name: method
        for name, method in methods(coco).items()
        if (ablate or method.everywhere) and (not only or name in only)
    }
    folders = sorted(p for p in flights.iterdir() if (p / "truth.json").exists())
    folders.sort(key=lambda p: p.name.rsplit("_", 1)[::-1], reverse=True)  # all forests in turn
    ablated = tuple(f"_{seed}" for seed in range(FIRST_SEED, FIRST_SEED + ABLATION_SEEDS))
    for folder in folders[part::parts]:  # those of the ablation, which take longest, come last
        wanted: dict[str, dict[str, Method]] = {"true": {}, "ekf": {}}
        for name, method in known.items():
            if method.everywhere or folder.name.endswith(ablated):
                for track in method.tracks:
                    if not _file(results, folder.name, track, name).exists():
                        wanted[track][name] = method
        if any(wanted.values()):
            _measure_all(folder, wanted, results)


def _measure_all(folder: Path, wanted: dict[str, dict[str, Method]], results: Path) -> None:
    began = time.monotonic()
    for track, name, found in measure(folder, wanted):
        path = _file(results, folder.name, track, name)
        partial = path.with_suffix(".part")
        partial.write_text(found.result(wanted[track][name].scores.of_persons).to_json())
        partial.replace(path)
    count = sum(len(use) for use in wanted.values())
    print(f"{folder.name}, {count} results: {time.monotonic() - began:.0f} s", flush=True)


def _file(results: Path, flight: str, track: str, method: str) -> Path:
    return results / f"{flight}.{track}.{method.replace(' ', '_').replace(',', '')}.json"


def pose_errors(flights: Path, results: Path) -> None:
    """Write root-mean-square errors of all flights: horizontal, down [m]; attitude [deg]."""
    folders = sorted(p for p in flights.iterdir() if (p / "poses_ekf.csv").exists())
    figures: dict[str, list[float]] = {}
    for name, estimate in (
        ("error-state filter and smoother (poses_ekf.csv)", _smoothed),
        ("the paper's filter", _by_papers_filter),
    ):
        parts = []
        for number, folder in enumerate(folders, 1):
            flight = hsvaos.open_flight(folder)
            parts.append(_errors(estimate(flight, folder), flight.poses))
            print(f"{name}: {number} of {len(folders)}", flush=True)
        square = np.mean(np.concatenate(parts) ** 2, axis=0)
        figures[name] = [float(v) for v in np.sqrt([square[0] + square[1], *square[2:]])]
        (results / "poses.txt").write_text(json.dumps(figures, indent=1))
    print(json.dumps(figures, indent=1))


def _smoothed(flight: Flight, folder: Path) -> np.ndarray:
    return posed(flight, folder, "ekf").poses


def _by_papers_filter(flight: Flight, folder: Path) -> np.ndarray:
    times = np.array([frame.t_s for frame in flight.frames])
    return hsvaos.estimate_trajectory(flight, filter="paper").world_from_camera(times)


def _errors(have: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return errors of poses, shape (N, 6): north, east, down [m]; roll, pitch, yaw [deg]."""
    place = have[:, :3, 3] - true[:, :3, 3]
    turn = np.swapaxes(true[:, :3, :3], 1, 2) @ have[:, :3, :3]  # camera axes: x right, y back
    angles = np.degrees(
        np.stack(
            [
                0.5 * (turn[:, 1, 0] - turn[:, 0, 1]),  # about the view: yaw
                0.5 * (turn[:, 2, 1] - turn[:, 1, 2]),  # about the right: pitch
                0.5 * (turn[:, 0, 2] - turn[:, 2, 0]),  # about the back: roll
            ]
        )
    )
    return np.concatenate([place, angles[[2, 1, 0]].T], axis=1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run")
    running.add_argument("flights", type=Path)
    running.add_argument("results", type=Path)
    running.add_argument("--part", type=int, default=0)
    running.add_argument("--parts", type=int, default=1)
    running.add_argument("--no-ablation", action="store_true", help="only what every flight has")
    running.add_argument("--coco", type=Path, help="a network trained on COCO, for the ablation")
    running.add_argument("--only", action="append", help="a method; all by default")
    errors = commands.add_parser("poses")
    errors.add_argument("flights", type=Path)
    errors.add_argument("results", type=Path)
    for name in ("table", "rows", "ablation", "persons"):
        commands.add_parser(name).add_argument("results", type=Path)
    asked = parser.parse_args()
    if asked.command == "run":
        quiet_start()
        run(
            asked.flights,
            asked.results,
            asked.part,
            asked.parts,
            asked.coco,
            not asked.no_ablation,
            asked.only or (),
        )
    elif asked.command == "poses":
        pose_errors(asked.flights, asked.results)
    else:
        from paper_tables import write_ablation, write_page, write_persons, write_rows

        write = {
            "table": write_page,
            "rows": write_rows,
            "ablation": write_ablation,
            "persons": write_persons,
        }
        write[asked.command](asked.results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
