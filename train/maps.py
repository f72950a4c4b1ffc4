"""Ground maps of training flights: what an integral image shows, in several conditions.

Each flight is integrated onto a north-up grid at the sampling of its photos: with true poses, with
poses as a filter leaves them or worse, and from a part of its photos; on the relief that is found
with these poses, as `hsvaos.run` does, and now and then on a plane that is out of focus.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hsvaos
from hsvaos.camera import VirtualCamera
from hsvaos.detect.fragments import FragmentNet, PhotoEvidence
from hsvaos.kernels.hue_mask import measure_hue
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.rarity import apply_rarity
from hsvaos.masking import Masks, cut_hues, make_masks
from hsvaos.photos import Photos, load_photos
from hsvaos.rarity_model import RarityModel
from hsvaos.relief.find import find_relief
from hsvaos.rendering import (
    Integrators,
    evidence_integrators,
    hue_integrator,
    look_at_photos,
    make_integrators,
)
from hsvaos.settings import Settings
from hsvaos.surface import FocalPlane, FocalSurface
from train.rarity import training_rarity
from train.truth import flight_truth, outlines

PLANES = {"plain": slice(0, 3), "rarity": slice(3, 6), "hue": slice(6, 9)}
"""Where the three integral images lie in a map; then come rarity map, rays and hue footprint, the
colours of the rays that agree, their coherence, the evidence of fragments, the colours of the rays
of fragments that agree, and their coherence; and the colours of the rays that come from the ground,
and how many do."""

RARITY_MAP, RAYS, HUE_FOOTPRINT = 9, 10, 11
COHERENT, COHERENCE, FRAGMENTS = slice(12, 15), 15, 16
FRAGMENT_COLOUR, FRAGMENT_COHERENCE = slice(17, 20), 20
GROUND, GROUND_RAYS = slice(21, 24), 24
LAYERS = 25

CONDITIONS = 4
"""Maps of each training flight."""

SEARCH_CONDITIONS = 2
"""Maps of each tuning flight: with the poses of a search, true or as a filter leaves them."""

_BORDER_M = 5.0
_ON_PLANE = 0.2
"""Share of the maps of training flights that are on a plane: where a flight's rays do not agree,
the plane is kept in use too."""


@dataclass(frozen=True)
class Condition:
    """How well a flight is integrated.

    Args:
        focus_m: The focal plane lies this much too low [m]; where the relief is looked for, about
            that plane.
        drift_m: Standard deviation of slow position errors, each axis [m].
        noise_m: The same of errors from photo to photo [m].
        turn_deg: Standard deviation of attitude errors, each axis [deg].
        share: Share of the photos used.
        relief: Whether the relief of the ground is looked for.
    """

    focus_m: float = 0.0
    drift_m: float = 0.0
    noise_m: float = 0.0
    turn_deg: float = 0.0
    share: float = 1.0
    relief: bool = True


def conditions(rng: np.random.Generator) -> list[Condition]:
    """Return the conditions of one flight.

    Args:
        rng: Draws them.
    """
    drawn = [
        Condition(focus_m=float(rng.normal(0.0, 0.12))),
        Condition(
            focus_m=float(rng.normal(0.0, 0.2)),
            drift_m=float(rng.uniform(0.02, 0.10)),
            noise_m=0.01,
            turn_deg=float(rng.uniform(0.03, 0.2)),
        ),
        Condition(
            focus_m=float(rng.normal(0.0, 0.35)),
            drift_m=float(rng.uniform(0.08, 0.35)),
            noise_m=0.03,
            turn_deg=float(rng.uniform(0.1, 0.4)),
        ),
        Condition(
            focus_m=float(rng.normal(0.0, 0.2)),
            drift_m=float(rng.uniform(0.0, 0.05)),
            share=float(rng.uniform(0.3, 0.75)),
        ),
    ]
    return [replace(one, relief=bool(rng.uniform() >= _ON_PLANE)) for one in drawn]


def disturbed(
    poses: NDArray[np.float64], condition: Condition, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return poses with slow and fast errors; over the flight their mean is 0.

    Args:
        poses: Shape (N, 4, 4), world_from_camera.
        condition: How large the errors are.
        rng: Draws them.
    """
    count = len(poses)
    memory = 0.9
    drift = np.zeros((count, 6))
    state = rng.standard_normal(6)
    for k in range(count):
        state = memory * state + np.sqrt(1.0 - memory**2) * rng.standard_normal(6)
        drift[k] = state
    drift -= drift.mean(axis=0)
    changed = poses.copy()
    changed[:, :3, 3] += condition.drift_m * drift[:, :3]
    changed[:, :3, 3] += condition.noise_m * rng.standard_normal((count, 3))
    angles = np.radians(condition.turn_deg) * drift[:, 3:]
    for k, (x, y, z) in enumerate(angles):
        turn = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
        left, _, right = np.linalg.svd(turn @ poses[k, :3, :3])
        changed[k, :3, :3] = left @ right
    return changed


def make_maps(
    folder: Path, target: Path, *, search: bool = False, fragments: FragmentNet | None = None
) -> None:
    """Integrate a flight in all conditions and write one .npz a condition.

    Args:
        folder: The flight.
        target: Where the maps go: `NAME_0.npz`, ...
        search: Whether the flight is a search: fewer conditions, rarity as it is, and always on
            the relief.
        fragments: Looks for pieces of people in the photos, and for the ground; None leaves these
            layers unknown, and the maps on planes.
    """
    flight = hsvaos.open_flight(folder)
    truth, rng = flight_truth(folder)
    photos = load_photos(flight, 1.0, "cpu", None)
    people = outlines(truth)
    masks = make_masks(photos, Settings())
    if not search:
        masks = _with_rarity(photos, masks, training_rarity(photos, truth, rng, masks.gains))
    said = None
    if fragments is not None and photos.is_colour:
        said = look_at_photos(photos, masks, fragments)
    ours, papers = _integrators(photos, masks, said)
    reach = np.abs(flight.poses[:, :2, 3]).max(axis=0) + _BORDER_M
    gsd = float(np.median(-flight.poses[:, 2, 3])) / flight.camera.fx
    width, height = (int(2.0 * side / gsd) for side in reach[::-1])
    view = VirtualCamera.ortho(float(reach[0]), float(-reach[1]), gsd, width, height)
    counts = np.array(truth["pixels"]["by_photo"], dtype=np.float64)
    shares = np.where(counts[..., 1] >= 12, counts[..., 0] / np.maximum(counts[..., 1], 1.0), 0.0)
    boxes = np.array([_box(view, outline) for outline in people])
    for number, condition in enumerate(conditions(rng)[: SEARCH_CONDITIONS if search else None]):
        path = target / f"{folder.name}_{number}.npz"
        chosen = np.arange(len(flight.poses))
        if condition.share < 1.0:
            kept = max(6, round(condition.share * len(chosen)))
            chosen = np.sort(rng.permutation(chosen)[:kept])
        poses = disturbed(flight.poses, condition, rng)
        by = ours if number % 2 == 0 else papers
        surface: FocalSurface = FocalPlane(condition.focus_m)
        if said is not None and (search or condition.relief):
            there = replace(photos, flight=flight.at_poses(poses))
            surface = _on_relief(there, said, masks, condition.focus_m, chosen)
        layers = _layers(by, poses, view, surface, chosen)
        part = path.with_suffix(".part.npz")
        np.savez(
            part,
            layers=_as_halves(layers),
            boxes=boxes,
            rays=shares[chosen].sum(axis=0),
            classes=[person["occlusion"] for person in truth["people"]],
            gsd=gsd,
            colour=photos.is_colour,
            fragments=ours.fragments is not None,
        )
        part.replace(path)


def _on_relief(
    photos: Photos,
    said: PhotoEvidence,
    masks: Masks,
    focus_m: float,
    chosen: NDArray[np.int64],
) -> FocalSurface:
    """Return the relief that chosen photos show about a plane, or the plane."""
    ground = np.zeros_like(said.ground)
    ground[chosen] = said.ground[chosen]
    plane = FocalPlane(focus_m)
    found, _ = find_relief(photos, ground, masks.gains, plane)
    return found or plane


def _as_halves(layers: NDArray[np.float32]) -> NDArray[np.float16]:
    """Return layers as float16; evidence runs to 65535 and is brought to 0..255."""
    layers[FRAGMENTS] *= np.float32(255.0 / 65535.0)
    return layers.astype(np.float16)


def _box(view: VirtualCamera, outline: NDArray[np.float64]) -> NDArray[np.float64]:
    pixels = view.project(outline)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def _with_rarity(photos: Photos, masks: Masks, model: RarityModel) -> Masks:
    rarity = apply_rarity(photos.images, model, dtype="float32", gains=masks.gains)
    return replace(masks, rarity=rarity, rarity_model=model)


def _integrators(
    photos: Photos, masks: Masks, said: PhotoEvidence | None
) -> tuple[Integrators, Integrators]:
    """Return integrators with our hue cut and with the paper's, the same else."""
    ours = make_integrators(photos, masks, "rarity")
    if not photos.is_colour:
        return ours, ours
    if said is not None:
        ours = ours.with_evidence(evidence_integrators(photos, said, masks.gains))
    mask, gains = Settings().with_values(mask={"statistics": "linear"}).mask, masks.gains
    how = (mask.sigmas, mask.statistics, mask.scope)
    stats, _ = measure_hue(photos.images, *how, valid=photos.valid, gains=gains)
    cut = cut_hues(photos, mask, stats, gains)
    return ours, replace(ours, hue=hue_integrator(photos, *cut, gains))


def _layers(
    by: Integrators,
    poses: NDArray[np.float64],
    view: VirtualCamera,
    surface: FocalSurface,
    chosen: NDArray[np.int64],
) -> NDArray[np.float32]:
    def integral(integrator: Integrator) -> tuple[Any, Any]:
        image, footprint = integrator.at_poses(poses).integrate(view, surface, frames=chosen)
        return np.asarray(image.numpy()), np.asarray(footprint.numpy())

    def agreed(integrator: Integrator) -> tuple[Any, Any]:
        image, coherence = integrator.at_poses(poses).coherence(view, surface, frames=chosen)
        return np.moveaxis(image.numpy(), 2, 0), coherence.numpy()  # grey fills all three

    layers = np.zeros((LAYERS, view.height, view.width), dtype=np.float32)
    plain, rays = integral(by.plain)
    hue, kept = (plain, rays) if by.hue is None else integral(by.hue)
    for name, picture in (("plain", plain), ("rarity", integral(by.rarity)[0]), ("hue", hue)):
        layers[PLANES[name]] = np.moveaxis(picture, 2, 0)  # grey fills all three
    layers[RARITY_MAP] = integral(by.rarity_map)[0][..., 0]
    layers[RAYS] = rays
    layers[HUE_FOOTPRINT] = kept
    layers[COHERENT], layers[COHERENCE] = agreed(by.rarity)
    if by.fragments is not None and by.pieces is not None:
        layers[FRAGMENTS] = integral(by.fragments)[0][..., 0]
        layers[FRAGMENT_COLOUR], layers[FRAGMENT_COHERENCE] = agreed(by.pieces)
    if by.ground is not None:
        picture, layers[GROUND_RAYS] = integral(by.ground)
        layers[GROUND] = np.moveaxis(picture, 2, 0)
    return layers


def agreed_in(
    layers: NDArray[np.float32], colours: slice, coherence: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return mean colours of a map, and their coherence or rays, as `network_input` takes them.

    Args:
        layers: Shape (25, H, W).
        colours: `COHERENT`, `FRAGMENT_COLOUR` or `GROUND`.
        coherence: `COHERENCE`, `FRAGMENT_COHERENCE` or `GROUND_RAYS`.
    """
    return np.moveaxis(layers[colours], 0, 2), layers[coherence]
