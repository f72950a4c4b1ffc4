"""One virtual camera rendered: integral image, rarity map, footprint and finds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.anomaly import find_persons
from hsvaos.detect.detections import Detections
from hsvaos.detect.locate import ViewFinds, box_places
from hsvaos.flight import FlightError
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.packing import Packed
from hsvaos.kernels.rays import focal_points
from hsvaos.masking import Masks
from hsvaos.photos import Photos
from hsvaos.result import ViewResult
from hsvaos.settings import Settings
from hsvaos.surface import FocalSurface


@dataclass(frozen=True, eq=False)
class Integrators:
    """The photos of one flight, once for each way of weighing its pixels.

    Args:
        plain: Every valid pixel counts.
        chosen: Weighed by the mask that the settings name.
        rarity: Weighed by rarity.
        hue: Weighed by the hue cut; None for grey photos.
        rarity_map: The rarity weights themselves, integrated as an image.
    """

    plain: Integrator
    chosen: Integrator
    rarity: Integrator
    hue: Integrator | None
    rarity_map: Integrator


@dataclass(frozen=True, eq=False)
class Renderer:
    """Renders views onto one focal surface.

    Args:
        by: The integrators.
        settings: The settings.
        surface: The focal surface.
    """

    by: Integrators
    settings: Settings
    surface: FocalSurface

    def render(
        self, name: str, view: VirtualCamera, extra: bool = False
    ) -> tuple[ViewResult, ViewFinds]:
        """Render a view and look for finds in it.

        Args:
            name: Frame name or "ortho".
            view: The virtual camera.
            extra: Whether to render the other masks' integral images too, for the report.

        Raises:
            FlightError: If the view sees nothing, or every pixel of it is masked.
        """
        mean_weight, rays = self._integrate(self.by.rarity_map, view)
        if not (rays > 0.0).any():
            raise FlightError(
                f"view {name}: no photo sees the focal surface there; expected a surface below "
                f"the cameras and within their view"
            )
        image, footprint = self._integrate(self.by.chosen, view)
        if not (footprint > 0.0).any():
            raise FlightError(
                f"view {name}: every pixel is masked (mask {self.settings.mask.method}); use fewer "
                f"sigmas, another --mask, or check the user mask"
            )
        rarity_map = mean_weight[..., 0]
        hits = focal_points(view, self.surface, device=self.by.plain.device).numpy()
        hits = hits.reshape(view.height, view.width, 4)
        found = self._find(view, hits, rarity_map, rays)
        places, variances = box_places(found, hits, view)
        others = self._others(view) if extra else {}
        result = ViewResult(name, view, image, footprint, rarity_map, rays, found, others)
        return result, ViewFinds(view, found, places, variances)

    def _integrate(self, integrator: Integrator, view: VirtualCamera) -> tuple[Any, Any]:
        image, footprint = integrator.integrate(
            view, self.surface, aperture_m=self.settings.view.aperture_m
        )
        return image.numpy(), footprint.numpy()

    def _find(
        self,
        view: VirtualCamera,
        hits: NDArray[np.float32],
        rarity_map: NDArray[np.float32],
        rays: NDArray[np.float32],
    ) -> Detections:
        detect = self.settings.detect
        if not detect.enabled:
            return Detections.none()
        gsd = sampling_distance(view, hits)
        enough = min(detect.min_rays, 0.5 * len(self.by.plain))
        return find_persons(rarity_map, rays, gsd, replace(detect, min_rays=enough))

    def _others(self, view: VirtualCamera) -> dict[str, tuple[Any, Any]]:
        named = {"plain": self.by.plain, "hue": self.by.hue, "rarity": self.by.rarity}
        return {
            name: self._integrate(integrator, view)
            for name, integrator in named.items()
            if integrator is not None and integrator is not self.by.chosen
        }


def make_integrators(photos: Photos, masks: Masks, method: str) -> Integrators:
    """Return the integrators of a flight.

    Args:
        photos: The photos.
        masks: Their weights.
        method: Name of the chosen mask.
    """
    camera, poses = photos.flight.camera, photos.flight.poses

    def weighed(
        images: Any, weights: Any, gains: Any = None, packed: Packed | None = None
    ) -> Integrator:
        return Integrator(camera, images, poses, weights, gains=gains, packed=packed)

    hue = None
    if masks.brightened is not None:
        hue = weighed(masks.brightened, masks.hue)
    elif masks.packed is not None:  # levelled already
        hue = weighed(photos.images, masks.hue, packed=masks.packed)
    elif masks.hue is not None:
        hue = weighed(photos.images, masks.hue, masks.gains)
    plain = weighed(photos.images, photos.valid)
    rarity = weighed(photos.images, masks.rarity, masks.gains)
    by_name = {"hue": hue, "rarity": rarity}
    if masks.anomaly is not None:
        by_name["anomaly"] = weighed(photos.images, masks.anomaly, masks.gains)
    chosen = by_name.get(method) or plain
    return Integrators(plain, chosen, rarity, hue, weighed(masks.rarity, photos.valid))


def sampling_distance(view: VirtualCamera, hits: NDArray[np.float32]) -> float:
    """Return the ground sampling distance of a view [m/px], the median over its pixels.

    Args:
        view: The virtual camera.
        hits: Shape (H, W, 4), from `focal_points`: places relative to the view's centre, and 1.
    """
    if view.camera is None:
        return view.gsd_m
    sparse = hits[::8, ::8] if (hits[::8, ::8, 3] > 0.0).any() else hits
    depths = sparse[sparse[..., 3] > 0.0][:, :3] @ view.world_from_camera[:3, 2]
    return float(np.median(depths)) / view.camera.fx
