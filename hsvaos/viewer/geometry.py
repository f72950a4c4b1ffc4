"""Where the viewer looks from: views of browsers, ground pictures and outlines."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.flight import Flight, FlightError
from hsvaos.nav.attitude import matrix, normalize
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain
from hsvaos.viewing import ground_grid

Array = NDArray[np.float64]

_WIDEST_RAD = math.radians(150.0)
_NARROWEST_RAD = math.radians(0.5)

_GROUND_STEPS = 256
"""Resolution at which the extent of the ground is measured; the picture has its own."""


def browser_view(
    wxyz: ArrayLike, place: ArrayLike, fov_rad: float, size: tuple[int, int]
) -> VirtualCamera:
    """Return the virtual camera of a browser's view.

    Args:
        wxyz: Quaternion, world_from_camera, OpenCV axes.
        place: Centre, world NED [m].
        fov_rad: Vertical field of view [rad].
        size: Width and height [px].

    Raises:
        ValueError: If a number makes no sense.
    """
    numbers = [*np.ravel(wxyz), *np.ravel(place), fov_rad, *size]
    if not np.isfinite(numbers).all() or not np.any(wxyz) or min(size) < 1:
        raise ValueError(f"a view needs finite numbers, a rotation and a size, got {numbers}")
    fov = min(max(float(fov_rad), _NARROWEST_RAD), _WIDEST_RAD)
    width, height = (int(side) for side in size)
    focal = 0.5 * height / math.tan(0.5 * fov)
    camera = Camera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
    pose = np.eye(4)
    pose[:3, :3] = matrix(normalize(wxyz))
    pose[:3, 3] = np.asarray(place, np.float64)
    return VirtualCamera(camera, pose)


def fitted(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return a size shrunk, if needed, to a longest side, in whole and even pixels."""
    factor = min(1.0, longest / max(*size, 1))
    width, height = (max(2, 2 * round(0.5 * side * factor)) for side in size)
    return width, height


def vertical_fov(camera: Camera) -> float:
    """Return the vertical field of view of a camera without its distortion [rad]."""
    top, bottom = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    return math.atan(bottom) - math.atan(top)


class Ground:
    """The ground that the photos see, once for a flight.

    Args:
        flight: The flight, with poses.
        down_m: Down of the ground [m].

    Raises:
        FlightError: If no photo looks down at it.
    """

    def __init__(self, flight: Flight, down_m: float) -> None:
        places = flight.poses[:, :3, 3]
        height = max(down_m - float(places[:, 2].min()), 1e-3)
        coarse = height / _GROUND_STEPS
        grid = ground_grid(flight, FocalPlane(down_m), coarse)
        self.north0, self.east0 = (float(v) for v in grid.world_from_camera[:2, 3])
        self.length_m, self.width_m = grid.height * grid.gsd_m, grid.width * grid.gsd_m
        self.centre: Array = np.array(
            [self.north0 - 0.5 * self.length_m, self.east0 + 0.5 * self.width_m, down_m]
        )
        self.height_m = height

    @property
    def size_m(self) -> float:
        """Longer side of the ground [m]."""
        return max(self.length_m, self.width_m)

    def view(self, surface: FocalSurface, longest: int) -> VirtualCamera:
        """Return the grid of a picture that lies on the focal surface, as seen from above it.

        Args:
            surface: A plane, which the grid lies in, or a terrain, above whose middle it lies.
            longest: Longest side of the picture [px].
        """
        gsd = self.size_m / longest
        width, height = (max(2, round(side / gsd)) for side in (self.width_m, self.length_m))
        pose = np.eye(4)
        if isinstance(surface, FocalTerrain):
            pose[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
            middle = np.array([*self.centre[:2], float(np.nanmedian(surface.down_m))])
        else:
            normal = surface.normal * np.sign(surface.normal[2])
            east = np.cross([-1.0, 0.0, 0.0], normal)  # in the plane, square to the north
            east /= np.linalg.norm(east)
            pose[:3, :3] = np.stack([east, np.cross(normal, east), normal], axis=1)
            middle = self.centre.copy()
            off = (surface.point[:2] - middle[:2]) @ normal[:2]
            middle[2] = surface.point[2] + off / normal[2]
        half = 0.5 * gsd * np.array([width - 1, height - 1])
        pose[:3, 3] = middle - pose[:3, :2] @ half
        return VirtualCamera(None, pose, gsd, (width, height))

    def overview(self) -> tuple[Array, Array]:
        """Return a place from which cameras and ground are seen, and where to look [m]."""
        back = 0.75 * max(self.size_m, self.height_m)
        place = self.centre + np.array([-back, -0.35 * back, -self.height_m - 0.45 * back])
        return place, self.centre - np.array([0.05 * back, 0.0, 0.35 * self.height_m])


def corners_on(flight: Flight, index: int, surface: FocalSurface) -> Array | None:
    """Return where the corners of a photo meet the focal surface, or None where one does not.

    Args:
        flight: The flight, with poses.
        index: Number of the photo.
        surface: A terrain counts as level at its middle.

    Returns:
        Shape (4, 3), world NED [m], around the photo.
    """
    camera, pose = flight.camera, flight.poses[index]
    right, bottom = camera.width - 0.5, camera.height - 0.5
    corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    rays = camera.back_project(corners) @ pose[:3, :3].T
    if isinstance(surface, FocalTerrain):
        surface = FocalPlane(float(np.nanmedian(surface.down_m)))
    slopes = rays @ surface.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = ((surface.point - pose[:3, 3]) @ surface.normal) / slopes
    if not (np.isfinite(reach).all() and (reach > 0.0).all()):
        return None
    return np.asarray(pose[:3, 3] + rays * reach[:, None])


def outline(flight: Flight, surface: FocalSurface) -> Array:
    """Return the hull of what the photos see of the focal surface.

    Returns:
        Shape (K, 3), world NED [m]; empty where no photo sees it whole.
    """
    quads = [corners_on(flight, i, surface) for i in range(len(flight))]
    found = [quad for quad in quads if quad is not None]
    if not found:
        return np.zeros((0, 3))
    points = np.concatenate(found)
    middle = points[:, :2].mean(axis=0)
    flat = (points[:, :2] - middle).astype(np.float32)
    return np.asarray(points[cv2.convexHull(flat, returnPoints=False).ravel()])


def loop(points: Array) -> Array:
    """Return the line segments around some points, shape (K, 2, 3)."""
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def try_ground(flight: Flight, down_m: float) -> Ground | None:
    """Return the ground of a flight, or None where its photos see none."""
    try:
        return Ground(flight, down_m)
    except FlightError:
        return None
