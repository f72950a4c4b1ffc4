"""Measure what the paper's hue mask does on simulated flights; resumable.

    python bench/simulate_effect.py run --seeds 5        one JSON a flight in bench/simulation/
    python bench/simulate_effect.py classes --seeds 5    only lays the people: occlusion classes
    python bench/simulate_effect.py table                bench/SIMULATION.md from what is there

A flight: the default forest, 117 photos of 512 x 512 (90 deg, 20 m), eight people, two of each
occlusion class. Contrast of a person: distance of the mean colours (root of the mean square over
R, G, B) inside the body's outline from above and in a ring 0.4 to 1.4 m around it, in grey levels;
contrast to noise: the same by the ring's standard deviation (root mean square over channels).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.kernels.device import quiet_start
from hsvaos.kernels.hue_mask import hue_masks
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.rarity import rarity_weights
from hsvaos.simulate.estimate import estimated_poses
from hsvaos.simulate.forest import ForestSettings, grow_forest
from hsvaos.simulate.instances import Kind
from hsvaos.simulate.mission import Mission
from hsvaos.simulate.occlusion import CLASSES as RANGES
from hsvaos.simulate.occlusion import label, mean_fraction
from hsvaos.simulate.people import Person
from hsvaos.simulate.placement import place_people
from hsvaos.simulate.seasons import SEASONS
from hsvaos.simulate.settings import SimulationSettings
from hsvaos.simulate.simulation import Simulation
from hsvaos.surface import FocalPlane

FOLDER = Path(__file__).parent / "simulation"
GSD_M = 0.04
CLASSES = ("full", "half", "bush", "open")


def person_regions(person: Person) -> tuple[VirtualCamera, np.ndarray, np.ndarray]:
    """Return the view straight down on a person, its body's pixels and the ring's."""
    middle = 0.5 * (person.outline.min(axis=0) + person.outline.max(axis=0))[:2]
    half = 2.8
    size = round(2 * half / GSD_M) + 1
    view = VirtualCamera.ortho(middle[0] + half, middle[1] - half, GSD_M, size, size)
    mesh = person.mesh
    body = np.zeros((size, size), dtype=np.uint8)
    corners = np.stack([mesh.corner, mesh.corner + mesh.side_a, mesh.corner + mesh.side_b], 1)
    pixels = view.project(corners.astype(float) + person.place)
    for triangle in np.rint(pixels).astype(np.int32):
        cv2.fillConvexPoly(body, triangle, 1)
    away = cv2.distanceTransform(1 - body, cv2.DIST_L2, 5) * GSD_M
    return view, body > 0, (away > 0.4) & (away < 1.4)


def contrast(
    image: np.ndarray, footprint: np.ndarray, body: np.ndarray, ring: np.ndarray
) -> tuple[float, float] | None:
    """Return contrast [grey levels] and contrast to noise, or None where nothing was seen."""
    seen = footprint > 0
    inside, around = image[body & seen], image[ring & seen]
    if len(inside) < 0.2 * body.sum() or len(around) < 0.2 * ring.sum():
        return None
    difference = inside.mean(axis=0) - around.mean(axis=0)
    strength = float(np.sqrt(np.mean(difference**2)))
    noise = float(np.sqrt(np.mean(around.var(axis=0))))
    return strength, strength / max(noise, 1e-6)


def removed_shares(masks: np.ndarray, kinds: np.ndarray) -> dict[str, float]:
    groups = {
        "leaf": (Kind.TREE, Kind.BUSH),
        "ground": (Kind.GROUND, Kind.LITTER, Kind.WOOD),
        "person": (Kind.PERSON,),
    }
    shares = {}
    for name, members in groups.items():
        which = np.isin(kinds, [int(k) for k in members])
        shares[name] = float(np.mean(masks[which] == 0)) if which.any() else float("nan")
    return shares


def pose_errors(have: np.ndarray, want: np.ndarray) -> dict[str, float]:
    """Return root-mean-square errors of poses: horizontal and vertical [m], attitude [deg]."""
    off = have[:, :3, 3] - want[:, :3, 3]
    turn = np.swapaxes(want[:, :3, :3], 1, 2) @ have[:, :3, :3]
    angle = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    return {
        "horizontal_m": float(np.sqrt(np.mean(off[:, 0] ** 2 + off[:, 1] ** 2))),
        "vertical_m": float(np.sqrt(np.mean(off[:, 2] ** 2))),
        "attitude_deg": float(np.sqrt(np.mean(angle**2))),
    }


def measure(season: str, seed: int, size: int, photos: int) -> dict[str, object]:
    started = time.process_time()
    simulation = Simulation(
        SimulationSettings(
            forest=ForestSettings(season=season, seed=seed),
            mission=Mission(photos=photos),
            camera=Camera.from_fov(size, size, 90.0),
            people=8,
            classes=None,
        )
    )
    simulation.prepare()
    built = time.process_time() - started
    count = len(simulation.poses)
    images = np.empty((count, size, size, 3), dtype=np.uint8)
    kinds = np.empty((count, size, size), dtype=np.uint8)
    pixels = []
    for k in range(count):
        photo = simulation.photo(k)
        images[k], kinds[k] = photo.image, photo.kind
        pixels.append(photo.people)
    taken = time.process_time() - started - built
    masks, stats = hue_masks(images)
    linear_masks, linear = hue_masks(images, statistics="linear")
    weights, _ = rarity_weights(images)
    tracks = {"true": simulation.poses}
    tracks["ekf"] = estimated_poses(
        simulation.log, simulation.settings.sensors, simulation.flown.triggers_s
    )
    result: dict[str, object] = {
        "season": season,
        "seed": seed,
        "size": size,
        "photos": count,
        "stems": len(simulation.forest.stems),
        "hue": {
            "mean_deg": [s.mean_deg for s in stats],
            "sigma_deg": [s.sigma_deg for s in stats],
            "within": [s.within for s in stats],
            "informative": [s.informative for s in stats],
            "linear_mean_deg": [s.mean_deg for s in linear],
            "linear_sigma_deg": [s.sigma_deg for s in linear],
            "linear_within": [s.within for s in linear],
        },
        "removed": removed_shares(masks, kinds),
        "removed_linear": removed_shares(linear_masks, kinds),
        "ekf_error": pose_errors(tracks["ekf"], tracks["true"]),
        "kinds": {
            "leaf": float(np.isin(kinds, [int(Kind.TREE), int(Kind.BUSH)]).mean()),
            "person": float((kinds == int(Kind.PERSON)).mean()),
        },
    }
    people = []
    for k, person in enumerate(simulation.cast.people):
        shown = mean_fraction([p[k] for p in pixels])
        if shown is None:
            continue
        view, body, ring = person_regions(person)
        plane = FocalPlane(float(person.place[2]) - 0.1)
        entry: dict[str, object] = {
            "asked": person.asked,
            "class": label(shown, simulation.cast.bush[k]),
            "visible": shown,
            "clothes": person.outfit.name,
        }
        for track, poses in tracks.items():
            nearest = int(
                np.argmin(np.linalg.norm(poses[:, :2, 3] - person.outline[:, :2].mean(0), axis=1))
            )
            for name, use, frames in (
                ("single", None, [nearest]),
                ("plain", None, None),
                ("masked", masks, None),
                ("rarity", weights, None),
            ):
                integrator = Integrator(simulation.camera, images, poses, weights=use)
                picture, footprint = integrator.integrate(view, plane, frames=frames)
                entry[f"{name}_{track}"] = contrast(
                    np.asarray(picture), np.asarray(footprint), body, ring
                )
        people.append(entry)
    result["people"] = people
    result["cpu_s"] = {"scene": built, "photos": taken, "all": time.process_time() - started}
    return result


def run(seeds: int, size: int, photos: int) -> None:
    FOLDER.mkdir(exist_ok=True)
    for seed in range(seeds):
        for season in SEASONS:
            path = FOLDER / f"{season}_{seed}.json"
            if path.exists():
                continue
            result = measure(season, seed, size, photos)
            part = path.with_suffix(".part")
            part.write_text(json.dumps(result, indent=1))
            part.replace(path)
            print(path.name, json.dumps(result["cpu_s"]), flush=True)


def classes(seeds: int, size: int, photos: int) -> None:
    folder = FOLDER / "classes"
    folder.mkdir(parents=True, exist_ok=True)
    for seed in range(seeds):
        for season in SEASONS:
            path = folder / f"{season}_{seed}.json"
            if path.exists():
                continue
            settings = SimulationSettings(
                forest=ForestSettings(season=season, seed=seed),
                mission=Mission(photos=photos),
                camera=Camera.from_fov(size, size, 90.0),
            ).fitted()
            started = time.process_time()
            forest = grow_forest(settings.forest)
            mission = settings.mission
            cast = place_people(forest, settings.camera, mission.poses(), mission.half_m, 8)
            people = [
                {"asked": p.asked, "class": label(v, b), "visible": v}
                for p, v, b in zip(cast.people, cast.visible, cast.bush, strict=True)
            ]
            spent = time.process_time() - started
            path.write_text(json.dumps({"season": season, "people": people, "cpu_s": spent}))
            print(path.name, f"{spent:.0f} CPU s", flush=True)


def _cell(values: list[float], digits: int = 1) -> str:
    values = [v for v in values if np.isfinite(v)]
    if not values:
        return "-"
    return f"{np.mean(values):.{digits}f} ± {np.std(values):.{digits}f}"


def table() -> str:
    flights = [json.loads(p.read_text()) for p in sorted(FOLDER.glob("*.json"))]
    lines = [
        "# What the hue mask does on simulated flights",
        "",
        "Made by `python bench/simulate_effect.py run` and `... table`. Every number is measured,",
        f"on flights over the default forest: {flights[0]['photos']} photos of "
        f"{flights[0]['size']} x {flights[0]['size']}, 90 deg,",
        "from 20 m, eight people, two of each occlusion class. ± is the standard deviation over",
        "flights (first three tables) or over people.",
        "",
        "Contrast: distance of the mean colours inside the body's outline and in a ring 0.4 to",
        "1.4 m around it, root mean square over R, G, B, in grey levels; contrast to noise: that",
        "by the deviation of the ring. In the single photo (the one nearest overhead) of a person",
        "who is hidden the outline holds leaves: what stands there is the unevenness of the",
        "canopy, not the person. A mask that leaves few samples raises contrast and noise alike.",
        "The flights of one seed are flown alike in all seasons, so the errors of the poses are",
        "the same in all rows.",
        "",
        "## Hue of the photos, 2 sigma",
        "",
        "Circular statistics are weighted by saturation x value, linear ones are the paper's.",
        "`cut` is the share of the photos in which hue says anything and the circular mask cuts.",
        "",
        "| season | flights | mean [deg] | sigma [deg] | within | cut | linear mean "
        "| linear sigma | linear within |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for season in SEASONS:
        own = [f for f in flights if f["season"] == season]
        hues = [f["hue"] for f in own]
        means = [
            float(np.degrees(np.angle(np.mean(np.exp(1j * np.radians(h["mean_deg"]))))) % 360)
            for h in hues
        ]
        lines.append(
            f"| {season} | {len(own)} | {_cell(means, 0)} "
            f"| {_cell([float(np.mean(h['sigma_deg'])) for h in hues], 0)} "
            f"| {_cell([float(np.mean(h['within'])) for h in hues], 3)} "
            f"| {_cell([float(np.mean(h['informative'])) for h in hues], 2)} "
            f"| {_cell([float(np.mean(h['linear_mean_deg'])) for h in hues], 0)} "
            f"| {_cell([float(np.mean(h['linear_sigma_deg'])) for h in hues], 0)} "
            f"| {_cell([float(np.mean(h['linear_within'])) for h in hues], 3)} |"
        )
    lines += [
        "",
        "## Share of pixels removed",
        "",
        "| season | leaf | ground | person | linear: leaf | linear: ground | linear: person |",
        "|---|---|---|---|---|---|---|",
    ]
    for season in SEASONS:
        own = [f for f in flights if f["season"] == season]
        cells = [
            _cell([f[key][name] for f in own], 3)
            for key in ("removed", "removed_linear")
            for name in ("leaf", "ground", "person")
        ]
        lines.append(f"| {season} | " + " | ".join(cells) + " |")
    lines += [
        "",
        "## Poses of the package's error-state filter and smoother against the truth",
        "",
        "| season | horizontal [m] | vertical [m] | attitude [deg] |",
        "|---|---|---|---|",
    ]
    for season in SEASONS:
        errors = [f["ekf_error"] for f in flights if f["season"] == season]
        cells = [
            _cell([e[k] for e in errors], 3) for k in ("horizontal_m", "vertical_m", "attitude_deg")
        ]
        lines.append(f"| {season} | " + " | ".join(cells) + " |")
    for index, title in ((0, "Contrast of people [grey levels]"), (1, "Contrast to noise")):
        lines += [
            "",
            f"## {title}",
            "",
            "| season | class | people | visible | single | plain | hue-masked | rarity "
            "| plain, EKF | hue-masked, EKF | rarity, EKF |",
            "|---|---|---|---|---|---|---|---|---|---|---|",
        ]
        for season in SEASONS:
            people = [p for f in flights if f["season"] == season for p in f["people"]]
            for name in CLASSES:
                own = [p for p in people if p["class"] == name]
                cells = [
                    _cell([p[key][index] for p in own if p[key] is not None])
                    for key in (
                        "single_true",
                        "plain_true",
                        "masked_true",
                        "rarity_true",
                        "plain_ekf",
                        "masked_ekf",
                        "rarity_ekf",
                    )
                ]
                lines.append(
                    f"| {season} | {name} | {len(own)} | {_cell([p['visible'] for p in own], 2)} | "
                    + " | ".join(cells)
                    + " |"
                )
    lines += [
        "",
        "## Occlusion classes, as asked and as measured",
        "",
        "Mean visible fraction of the person's pixels over all photos that contain it, measured",
        "exactly while people are laid. (`... classes`; the flights of the tables above were laid",
        "by an earlier, coarser measure, and are sorted by what their photos really show.)",
        "",
        "| season | asked | range | people | within | visible, least to greatest |",
        "|---|---|---|---|---|---|",
    ]
    laid = [json.loads(p.read_text()) for p in sorted((FOLDER / "classes").glob("*.json"))]
    for season in SEASONS:
        people = [p for f in laid if f["season"] == season for p in f["people"]]
        for name in CLASSES:
            low, high = RANGES[name]
            shares = sorted(p["visible"] for p in people if p["asked"] == name)
            hit = sum(low <= share <= high for share in shares)
            spread = ", ".join(f"{s:.2f}" for s in shares)
            lines.append(
                f"| {season} | {name} | {low:g}-{high:g} | {len(shares)} | {hit} | {spread} |"
            )
    cpu = [f["cpu_s"] for f in flights]
    lines += [
        "",
        f"CPU time a flight: {_cell([c['scene'] for c in cpu], 0)} s for forest, people and shadow "
        f"maps, {_cell([c['photos'] for c in cpu], 0)} s for the photos.",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["run", "classes", "table"])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--photos", type=int, default=117)
    given = parser.parse_args()
    quiet_start()
    if given.what == "run":
        run(given.seeds, given.size, given.photos)
    elif given.what == "classes":
        classes(given.seeds, given.size, given.photos)
    else:
        (Path(__file__).parent / "SIMULATION.md").write_text(table() + "\n", encoding="utf-8")
