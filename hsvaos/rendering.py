"""One virtual camera rendered: integral image, rarity map, footprint and finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.detect.anomaly import find_peaks, local_z
from hsvaos.detect.detections import Detections
from hsvaos.detect.locate import box_places
from hsvaos.flight import FlightError
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.rays import focal_points
from hsvaos.masking import Masks
from hsvaos.photos import Photos
from hsvaos.result import ViewResult
from hsvaos.settings import Settings
from hsvaos.surface import FocalSurface

Finds = tuple[Detections, NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Renderer:
    """Integrators of one flight, one for each way of weighing its pixels.

    Args:
        plain: Every valid pixel counts.
        chosen: Weighed by the mask that the settings name.
        rarity: Weighed by rarity.
        hue: Weighed by the hue cut; None for grey photos.
        rarity_map: The rarity weights themselves, integrated as an image.
        settings: The settings.
        surface: The focal surface.
    """

    plain: Integrator
    chosen: Integrator
    rarity: Integrator
    hue: Integrator | None
    rarity_map: Integrator
    settings: Settings
    surface: FocalSurface

    def render(
        self, name: str, view: VirtualCamera, extra: bool = False
    ) -> tuple[ViewResult, Finds]:
        """Render a view and look for finds in it.

        Args:
            name: Frame name or "ortho".
            view: The virtual camera.
            extra: Whether to render the other masks' integral images too, for the report.

        Raises:
            FlightError: If the view sees nothing, or every pixel of it is masked.
        """
        mean_weight, rays = self._integrate(self.rarity_map, view)
        if not (rays > 0.0).any():
            raise FlightError(
                f"view {name}: no photo sees the focal surface there; expected a surface below "
                f"the cameras and within their view"
            )
        image, footprint = self._integrate(self.chosen, view)
        if not (footprint > 0.0).any():
            raise FlightError(
                f"view {name}: every pixel is masked (mask {self.settings.mask.method}); use fewer "
                f"sigmas, another --mask, or check the user mask"
            )
        rarity_map = mean_weight[..., 0] / 255.0
        points = focal_points(view, self.surface, device=self.plain.device).numpy()
        world = _in_world(points.reshape(view.height, view.width, 4), view)
        found = self._find(view, world, rarity_map, rays)
        places, variances = box_places(found, world)
        others = self._others(view) if extra else {}
        result = ViewResult(name, view, image, footprint, rarity_map, rays, found, others)
        return result, (found, places, variances)

    def _integrate(self, integrator: Integrator, view: VirtualCamera) -> tuple[Any, Any]:
        image, footprint = integrator.integrate(
            view, self.surface, aperture_m=self.settings.view.aperture_m
        )
        return image.numpy(), footprint.numpy()

    def _find(
        self,
        view: VirtualCamera,
        world: NDArray[np.float64],
        rarity_map: NDArray[np.float32],
        rays: NDArray[np.float32],
    ) -> Detections:
        detect = self.settings.detect
        if not detect.enabled:
            return Detections.none()
        gsd = sampling_distance(view, world)
        z = local_z(rarity_map, rays, gsd, detect.person_m, detect.min_rays)
        return find_peaks(z, gsd, detect)

    def _others(self, view: VirtualCamera) -> dict[str, tuple[Any, Any]]:
        named = {"plain": self.plain, "hue": self.hue, "rarity": self.rarity}
        return {
            name: self._integrate(integrator, view)
            for name, integrator in named.items()
            if integrator is not None and integrator is not self.chosen
        }


def make_renderer(
    photos: Photos, masks: Masks, plain: Integrator, settings: Settings, surface: FocalSurface
) -> Renderer:
    """Return the integrators of a flight.

    Args:
        photos: The photos.
        masks: Their weights.
        plain: Integrator of the plain photos.
        settings: The settings.
        surface: The focal surface.
    """
    camera, poses = photos.flight.camera, photos.flight.poses

    def weighed(images: Any, weights: Any) -> Integrator:
        return Integrator(camera, images, poses, weights)

    hue = None if masks.hue is None else weighed(masks.brightened, masks.hue)
    rarity = weighed(photos.images, masks.rarity)
    by_name = {"hue": hue, "rarity": rarity}
    if masks.anomaly is not None:
        by_name["anomaly"] = weighed(photos.images, masks.anomaly)
    chosen = by_name.get(settings.mask.method) or plain
    rarity_map = weighed(masks.rarity, photos.valid)
    return Renderer(plain, chosen, rarity, hue, rarity_map, settings, surface)


def sampling_distance(view: VirtualCamera, points: NDArray[np.float64]) -> float:
    """Return the ground sampling distance of a view [m/px], the median over its pixels.

    Args:
        view: The virtual camera.
        points: Shape (H, W, 3), focal point of each pixel, world NED [m], NaN where there is none.
    """
    if view.camera is None:
        return view.gsd_m
    axis = view.world_from_camera[:3, 2]
    depths = (points[::8, ::8] - view.world_from_camera[:3, 3]) @ axis
    return float(np.nanmedian(depths)) / view.camera.fx


def _in_world(hits: NDArray[np.float32], view: VirtualCamera) -> NDArray[np.float64]:
    points = hits[..., :3].astype(np.float64) + view.world_from_camera[:3, 3]
    points[hits[..., 3] == 0.0] = np.nan
    return points
