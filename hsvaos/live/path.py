"""Poses between those that were logged: a camera films on while a log ticks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import check_pose
from hsvaos.nav import attitude
from hsvaos.nav.online import NoPoseError


class PosePath:
    """The path of a camera through poses with times.

    Args:
        t_s: Shape (N,), N >= 2, increasing [s].
        world_from_camera: Shape (N, 4, 4), world NED [m].
        longest_s: Gaps above this are not bridged [s].

    Raises:
        ValueError: If there are not two poses with increasing times, or one holds no rotation.
    """

    def __init__(
        self, t_s: ArrayLike, world_from_camera: ArrayLike, longest_s: float = 5.0
    ) -> None:
        self._t = np.asarray(t_s, dtype=np.float64)
        poses = np.asarray(world_from_camera, dtype=np.float64)
        good = self._t.ndim == 1 and len(self._t) >= 2 and (np.diff(self._t) > 0.0).all()
        if not good or len(poses) != len(self._t):
            raise ValueError(
                f"a path needs two poses or more with increasing times, got {self._t.shape} times "
                f"and {poses.shape} poses"
            )
        checked = [check_pose(pose, f"world_from_camera[{i}]") for i, pose in enumerate(poses)]
        self._poses = np.stack(checked)
        self._q = attitude.from_matrix(self._poses[:, :3, :3])
        self._longest_s = longest_s

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s]."""
        return float(self._t[0]), float(self._t[-1])

    def at(self, t_s: float) -> NDArray[np.float64]:
        """Return the pose at a time: straight between two poses, turning evenly.

        Args:
            t_s: Time [s].

        Returns:
            Shape (4, 4), world_from_camera.

        Raises:
            NoPoseError: If the time lies outside the path, or in a gap.
        """
        first, last = self.span
        if not first <= t_s <= last:
            raise NoPoseError(f"{t_s:.3f} s is outside the poses, {first:.3f} to {last:.3f} s")
        i = min(int(np.searchsorted(self._t, t_s, side="right")) - 1, len(self._t) - 2)
        step = self._t[i + 1] - self._t[i]
        share = float((t_s - self._t[i]) / step)
        if step > self._longest_s and 0.0 < share < 1.0:
            raise NoPoseError(f"{t_s:.3f} s lies in a gap of {step:.1f} s between poses")
        pose = np.eye(4)
        turned = attitude.slerp(self._q[i : i + 1], self._q[i + 1 : i + 2], np.array([share]))
        pose[:3, :3] = attitude.matrix(turned[0])
        pose[:3, 3] = (1.0 - share) * self._poses[i, :3, 3] + share * self._poses[i + 1, :3, 3]
        return pose
