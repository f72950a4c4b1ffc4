"""What is looked at: a view and a focal surface, which rest or move."""

from __future__ import annotations

from typing import Any

import warp as wp

from hsvaos.camera import VirtualCamera
from hsvaos.kernels.rays import focal_points
from hsvaos.rendering import sampling_distance
from hsvaos.surface import FocalSurface


class Sight:
    """A view and a surface, and where its rays meet it, in fixed memory.

    Args:
        size: (width, height) of all views [px].
        device: Warp device.
    """

    def __init__(self, size: tuple[int, int], device: Any) -> None:
        self.size, self._device = size, device
        self._memory: Any = wp.zeros(size[0] * size[1], dtype=wp.vec4, device=device)
        self._at: tuple[VirtualCamera, FocalSurface] | None = None
        self._known = False

    def turn(self, view: VirtualCamera, surface: FocalSurface) -> bool:
        """Look at something; return whether that is what was looked at before.

        Args:
            view: The view.
            surface: Focal plane or terrain.

        Raises:
            ValueError: If the view has another size.
            TypeError: If it is none.
        """
        if not isinstance(view, VirtualCamera):
            raise TypeError(f"view must be a VirtualCamera, got {type(view).__name__}")
        if view.size != self.size:
            raise ValueError(f"view must have the window's size {self.size}, got {view.size}")
        if self._at is not None and self._at[0] is view and self._at[1] is surface:
            return True
        self._at, self._known = (view, surface), False
        return False

    def forget(self) -> None:
        """Look at nothing."""
        self._at = None

    @property
    def view(self) -> VirtualCamera:
        """The view.

        Raises:
            ValueError: If nothing was looked at yet.
        """
        return self._looked_at()[0]

    @property
    def surface(self) -> FocalSurface:
        """The surface; see `view`."""
        return self._looked_at()[1]

    @property
    def points(self) -> Any:
        """Warp array (H * W) of vec4, see `focal_points`: found when first asked for."""
        view, surface = self._looked_at()
        if not self._known:
            focal_points(view, surface, out=self._memory, device=self._device)
            self._known = True
        return self._memory

    def sampling_distance(self) -> float:
        """Return the ground sampling distance of the view [m/px]."""
        hits = self.points.numpy().reshape(self.size[1], self.size[0], 4)
        return sampling_distance(self.view, hits)

    def _looked_at(self) -> tuple[VirtualCamera, FocalSurface]:
        if self._at is None:
            raise ValueError("nothing was looked at yet: expected a view and a surface")
        return self._at
