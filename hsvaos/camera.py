"""Cameras: pinhole with Brown-Conrady distortion, and the virtual views rendered from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]

_UNDISTORT_STEPS = 20
"""Newton steps; each about squares the error, so this is far more than any real lens needs."""

FARTHEST_M = 1e7
"""Camera positions farther than this from the origin of the local frame are taken for errors [m].

It is the distance from the pole to the equator."""


def finite_number(value: Any, name: str) -> float:
    """Return a number as float, or say what is wrong with it.

    Args:
        value: The number.
        name: What to call it in the message.

    Raises:
        TypeError: If it is no real number.
        ValueError: If it is NaN, infinite or beyond the range of float64.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name} must be a number, got {value!r}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {value!r}")
    return number


def checked_fov(fov_deg: Any) -> float:
    """Return a field of view as float.

    Raises:
        TypeError: If it is no real number.
        ValueError: If it is outside (0, 180).
    """
    angle = finite_number(fov_deg, "fov_deg")
    if not 0.0 < angle < 180.0:
        raise ValueError(f"fov_deg must lie between 0 and 180 degrees, got {fov_deg!r}")
    return angle


def _pixel_count(value: Any, name: str) -> int:
    number = finite_number(value, name)
    if number < 1.0 or not number.is_integer():
        raise ValueError(f"{name} must be a positive whole number of pixels, got {value!r}")
    return int(number)


@dataclass(frozen=True)
class Camera:
    """Pinhole camera with Brown-Conrady distortion, OpenCV axes (x right, y down, z forward).

    Pixel centres lie at integer coordinates, so the image covers [-0.5, width - 0.5] x
    [-0.5, height - 0.5].

    Args:
        width: Image width [px].
        height: Image height [px].
        fx: Focal length along x [px].
        fy: Focal length along y [px].
        cx: Principal point [px].
        cy: Principal point [px].
        distortion: Brown-Conrady coefficients (k1, k2, p1, p2, k3) (Brown 1966; OpenCV's order).

    Raises:
        ValueError: If a size or a focal length is not positive, or a number is not finite.
        TypeError: If one of them is no number.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            object.__setattr__(self, name, _pixel_count(getattr(self, name), name))
        for name in ("fx", "fy", "cx", "cy"):
            value = finite_number(getattr(self, name), name)
            if name in ("fx", "fy") and value <= 0:
                raise ValueError(f"{name} must be a positive focal length in pixels, got {value!r}")
            object.__setattr__(self, name, value)
        try:
            coefficients = [finite_number(k, "distortion") for k in self.distortion]
        except (TypeError, ValueError):
            coefficients = []
        if len(coefficients) != 5:
            raise ValueError(
                f"distortion must be 5 finite numbers (k1, k2, p1, p2, k3), got {self.distortion!r}"
            )
        object.__setattr__(self, "distortion", tuple(coefficients))

    @classmethod
    def from_fov(cls, width: int, height: int, fov_deg: float) -> Camera:
        """Return an undistorted camera from its horizontal field of view.

        Args:
            width: Image width [px].
            height: Image height [px].
            fov_deg: Horizontal field of view over the full width [deg], between 0 and 180.

        Raises:
            ValueError: If fov_deg is outside (0, 180), or a size is not positive.
            TypeError: If one of them is no number.
        """
        width, height = _pixel_count(width, "width"), _pixel_count(height, "height")
        fov_deg = checked_fov(fov_deg)
        focal = width / 2.0 / np.tan(np.radians(fov_deg) / 2.0)
        return cls(width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0)

    @property
    def fov_deg(self) -> float:
        """Horizontal field of view without distortion [deg]."""
        left, right = (-0.5 - self.cx) / self.fx, (self.width - 0.5 - self.cx) / self.fx
        return float(np.degrees(np.arctan(right) - np.arctan(left)))

    @property
    def has_distortion(self) -> bool:
        """Whether any distortion coefficient differs from zero."""
        return any(self.distortion)

    def without_distortion(self) -> Camera:
        """Return the same camera with all distortion coefficients zero."""
        return replace(self, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))

    def scaled(self, width: int, height: int) -> Camera:
        """Return the camera of the same photo resampled to another size.

        Args:
            width: New width [px].
            height: New height [px].
        """
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )

    def widened(self, margin_px: int) -> Camera:
        """Return the camera of the same picture with more of the scene on every side.

        Args:
            margin_px: Rows and columns that every side gains; the old pixel (0, 0) is at
                (margin_px, margin_px) in the new picture [px].
        """
        return replace(
            self,
            width=self.width + 2 * margin_px,
            height=self.height + 2 * margin_px,
            cx=self.cx + margin_px,
            cy=self.cy + margin_px,
        )

    @property
    def max_radius(self) -> float:
        """Largest undistorted radius sqrt(x^2 + y^2), at z = 1, where the lens model may be used.

        The Brown-Conrady polynomial is not monotonic for ever: beyond the radius where
        d(r (1 + k1 r^2 + k2 r^4 + k3 r^6)) / dr = 0 it folds far-away points back into the image.
        Infinite where the polynomial never turns.
        """
        k1, k2, _, _, k3 = self.distortion
        roots = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
        real = roots[np.isreal(roots)].real
        turning = real[real > 0.0]
        return float(np.sqrt(turning.min())) if turning.size else float("inf")

    def distort(self, xy: ArrayLike) -> Matrix:
        """Apply the lens distortion to normalised image coordinates.

        Args:
            xy: Shape (..., 2), x/z and y/z in the camera frame.

        Returns:
            Shape (..., 2), float64, distorted normalised coordinates.
        """
        k1, k2, p1, p2, k3 = self.distortion
        points = np.asarray(xy, dtype=np.float64)
        x, y = points[..., 0], points[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )

    def project(self, points_camera: ArrayLike) -> Matrix:
        """Project points in the camera frame to pixels.

        Args:
            points_camera: Shape (..., 3), camera frame [m].

        Returns:
            Shape (..., 2), float64 [px]; NaN for points not in front of the camera or beyond
            `max_radius`.
        """
        points = np.asarray(points_camera, dtype=np.float64)
        z = points[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = points[..., :2] / z[..., None]
            usable = (z > 0.0) & (np.hypot(xy[..., 0], xy[..., 1]) <= self.max_radius)
            xy = np.where(usable[..., None], xy, np.nan)
        return self.distort(xy) * (self.fx, self.fy) + (self.cx, self.cy)

    def back_project(self, pixels: ArrayLike) -> Matrix:
        """Return the direction of the ray through each pixel, with z = 1.

        The distortion is inverted by Newton's method on `distort`.

        Args:
            pixels: Shape (..., 2) [px].

        Returns:
            Shape (..., 3), float64, camera frame. NaN where no direction maps to the pixel.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        target = (pixels - (self.cx, self.cy)) / (self.fx, self.fy)
        xy = target.copy()
        if self.has_distortion:
            for _ in range(_UNDISTORT_STEPS):
                xy = xy - self._newton_step(xy, target)
            wrong = ~(np.abs(self.distort(xy) - target).max(axis=-1) < 1e-6)
            # beyond the turning point another, farther direction maps to the pixel: not the lens's
            wrong |= ~(np.hypot(xy[..., 0], xy[..., 1]) <= self.max_radius)
            xy[wrong] = np.nan
        return np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)

    def _newton_step(self, xy: Matrix, target: Matrix) -> Matrix:
        k1, k2, p1, p2, k3 = self.distortion
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        xy_ = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        error = self.distort(xy) - target
        determinant = xx * yy - xy_ * xy_
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack(
                [
                    (yy * error[..., 0] - xy_ * error[..., 1]) / determinant,
                    (xx * error[..., 1] - xy_ * error[..., 0]) / determinant,
                ],
                axis=-1,
            )

    def matrix(self) -> Matrix:
        """Return the 3x3 intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


def check_pose(pose: ArrayLike, name: str) -> Matrix:
    """Return a rigid transform as 4x4 float64, or say what is wrong with it.

    Args:
        pose: 3x4 or 4x4 matrix [R | t] with R a rotation and t in metres.
        name: What to call it in the message.

    Raises:
        ValueError: If the shape, a NaN, a matrix that is no rotation, or a position farther than
            `FARTHEST_M` from the origin forbids its use.
    """
    try:
        matrix = np.array(pose, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a 4x4 matrix of numbers, got {pose!r:.60}") from None
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4):
        raise ValueError(f"{name} must be a 4x4 matrix, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity")
    rotation = matrix[:3, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not error <= 1e-3 or np.linalg.det(rotation) < 0.0:
        raise ValueError(
            f"{name} must hold a rotation (R R' = I, det R = 1), got |R R' - I| = {error:.2g} "
            f"and det R = {np.linalg.det(rotation):.3f}"
        )
    if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"{name} must have the last row 0 0 0 1, got {matrix[3].tolist()}")
    distance = math.hypot(*matrix[:3, 3])
    if distance > FARTHEST_M:
        raise ValueError(
            f"{name} must lie within {FARTHEST_M / 1e3:.0f} km of the origin, "
            f"got {distance / 1e3:.3g} km"
        )
    return matrix


@dataclass(frozen=True, eq=False)
class VirtualCamera:
    """The view an integral image is rendered for: a pinhole camera at a pose, or a ground grid.

    Args:
        camera: Intrinsics of the view. Its distortion is honoured: give
            `camera.without_distortion()` for a pinhole picture.
        world_from_camera: Shape (4, 4), camera frame to world NED [m].

    Raises:
        ValueError: If the pose holds no rotation or is not finite, or a view without a camera has
            no ground sampling distance or no size.
        TypeError: If the camera is none.
    """

    camera: Camera | None
    world_from_camera: Matrix
    gsd_m: float = 0.0
    """Ground sampling distance of an orthographic view [m/px]; 0 for a pinhole view."""
    size: tuple[int, int] = (0, 0)
    """(width, height) [px]."""

    def __post_init__(self) -> None:
        pose = check_pose(self.world_from_camera, "world_from_camera")
        object.__setattr__(self, "world_from_camera", pose)
        if self.camera is None:
            gsd_m = finite_number(self.gsd_m, "gsd_m")
            if gsd_m <= 0.0:
                raise ValueError(
                    f"gsd_m of a view without a camera must be a positive number of metres "
                    f"(see VirtualCamera.ortho), got {self.gsd_m!r}"
                )
            width, height = self.size
            size = _pixel_count(width, "width"), _pixel_count(height, "height")
            object.__setattr__(self, "gsd_m", gsd_m)
        elif isinstance(self.camera, Camera):
            size = self.camera.width, self.camera.height
        else:
            raise TypeError(f"camera must be a Camera, got {self.camera!r}")
        object.__setattr__(self, "size", size)

    @classmethod
    def ortho(
        cls, north0: float, east0: float, gsd_m: float, width: int, height: int
    ) -> VirtualCamera:
        """Return an orthographic ground grid, north up, seen from straight above.

        Pixel (column c, row r) is centred on north0 - r gsd_m, east0 + c gsd_m.

        Args:
            north0: North of the centre of the top left pixel [m].
            east0: East of the centre of the top left pixel [m].
            gsd_m: Ground sampling distance [m/px].
            width: Columns, counted to the east [px].
            height: Rows, counted to the south [px].

        Raises:
            ValueError: If gsd_m or a size is not positive, or a size is no whole number.
            TypeError: If one of them is no number.
        """
        if not finite_number(gsd_m, "gsd_m") > 0.0:
            raise ValueError(f"gsd_m must be a positive number of metres, got {gsd_m!r}")
        north0, east0 = finite_number(north0, "north0"), finite_number(east0, "east0")
        pose = np.eye(4)
        pose[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]  # x = E, y = S, z = D
        pose[:3, 3] = [north0, east0, 0.0]
        return cls(None, pose, gsd_m, (width, height))

    @property
    def is_ortho(self) -> bool:
        """Whether the rays are parallel (a ground grid)."""
        return self.camera is None

    @property
    def width(self) -> int:
        """Columns [px]."""
        return self.size[0]

    @property
    def height(self) -> int:
        """Rows [px]."""
        return self.size[1]

    def rays(self, pixels: ArrayLike) -> tuple[Matrix, Matrix]:
        """Return origin and direction of the ray through each pixel.

        Args:
            pixels: Shape (..., 2) [px].

        Returns:
            origins and directions, each shape (..., 3), float64, world NED [m]; directions have
            unit length along the optical axis.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        rotation, centre = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        if self.camera is not None:
            directions = self.camera.back_project(pixels) @ rotation.T
            return np.broadcast_to(centre, directions.shape).copy(), directions
        flat = np.zeros((*pixels.shape[:-1], 3))
        flat[..., :2] = pixels * self.gsd_m
        return centre + flat @ rotation.T, np.broadcast_to(rotation[:, 2], flat.shape).copy()

    def project(self, points_world: ArrayLike) -> Matrix:
        """Project world points to pixels of this view.

        Args:
            points_world: Shape (..., 3), world NED [m].

        Returns:
            Shape (..., 2), float64 [px]; NaN for points that the view cannot show.
        """
        rotation, centre = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        points = (np.asarray(points_world, dtype=np.float64) - centre) @ rotation
        if self.camera is not None:
            return self.camera.project(points)
        return np.asarray(points[..., :2] / self.gsd_m)
