"""One virtual camera rendered: integral image, rarity map, footprint and finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.detections import Detections
from hsvaos.detect.fragments import ONE, FragmentNet, PhotoEvidence
from hsvaos.detect.locate import ViewFinds, box_places, pose_spread
from hsvaos.detect.network_input import PHOTO_LAYERS
from hsvaos.detect.surroundings import Surroundings, with_surroundings
from hsvaos.finding import Finder
from hsvaos.flight import Flight, FlightError
from hsvaos.fragment_input import FragmentInput
from hsvaos.ground_map import GroundMap, Layer, grid_for, integrate_ground
from hsvaos.kernels.device import free_memory
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.packing import Packed
from hsvaos.kernels.rays import focal_points
from hsvaos.masking import Masks
from hsvaos.photos import Photos, Progress, resized
from hsvaos.result import ViewResult
from hsvaos.settings import Settings
from hsvaos.surface import FocalSurface

_PACKED_BYTES = 28
"""Bytes a pixel of what integrals pack together: the photo under no mask (4), weighed by rarity (8)
and as ground (8), the rarity itself (4) and the evidence (4)."""

_COARSE = 16
"""Pixels of a view to one of its rough copy, of which the sampling distance is asked."""


class EvidenceIntegrators(NamedTuple):
    """What a network said of every photo, ready to be integrated.

    Attributes:
        fragments: Evidence of pieces of people, integrated as an image.
        pieces: The photos weighed by that evidence.
        ground: The photos weighed by how likely each pixel shows the ground.
    """

    fragments: Integrator
    pieces: Integrator
    ground: Integrator


@dataclass(frozen=True, eq=False)
class Integrators:
    """The photos of one flight, once for each way of weighing its pixels.

    Args:
        plain: Every valid pixel counts.
        chosen: Weighed by the mask that the settings name.
        rarity: Weighed by rarity.
        hue: Weighed by the hue cut; None for grey photos.
        rarity_map: The rarity weights themselves, integrated as an image.
        anomaly_map: The RX masks integrated as an image; None unless they were made.
        fragments: Evidence of pieces of people, integrated as an image; None unless it was made.
        pieces: Weighed by that evidence; None unless it was made.
        ground: Weighed by how likely each pixel shows the ground; None unless it was made.
    """

    plain: Integrator
    chosen: Integrator
    rarity: Integrator
    hue: Integrator | None
    rarity_map: Integrator
    anomaly_map: Integrator | None = None
    fragments: Integrator | None = None
    pieces: Integrator | None = None
    ground: Integrator | None = None

    def with_evidence(self, made: EvidenceIntegrators) -> Integrators:
        """Return them with what `evidence_integrators` makes."""
        return replace(self, **made._asdict())


@dataclass(frozen=True, eq=False)
class Renderer:
    """Renders views onto one focal surface.

    Args:
        by: The integrators.
        settings: The settings.
        surface: The focal surface.
        finder: Looks for people in a view; None to look for nobody.
        ground: Integrated ground from which views are drawn; None to integrate every view.
        pose_covariances: Shape (N, 6, 6), of the photos' poses; None where they are not known.
        lean: Whether each integrator lets its packed photos go after use: packing them anew costs
            less than an integral, and all of them together are several times the photos.
    """

    by: Integrators
    settings: Settings
    surface: FocalSurface
    finder: Finder | None = None
    ground: GroundMap | None = None
    pose_covariances: NDArray[np.float64] | None = None
    lean: bool = False

    def with_ground_for(self, flight: Flight, views: Sequence[VirtualCamera]) -> Renderer:
        """Return a renderer that integrates the ground once, where that can stand for all views.

        Where it cannot, and there are many, packed photos are kept if memory allows.

        Args:
            flight: The flight, with poses.
            views: All views to come.
        """
        grid = grid_for(flight, views, self.surface, self.settings.view)
        if grid is None:
            free, photos = free_memory(), self.by.plain
            pixels = len(photos) * photos.camera.width * photos.camera.height
            enough = free is None or free > _PACKED_BYTES * pixels
            return replace(self, lean=self.lean and not (enough and len(views) > 1))
        return replace(self, ground=integrate_ground(grid, self._needed(), self._integrate))

    def render(
        self, name: str, view: VirtualCamera, extra: bool = False
    ) -> tuple[ViewResult, ViewFinds]:
        """Render a view and look for finds in it.

        Args:
            name: Frame name or "ortho".
            view: The virtual camera.
            extra: Whether to render the other masks' integral images too, for the report.

        Returns:
            The view with what is found in it, and what counts for persons, where it lies.

        Raises:
            FlightError: If the view sees nothing, or every pixel of it is masked.
        """
        around = self._surroundings(view)
        hits = self._hits(around.view)
        layers = self._layers(around.view, hits, exactly=extra)
        mean_weight, rays = (around.cut(part) for part in layers["rarity_map"])
        if not (rays > 0.0).any():
            raise FlightError(
                f"view {name}: no photo sees the focal surface there; expected a surface below "
                f"the cameras and within their view"
            )
        if around.margin_px and (extra or self.ground is None):  # the picture itself, to the bit
            image, footprint = self._integrate("chosen", view)
        else:
            image, footprint = (around.cut(part) for part in layers["chosen"])
        if not (footprint > 0.0).any():
            raise FlightError(
                f"view {name}: every pixel is masked (mask {self.settings.mask.method}); use fewer "
                f"sigmas, another --mask, or check the user mask"
            )
        found = Detections.none()
        if self.finder is not None:
            found = self.finder(layers, sampling_distance(view, around.cut(hits)))
        found = around.within(found)
        own_hits = self._hits(view) if around.margin_px else hits  # as who reads the finds has them
        places, covariances = box_places(found, own_hits, view)
        if self.pose_covariances is not None:
            photos = self.by.plain
            of_poses = (photos.camera, photos.world_from_camera, self.pose_covariances)
            covariances = covariances + pose_spread(places, *of_poses)
        others = self._others(view) if extra else {}
        pieces = None
        if "fragments" in layers:
            pieces = around.cut(layers["fragments"][0][..., 0] / ONE)
        maps = (mean_weight[..., 0], rays)
        finds = ViewFinds(view, found, places, covariances)
        if self.finder is not None:
            scores = self.finder.scores
            found, finds = found.above(scores.of_boxes), finds.above(scores.of_persons)
        return ViewResult(name, view, image, footprint, *maps, found, others, pieces), finds

    def _surroundings(self, view: VirtualCamera) -> Surroundings:
        if self.finder is None or self.finder.reach_m == 0.0 or view.camera is None:
            return Surroundings(view, 0)
        size = [-(-side // _COARSE) for side in view.size]
        coarse = VirtualCamera(view.camera.scaled(*size), view.world_from_camera)
        gsd_m = sampling_distance(coarse, self._hits(coarse)) * size[0] / view.width
        return with_surroundings(view, gsd_m, self.finder.reach_m)

    def _hits(self, view: VirtualCamera) -> NDArray[np.float32]:
        hits = focal_points(view, self.surface, device=self.by.plain.device).numpy()
        return np.asarray(hits.reshape(view.height, view.width, 4))

    def _needed(self) -> tuple[str, ...]:
        looked_at = self.finder.layers if self.finder is not None else ()
        left_out = {"rarity_map", "chosen"}
        if self.by.fragments is None:
            left_out |= PHOTO_LAYERS.keys()
        return ("rarity_map", "chosen", *(n for n in looked_at if n not in left_out))

    def _layers(
        self, view: VirtualCamera, hits: NDArray[np.float32], *, exactly: bool
    ) -> dict[str, Layer]:
        if self.ground is not None and not exactly:
            return self.ground.seen_from(view, hits)
        return {name: self._integrate(name, view) for name in self._needed()}

    def _integrate(self, name: str, view: VirtualCamera) -> Layer:
        where = (view, self.surface, self.settings.view.aperture_m)
        agreeing = {"coherence": self.by.rarity, "fragment_coherence": self.by.pieces}.get(name)
        if agreeing is not None:
            image, footprint = agreeing.coherence(*where)
        else:
            integrator: Integrator = getattr(self.by, name)
            image, footprint = integrator.integrate(*where)
            if self.lean:
                integrator.release()
        return image.numpy(), footprint.numpy()

    def _others(self, view: VirtualCamera) -> dict[str, tuple[Any, Any]]:
        return {
            name: self._integrate(name, view)
            for name in ("plain", "hue", "rarity", "ground")
            if getattr(self.by, name) not in (None, self.by.chosen)
        }


def make_integrators(photos: Photos, masks: Masks, method: str) -> Integrators:
    """Return the integrators of a flight.

    Args:
        photos: The photos.
        masks: Their weights.
        method: Name of the chosen mask.
    """
    camera, poses = photos.flight.camera, photos.flight.poses

    def weighed(images: Any, weights: Any, gains: Any = None) -> Integrator:
        return Integrator(camera, images, poses, weights, gains=gains)

    hue = None
    if masks.hue is not None:
        hue = hue_integrator(photos, masks.hue, masks.brightened, masks.packed, masks.gains)
    plain = weighed(photos.images, photos.valid)
    rarity = weighed(photos.images, masks.rarity, masks.gains)
    by_name = {"hue": hue, "rarity": rarity}
    if masks.anomaly is not None:
        by_name["anomaly"] = weighed(photos.images, masks.anomaly, masks.gains)
    chosen = by_name.get(method) or plain
    odd = None
    if masks.anomaly is not None:
        odd = weighed(masks.anomaly, photos.valid)
    return Integrators(plain, chosen, rarity, hue, weighed(masks.rarity, photos.valid), odd)


def hue_integrator(
    photos: Photos, hue: Any, brightened: Any, packed: Packed | None, gains: Any
) -> Integrator:
    """Return the integrator of photos under the hue cut; for the arguments see `masking.Masks`."""
    camera, poses = photos.flight.camera, photos.flight.poses
    if brightened is not None:
        return Integrator(camera, brightened, poses, hue)
    if packed is not None:  # levelled already
        return Integrator(camera, photos.images, poses, hue, packed=packed)
    return Integrator(camera, photos.images, poses, hue, gains=gains)


def look_at_photos(
    photos: Photos,
    masks: Masks,
    net: FragmentNet,
    gsd_m: float | None = None,
    progress: Progress | None = None,
) -> PhotoEvidence:
    """Return what a network says of every photo: of pieces of people, and of the ground.

    Args:
        photos: Colour photos.
        masks: Their weights.
        net: The network that looks at them.
        gsd_m: Ground sampling distance of the photos [m/px], see `FragmentNet.evidence`.
        progress: Told how many photos are done.
    """

    def report(done: int, count: int) -> None:
        if progress is not None:
            progress("looking for pieces of people", done, count)

    inputs = FragmentInput(photos.images, masks.rarity_model, masks.gains)
    return net.evidence(inputs, gsd_m, report)


def evidence_integrators(
    photos: Photos, evidence: PhotoEvidence, gains: NDArray[np.float64] | None
) -> EvidenceIntegrators:
    """Return the integrators of what a network said of every photo.

    Args:
        photos: The photos.
        evidence: Of every photo, in its size or resampled from it.
        gains: Shape (N, 3), factors that level the photos; None for none.
    """
    people = evidence.people
    flight, valid, device = photos.flight, photos.valid, photos.images.device
    camera = flight.camera

    def weighed(weights: Any) -> Integrator:
        return Integrator(camera, photos.images, flight.poses, weights, gains=gains)

    # no evidence is no lack of a ray: that is what 0 would mean as a weight
    weights = _as_weights(np.maximum(people, np.uint16(1)), photos)
    on_device: Any = wp.array(weights, dtype=wp.uint16, device=device)
    pieces = weighed(on_device)
    ground = weighed(wp.array(_as_weights(evidence.ground, photos), dtype=wp.uint8, device=device))
    if weights.shape != people.shape:
        height, width = people.shape[1:]
        camera = camera.scaled(width, height)
        valid = None if valid is None else _resized_masks(valid, width, height)
        on_device = wp.array(people, dtype=wp.uint16, device=device)
    shown = Integrator(camera, on_device, flight.poses, valid)
    return EvidenceIntegrators(shown, pieces, ground)


def _as_weights(said: NDArray[Any], photos: Photos) -> NDArray[Any]:
    """Return what was said of photos, in their size, and 0 where the user masks them."""
    camera, valid = photos.flight.camera, photos.valid
    if said.shape[1:] != (camera.height, camera.width):
        said = np.stack([resized(one, camera.width, camera.height) for one in said])
    return said if valid is None else np.where(valid == 0, said.dtype.type(0), said)


def _resized_masks(valid: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    if valid.ndim == 2:
        return resized(valid, width, height)
    return np.stack([resized(one, width, height) for one in valid])


def sampling_distance(view: VirtualCamera, hits: NDArray[np.float32]) -> float:
    """Return the ground sampling distance of a view [m/px], the median over its pixels.

    NaN where it sees no ground.

    Args:
        view: The virtual camera.
        hits: Shape (H, W, 4), from `focal_points`: places relative to the view's centre, and 1.
    """
    if view.camera is None:
        return view.gsd_m
    sparse = hits[::8, ::8] if (hits[::8, ::8, 3] > 0.0).any() else hits
    depths = sparse[sparse[..., 3] > 0.0][:, :3] @ view.world_from_camera[:3, 2]
    return float(np.median(depths)) / view.camera.fx if depths.size else float("nan")
