"""Integral images on one ground grid, from which every view of a flight is drawn.

Where all photos count, what a point of the focal surface shows does not depend on the virtual
camera that looks at it: integrated once, the ground serves the views at all stored poses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import VirtualCamera
from hsvaos.flight import Flight, FlightError
from hsvaos.settings import ViewSettings
from hsvaos.surface import FocalSurface
from hsvaos.viewing import ground_grid

Layer = tuple[NDArray[np.float32], NDArray[np.float32]]
"""An integral image (H, W, C) and its footprint (H, W), float32; or agreeing rays' mean colour and
their coherence, which is drawn the same way."""

_LEAST_VIEWS = 4
_STEEPEST = float(np.cos(np.radians(35.0)))
"""Views that look farther off the vertical see near ground finer than one grid can be."""

_FINER = 1.15
"""The grid is this much finer than the finest view, as every resampling blurs a little."""

_COARSENED_PX = 15_500_000
"""Grids of this size may have been coarsened below the sampling of the photos."""


@dataclass(frozen=True, eq=False)
class GroundMap:
    """Integral images on a ground grid.

    Args:
        grid: The grid, an orthographic view.
        layers: By name, as integrated on the grid.
    """

    grid: VirtualCamera
    layers: dict[str, Layer]

    def seen_from(self, view: VirtualCamera, hits: NDArray[np.float32]) -> dict[str, Layer]:
        """Return the layers as a view sees them.

        Args:
            view: The virtual camera.
            hits: Shape (H, W, 4), its focal points relative to its centre [m], and 1 or 0, from
                `kernels.rays.focal_points`.
        """
        north = hits[..., 0] + np.float32(view.world_from_camera[0, 3])
        east = hits[..., 1] + np.float32(view.world_from_camera[1, 3])
        corner = self.grid.world_from_camera[:2, 3]
        x = (east - np.float32(corner[1])) / np.float32(self.grid.gsd_m)
        y = (np.float32(corner[0]) - north) / np.float32(self.grid.gsd_m)
        lost = hits[..., 3] <= 0.0
        x[lost] = y[lost] = -10.0
        return {name: _resampled(sums, x, y) for name, sums in self._sums.items()}

    @cached_property
    def _sums(self) -> dict[str, NDArray[np.float32]]:
        """Layers weighted by their footprint, which comes last, shape (H, W, C + 1).

        Drawn so, unseen ground does not darken what lies beside it.
        """
        return {name: _weighed(image, rays) for name, (image, rays) in self.layers.items()}


def _weighed(image: NDArray[np.float32], footprint: NDArray[np.float32]) -> NDArray[np.float32]:
    planes = [plane * footprint for plane in np.moveaxis(image, 2, 0)]
    # not np.dstack of the product: twice as long
    return np.asarray(cv2.merge([*planes, footprint]), dtype=np.float32)


def _resampled(sums: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]) -> Layer:
    drawn = np.asarray(
        cv2.remap(sums, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), dtype=np.float32
    )
    rays = np.ascontiguousarray(drawn[..., -1])
    share = np.maximum(rays, np.float32(1e-12))[..., None]
    mean = np.divide(drawn[..., :-1], share, dtype=np.float32)
    mean[rays <= 0.0] = 0.0
    return mean, rays


def grid_for(
    flight: Flight,
    views: Sequence[VirtualCamera],
    surface: FocalSurface,
    settings: ViewSettings,
) -> VirtualCamera | None:
    """Return the ground grid that can stand for all the views, or None where none can.

    Args:
        flight: The flight, with poses.
        views: The views to draw.
        surface: The focal surface.
        settings: A synthetic aperture moves with the view: then there is no such grid.
    """
    if len(views) < _LEAST_VIEWS or settings.aperture_m is not None:
        return None
    if any(view.camera is None or view.world_from_camera[2, 2] < _STEEPEST for view in views):
        return None
    try:
        coarse = ground_grid(flight, surface, None)
        if coarse.width * coarse.height > _COARSENED_PX:
            return None
        return ground_grid(flight, surface, coarse.gsd_m / _FINER)
    except FlightError:
        return None


def integrate_ground(
    grid: VirtualCamera,
    names: Sequence[str],
    integrate: Callable[[str, VirtualCamera], Layer],
) -> GroundMap:
    """Integrate layers on a grid.

    Args:
        grid: The grid.
        names: Of the layers.
        integrate: Renders a layer from a view.
    """
    return GroundMap(grid, {name: integrate(name, grid) for name in names})
