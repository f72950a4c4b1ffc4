"""From where photos were taken, on the device: brought there once, seen from any view."""

from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.kernels.device import launch
from hsvaos.kernels.scratch import scratch

wp.set_module_options({"enable_backward": False})


@wp.struct
class Pose:
    """World to camera: rotation, centre relative to the virtual camera's [m], and photo's gain."""

    rotation: wp.mat33
    centre: wp.vec3
    gain: wp.vec3


@wp.struct
class Station:
    """World to camera: rotation, centre in the world [m], and photo's gain."""

    rotation: wp.mat33
    centre: wp.vec3d
    gain: wp.vec3


@wp.kernel(module="unique", enable_backward=False)
def _seen_from_kernel(
    offset: int,
    band: int,
    eye: wp.vec3d,
    stations: wp.array(dtype=Station),
    poses: wp.array(dtype=Pose),
):
    n = wp.tid() + offset
    away = stations[n].centre - eye
    pose = Pose()
    pose.rotation = stations[n].rotation
    pose.centre = wp.vec3(float(away[0]), float(away[1]), float(away[2]))
    pose.gain = stations[n].gain
    poses[n] = pose


@wp.kernel(module="unique", enable_backward=False)
def _move_kernel(
    offset: int,
    band: int,
    number: int,
    rotation: wp.mat33,
    centre: wp.vec3d,
    stations: wp.array(dtype=Station),
):
    moved = stations[number]
    moved.rotation = rotation
    moved.centre = centre
    stations[number] = moved


@lru_cache
def _station_type() -> Any:
    """NumPy type of a `Station`; Warp makes it anew each time, which takes longer than a launch."""
    station: Any = Station
    return np.dtype(station.numpy_dtype())


class Stations:
    """Poses and gains of photos, in float64, on a device.

    Args:
        world_from_camera: Shape (N, 4, 4), world NED [m].
        gains: Shape (N, 3), factors on the channels.
        device: Warp device.
    """

    def __init__(
        self, world_from_camera: NDArray[np.float64], gains: NDArray[np.float64], device: Any
    ) -> None:
        count = len(world_from_camera)
        rows: Any = np.zeros(count, dtype=_station_type())
        rows["rotation"] = world_from_camera[:, :3, :3].transpose(0, 2, 1)
        rows["centre"] = world_from_camera[:, :3, 3]
        rows["gain"] = gains
        self.device = device
        self._rows = wp.array(rows, dtype=Station, device=device)
        self._numbers = wp.array(np.arange(count, dtype=np.int32), dtype=int, device=device)

    def move(self, number: int, world_from_camera: NDArray[np.float64]) -> None:
        """Give one photo another pose; nothing waits.

        Args:
            number: Of the photo.
            world_from_camera: Shape (4, 4), world NED [m].
        """
        rotation = wp.mat33(*world_from_camera[:3, :3].T.ravel())
        inputs = [number, rotation, wp.vec3d(*world_from_camera[:3, 3]), self._rows]
        launch(_move_kernel, 1, inputs, self.device)

    def seen_from(self, eye: NDArray[np.float64]) -> Any:
        """Return a Warp array (N) of `Pose`; the next call in this thread writes over it.

        Args:
            eye: Shape (3,), what centres shall be relative to, so that float32 is exact, world
                NED [m].
        """
        count = self._rows.size
        poses = scratch("poses", count, Pose, self.device)
        launch(_seen_from_kernel, count, [wp.vec3d(*eye), self._rows, poses], self.device)
        return poses

    def numbers(self, order: NDArray[np.int32]) -> Any:
        """Return numbers of photos as a Warp array of int; only gaps have to be brought over.

        Args:
            order: Numbers of photos.
        """
        first, count = int(order[0]) if order.size else -1, order.size
        if first >= 0 and np.array_equal(order, np.arange(first, first + count)):
            return self._numbers[first : first + count]
        return wp.array(order, dtype=int, device=self.device)
