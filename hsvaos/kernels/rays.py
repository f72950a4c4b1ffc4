"""Rays of a virtual camera, and where they meet the focal surface."""

import threading
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import Camera, VirtualCamera
from hsvaos.kernels.device import ROW_GRAIN, in_vectors, launch, resolve_device
from hsvaos.kernels.lens import Lens, back_project, lens
from hsvaos.kernels.scratch import scratch
from hsvaos.surface import FocalPlane, FocalSurface, FocalTerrain

wp.set_module_options({"enable_backward": False})

_NARROWINGS = 20
"""Of a step that crossed the terrain, by false position and then, if need be, by halving: the
second alone makes a micrometre of 1 m."""

_CLOSE_M = 2.0e-6
"""Height over the terrain that is none: float32 tells no less apart some 20 m from the camera."""


_heights: WeakKeyDictionary[FocalTerrain, dict[str, Any]] = WeakKeyDictionary()
"""Downs of terrains by device, brought there once."""

_here = threading.local()

_LEVEL = 1.0e-9
"""Sine of the angle with a plane below which a ray runs along it."""


@wp.struct
class Eye:
    """A virtual camera: its lens or ground grid, and rotation; its centre is the origin."""

    lens: Lens
    rotation: wp.mat33
    gsd: float


@wp.struct
class Terrain:
    """Placement of a height field relative to the virtual camera's centre [m].

    Its downs are held relative to its lowest node, which lies at `level`.
    """

    north0: float
    east0: float
    spacing: float
    level: float
    top: float
    bottom: float


@wp.func
def ray(pixel: int, width: int, eye: Eye) -> tuple[wp.vec3, wp.vec3]:
    """Origin and direction of the ray of a pixel; the direction is zero where there is none."""
    u = float(pixel % width)
    v = float(pixel // width)
    if eye.gsd > 0.0:
        place = eye.rotation * wp.vec3(u * eye.gsd, v * eye.gsd, 0.0)
        return place, eye.rotation * wp.vec3(0.0, 0.0, 1.0)
    return wp.vec3(0.0, 0.0, 0.0), eye.rotation * back_project(wp.vec2(u, v), eye.lens)


@wp.func
def terrain_down(
    north: float, east: float, terrain: Terrain, down: wp.array2d(dtype=float)
) -> float:
    """Bilinear down of the height field; NaN outside and over holes."""
    y = (north - terrain.north0) / terrain.spacing
    x = (east - terrain.east0) / terrain.spacing
    rows, columns = down.shape[0], down.shape[1]
    if not (x >= 0.0 and y >= 0.0 and x <= float(columns - 1) and y <= float(rows - 1)):
        return wp.nan
    i = wp.min(int(y), rows - 2)
    j = wp.min(int(x), columns - 2)
    fy = y - float(i)
    fx = x - float(j)
    upper = down[i, j] * (1.0 - fx) + down[i, j + 1] * fx
    lower = down[i + 1, j] * (1.0 - fx) + down[i + 1, j + 1] * fx
    return terrain.level + (upper * (1.0 - fy) + lower * fy)


@wp.func
def plane_hit(
    origin: wp.vec3, direction: wp.vec3, point: wp.vec3, normal: wp.vec3, forward_only: int
) -> wp.vec4:
    """Intersection with a plane and 1, or 0 where the ray misses it."""
    slope = wp.dot(normal, direction)
    if wp.abs(slope) < _LEVEL:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    t = wp.dot(normal, point - origin) / slope
    if forward_only != 0 and t <= 0.0:
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    hit = origin + t * direction
    return wp.vec4(hit[0], hit[1], hit[2], 1.0)


@wp.func
def _depth(
    origin: wp.vec3,
    direction: wp.vec3,
    t: float,
    terrain: Terrain,
    down: wp.array2d(dtype=float),
) -> float:
    """How far a point of a ray lies below the height field [m]; NaN where there is none."""
    place = origin + t * direction
    return place[2] - terrain_down(place[0], place[1], terrain, down)


@wp.func
def _crossing(
    origin: wp.vec3,
    direction: wp.vec3,
    terrain: Terrain,
    down: wp.array2d(dtype=float),
    above: float,
    below: float,
    depth_above: float,
    depth_below: float,
) -> float:
    """Where between a point above the height field (depth < 0) and one below it a ray crosses."""
    low = above
    high = below
    f_low = depth_above
    f_high = depth_below
    moved = int(0)
    for k in range(2 * _NARROWINGS):
        middle = high - f_high * (high - low) / (f_high - f_low)
        # over kinks false position may creep: what it has not found by then is halved
        if k >= _NARROWINGS or not (middle > low and middle < high):
            middle = 0.5 * (low + high)
            if middle <= low or middle >= high:
                return high
        f = _depth(origin, direction, middle, terrain, down)
        if wp.abs(f) <= _CLOSE_M:
            return middle
        if f < 0.0:
            low = middle
            f_low = f
            if moved == 1:  # the other end stayed twice: it counts half
                f_high = 0.5 * f_high
            moved = int(1)
        else:
            high = middle
            f_high = f
            if wp.isnan(f):  # a hole: halve
                f_high = -f_low
            elif moved == 2:
                f_low = 0.5 * f_low
            moved = int(2)
    return high


@wp.func
def terrain_hit(
    origin: wp.vec3,
    direction: wp.vec3,
    terrain: Terrain,
    down: wp.array2d(dtype=float),
    forward_only: int,
) -> wp.vec4:
    """First point where a falling ray goes below the height field, and 1; or 0 where it misses.

    The ray is followed from the highest to the lowest level of the terrain in steps of at most
    half a grid cell over the ground. The step that crosses is narrowed by the Illinois form of the
    rule of false position (Dowell and Jarratt 1971). Rays that do not fall (towards or above the
    horizon) meet no ground.
    """
    nothing = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if direction[2] <= 1.0e-6:
        return nothing
    start = (terrain.top - origin[2]) / direction[2]
    stop = (terrain.bottom - origin[2]) / direction[2]
    if forward_only != 0:
        start = wp.max(start, 0.0)
    if stop < start:
        return nothing
    across = wp.sqrt(direction[0] * direction[0] + direction[1] * direction[1]) * (stop - start)
    steps = wp.min(int(2.0 * across / terrain.spacing) + 1, 100000)
    step = (stop - start) / float(steps)
    before = start
    depth_before = float(-1.0)
    above = int(0)
    for k in range(steps + 1):
        t = start + float(k) * step
        depth = _depth(origin, direction, t, terrain, down)
        if wp.isnan(depth):
            above = int(0)
        elif depth < 0.0:
            above = int(1)
            before = t
            depth_before = depth
        else:
            if above == 0 and k > 0:
                return nothing
            if above == 1:
                t = _crossing(origin, direction, terrain, down, before, t, depth_before, depth)
            hit = origin + t * direction
            return wp.vec4(hit[0], hit[1], hit[2], 1.0)
    return nothing


@wp.kernel(module="unique", enable_backward=False)
def _plane_points(
    offset: int,
    band: int,
    width: int,
    eye: Eye,
    point: wp.vec3,
    normal: wp.vec3,
    hits: wp.array(dtype=wp.vec4),
):
    i = wp.tid() + offset
    origin, direction = ray(i, width, eye)
    hits[i] = plane_hit(origin, direction, point, normal, int(eye.gsd == 0.0))


@wp.func_native("""
    #pragma clang loop vectorize(enable)
    for (int column = 0; column < width; ++column) {
        const float u = (float)column, v = (float)row;
        const float slope = slopes[0] * u + slopes[1] * v + slopes[2];
        const float hit = slope > least ? 1.0f : 0.0f;
        const float scale = slope > least ? 1.0f / slope : 0.0f;
        wp::vec4& out = hits.data[(size_t)row * width + column];
        out[0] = (m.data[0][0] * u + m.data[0][1] * v + m.data[0][2]) * scale;
        out[1] = (m.data[1][0] * u + m.data[1][1] * v + m.data[1][2]) * scale;
        out[2] = (m.data[2][0] * u + m.data[2][1] * v + m.data[2][2]) * scale;
        out[3] = hit;
    }
""")
def _plane_row(
    row: int,
    width: int,
    m: wp.mat33,
    slopes: wp.vec3,
    least: float,
    hits: wp.array(dtype=wp.vec4),
): ...


@wp.kernel(module="unique", enable_backward=False)
def _plane_rows(
    offset: int,
    band: int,
    width: int,
    m: wp.mat33,
    slopes: wp.vec3,
    least: float,
    hits: wp.array(dtype=wp.vec4),
):
    _plane_row(wp.tid() + offset, width, m, slopes, least, hits)


@wp.kernel(module="unique", enable_backward=False)
def _terrain_points(
    offset: int,
    band: int,
    width: int,
    eye: Eye,
    terrain: Terrain,
    down: wp.array2d(dtype=float),
    hits: wp.array(dtype=wp.vec4),
):
    i = wp.tid() + offset
    origin, direction = ray(i, width, eye)
    hits[i] = terrain_hit(origin, direction, terrain, down, int(eye.gsd == 0.0))


def focal_points(
    view: VirtualCamera, surface: FocalSurface, *, out: Any = None, device: Any = "cpu"
) -> Any:
    """Return where the ray of every pixel meets the focal surface.

    Points are relative to the virtual camera's centre, so that float32 is exact to micrometres
    however far the world's origin lies.

    Args:
        view: The virtual camera or ground grid.
        surface: Plane of any orientation, or height field.
        out: Warp array (H * W) of vec4, written in place; new if None.
        device: Where to run.

    Returns:
        Warp array (H * W) of vec4: north, east, down minus those of the view's centre [m], and 1;
        all 0 where the ray meets nothing.
    """
    device = resolve_device(device)
    size = view.width * view.height
    hits = wp.empty(size, dtype=wp.vec4, device=device) if out is None else out
    eye = Eye()
    eye.lens = lens(view.camera or Camera.from_fov(1, 1, 90.0))
    eye.rotation = wp.mat33(*view.world_from_camera[:3, :3].ravel())
    eye.gsd = view.gsd_m
    centre = view.world_from_camera[:3, 3]
    if isinstance(surface, FocalPlane):
        if in_vectors(device) and not (view.camera and view.camera.has_distortion):
            to = plane_map(view, surface)
            matrix = (wp.mat33(*to.points.ravel()), wp.vec3(*to.scales), to.least)
            inputs = [view.width, *matrix, hits]
            launch(_plane_rows, view.height, inputs, device, ROW_GRAIN)
            return hits
        place = [view.width, eye, wp.vec3(*(surface.point - centre)), wp.vec3(*surface.normal)]
        launch(_plane_points, size, [*place, hits], device)
        return hits
    terrain, heights = place_terrain(surface, centre, device)
    launch(_terrain_points, size, [view.width, eye, terrain, heights, hits], device)
    return hits


def held_points(view: VirtualCamera, surface: FocalSurface, device: Any) -> Any:
    """Return focal points in memory that the next call in this thread writes over.

    On the CPU those of a terrain, which take longer than an integral, are not found again while the
    same are asked for. A captured CUDA graph finds them anew: it is replayed after anything.

    Args:
        view: See `focal_points`.
        surface: See `focal_points`.
        device: Warp device.
    """
    size = view.width * view.height
    points = scratch("points", size, wp.vec4, device)
    asked = None
    if in_vectors(device) and isinstance(surface, FocalTerrain):
        pose = view.world_from_camera.tobytes()
        asked = (view.camera, pose, view.gsd_m, view.size, surface, int(points.ptr))
    if asked is None or getattr(_here, "asked", None) != asked:
        _here.asked = None
        focal_points(view, surface, out=points, device=device)
        _here.asked = asked
    return points


@dataclass(frozen=True, eq=False)
class PlaneMap:
    """The projective map from pixels of an undistorted view to points of a plane.

    Args:
        points: Shape (3, 3), float64, times a pixel (u, v, 1), over `scales` times that pixel, is
            the point relative to the view's centre [m].
        scales: Shape (3,), float64.
        least: What the scale of a pixel must exceed where its ray meets the plane.
    """

    points: NDArray[np.float64]
    scales: NDArray[np.float64]
    least: float


def plane_map(view: VirtualCamera, plane: FocalPlane) -> PlaneMap:
    """Return the map from pixels of an undistorted view to points of a plane.

    Args:
        view: The virtual camera or ground grid.
        plane: The focal plane.
    """
    rotation = view.world_from_camera[:3, :3]
    above = plane.normal @ (plane.point - view.world_from_camera[:3, 3])
    nothing = PlaneMap(np.zeros((3, 3)), np.zeros(3), 0.0)
    if view.camera is None:
        slope = plane.normal @ rotation[:, 2]
        if abs(slope) < _LEVEL:
            return nothing
        origins = np.column_stack([rotation[:, :2] * view.gsd_m, np.zeros(3)])
        way = -plane.normal @ origins + [0.0, 0.0, above]
        points = origins + np.outer(rotation[:, 2], way / slope)
        return PlaneMap(points, np.array([0.0, 0.0, 1.0]), 0.0)
    if above == 0.0:
        return nothing
    directions = rotation @ np.linalg.inv(view.camera.matrix())
    return PlaneMap(directions, plane.normal @ directions / above, float(_LEVEL / abs(above)))


def place_terrain(
    surface: FocalTerrain, centre: NDArray[np.float64], device: Any
) -> tuple[Terrain, Any]:
    """Return a height field's placement relative to a centre, and its downs, for kernels.

    Args:
        surface: The height field.
        centre: Shape (3,), world NED [m].
        device: Warp device.
    """
    terrain = Terrain()
    terrain.north0 = surface.north0_m - centre[0]
    terrain.east0 = surface.east0_m - centre[1]
    terrain.spacing = surface.spacing_m
    terrain.level = surface.lowest_m - centre[2]
    terrain.top = surface.highest_m - centre[2] - 1e-3  # just above, so that the top is crossed
    terrain.bottom = surface.lowest_m - centre[2] + 1e-3
    held = _heights.setdefault(surface, {})
    if device.alias not in held:
        heights = (surface.down_m.astype(np.float64) - surface.lowest_m).astype(np.float32)
        held[device.alias] = wp.array(heights, dtype=float, device=device)
    return terrain, held[device.alias]
