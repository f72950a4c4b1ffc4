"""The camera model inside kernels: projection with Brown-Conrady distortion and its inverse."""

import warp as wp

from hsvaos.camera import Camera

wp.set_module_options({"enable_backward": False})


@wp.struct
class Lens:
    """Intrinsics of a camera; see `hsvaos.Camera`."""

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    distorted: int
    max_radius2: float
    width: int
    height: int


def lens(camera: Camera) -> Lens:
    """Return the kernel's form of a camera."""
    result = Lens()
    for name in ("fx", "fy", "cx", "cy", "width", "height"):
        setattr(result, name, getattr(camera, name))
    for name, value in zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion, strict=True):
        setattr(result, name, value)
    result.distorted = int(camera.has_distortion)
    result.max_radius2 = min(camera.max_radius**2, 1e30)  # float32 holds no larger square
    return result


@wp.func
def distort(xy: wp.vec2, lens: Lens) -> wp.vec2:
    """Apply the lens distortion to normalised coordinates."""
    x, y = xy[0], xy[1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    return wp.vec2(
        x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (r2 + 2.0 * x * x),
        y * radial + lens.p1 * (r2 + 2.0 * y * y) + 2.0 * lens.p2 * x * y,
    )


@wp.func
def project(point: wp.vec3, lens: Lens) -> wp.vec3:
    """Pixel of a point in the camera frame, and 1, or 0 where it is behind or beyond the lens."""
    if point[2] <= 0.0:
        return wp.vec3(0.0, 0.0, 0.0)
    xy = wp.vec2(point[0] / point[2], point[1] / point[2])
    if lens.distorted != 0:
        if wp.dot(xy, xy) > lens.max_radius2:
            return wp.vec3(0.0, 0.0, 0.0)
        xy = distort(xy, lens)
    return wp.vec3(lens.fx * xy[0] + lens.cx, lens.fy * xy[1] + lens.cy, 1.0)


@wp.func
def back_project(pixel: wp.vec2, lens: Lens) -> wp.vec3:
    """Direction of the ray through a pixel with z = 1; z = 0 where the lens has none.

    Newton's method on `distort`; ten steps reach float32 for any real lens.
    """
    target = wp.vec2((pixel[0] - lens.cx) / lens.fx, (pixel[1] - lens.cy) / lens.fy)
    xy = target
    if lens.distorted != 0:
        for _ in range(10):
            x, y = xy[0], xy[1]
            r2 = x * x + y * y
            radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
            slope = 2.0 * (lens.k1 + r2 * (2.0 * lens.k2 + r2 * 3.0 * lens.k3))
            a = radial + slope * x * x + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x
            b = slope * x * y + 2.0 * lens.p1 * x + 2.0 * lens.p2 * y
            d = radial + slope * y * y + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x
            determinant = a * d - b * b
            if wp.abs(determinant) < 1.0e-12:
                return wp.vec3(0.0, 0.0, 0.0)
            error = distort(xy, lens) - target
            xy = (
                xy - wp.vec2(d * error[0] - b * error[1], a * error[1] - b * error[0]) / determinant
            )
        miss = distort(xy, lens) - target
        if wp.dot(xy, xy) > lens.max_radius2 or wp.dot(miss, miss) > 1.0e-8:
            return wp.vec3(0.0, 0.0, 0.0)
    return wp.vec3(xy[0], xy[1], 1.0)
