"""The gather of packed photos on the CPU: 16 x 16 pixels at a time, frames outside, in vectors.

A tile's pixels stay in the nearest cache while all frames pass over it. Frames that cannot see a
tile are skipped by a test of its bounding sphere against the sides of their view, sixteen frames
at once; where the sphere lies inside a view no pixel is tested. The inner loop is plain C, which
the compiler turns into the vector instructions of the machine at hand.
"""

from functools import lru_cache
from string import Template
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.kernels.arrays import pixel_view
from hsvaos.kernels.device import launch
from hsvaos.kernels.packing import Packed
from hsvaos.kernels.tile_forms import FORMS, Form

wp.set_module_options({"enable_backward": False})

TILE = 16
"""Side of a tile [px]: one vector of 32-bit numbers."""

_GRAIN = 8
"""Tiles below which a band is not worth a thread."""

_TILE = Template("""{
    #pragma clang fp contract(fast)
    typedef unsigned char u8x16 __attribute__((vector_size(16)));
    typedef unsigned long long u64x2 __attribute__((vector_size(16)));
    typedef unsigned long long u64x4 __attribute__((vector_size(32)));
    typedef short i16x16 __attribute__((vector_size(32)));
    typedef int i32x8 __attribute__((vector_size(32)));
    typedef int i32x16 __attribute__((vector_size(64)));
    typedef _Float16 f16x8 __attribute__((vector_size(16)));
    typedef float f32x8 __attribute__((vector_size(32)));
    enum { SIDE = 16, SIZE = 256, CHUNK = 64 };
    const int tiles_x = (width + SIDE - 1) / SIDE;
    const int left = (tile % tiles_x) * SIDE, top = (tile / tiles_x) * SIDE;
    const int columns = width - left < SIDE ? width - left : SIDE;
    const int rows = height - top < SIDE ? height - top : SIDE;

    // points of the tile about the middle of their box, so that small differences stay exact
    alignas(64) float px[SIZE], py[SIZE], pz[SIZE], live[SIZE];
    float low[3] = {1e30f, 1e30f, 1e30f}, high[3] = {-1e30f, -1e30f, -1e30f};
    int seen = 0;
    for (int i = 0; i < SIZE; ++i) {
        const int x = i % SIDE, y = i / SIDE;
        live[i] = 0.0f;
        if (x >= columns || y >= rows) continue;
        const wp::vec4& p = points.data[(size_t)(top + y) * width + left + x];
        if (!(p[3] > 0.0f)) continue;
        live[i] = 1.0f;
        ++seen;
        px[i] = p[0], py[i] = p[1], pz[i] = p[2];
        for (int k = 0; k < 3; ++k) {
            low[k] = p[k] < low[k] ? p[k] : low[k];
            high[k] = p[k] > high[k] ? p[k] : high[k];
        }
    }
    float middle[3], radius = 0.0f;
    for (int k = 0; k < 3; ++k) {
        middle[k] = 0.5f * (low[k] + high[k]);
        radius += (high[k] - middle[k]) * (high[k] - middle[k]);
    }
    radius = __builtin_sqrtf(radius);
    for (int i = 0; i < SIZE; ++i) {
        px[i] = live[i] > 0.0f ? px[i] - middle[0] : 0.0f;
        py[i] = live[i] > 0.0f ? py[i] - middle[1] : 0.0f;
        pz[i] = live[i] > 0.0f ? pz[i] - middle[2] : 0.0f;
    }

    alignas(64) int places[2 * SIZE];
    $declare
    for (int i = 0; i < SIZE; ++i) { $clear }

    const float* m = poses.data;
    for (int start = 0; seen > 0 && start < count; start += CHUNK) {
        const int some = count - start < CHUNK ? count - start : CHUNK;
        alignas(64) float at_x[CHUNK], at_y[CHUNK], at_z[CHUNK];
        alignas(64) int state[CHUNK];  // 0: the frame cannot see the tile, 2: sees all of it
        #pragma clang loop vectorize(enable)
        for (int k = 0; k < some; ++k) {
            const float* f = m + start + k;
            const float dx = middle[0] - f[9 * count], dy = middle[1] - f[10 * count];
            const float dz = middle[2] - f[11 * count];
            const float x = f[0] * dx + f[count] * dy + f[2 * count] * dz;
            const float y = f[3 * count] * dx + f[4 * count] * dy + f[5 * count] * dz;
            const float z = f[6 * count] * dx + f[7 * count] * dy + f[8 * count] * dz;
            const float away = __builtin_sqrtf(dx * dx + dy * dy);
            // distance of the middle to each side of the view, in units of the sphere's radius
            float least = z - sides.data[4];
            float most = reach - away;
            const float s0 = (x - sides.data[0] * z) * sides.data[5];
            const float s1 = (sides.data[1] * z - x) * sides.data[6];
            const float s2 = (y - sides.data[2] * z) * sides.data[7];
            const float s3 = (sides.data[3] * z - y) * sides.data[8];
            least = s0 < least ? s0 : least;
            least = s1 < least ? s1 : least;
            least = s2 < least ? s2 : least;
            least = s3 < least ? s3 : least;
            least = most < least ? most : least;
            at_x[k] = x;
            at_y[k] = y;
            at_z[k] = z;
            state[k] = (least > -radius ? 1 : 0) + (least > radius ? 1 : 0);
        }
        int seeing[CHUNK], views = 0;
        for (int k = 0; k < some; ++k) {
            if (state[k] > 0) seeing[views++] = k;
        }
        // one frame ahead: its places are known, and on their way to the cache, when it is mixed
        for (int turn = 0; turn <= views; ++turn) {
            if (turn < views) {
                const int k = seeing[turn], half = (turn & 1) * SIZE;
                const float* f = m + start + k;
                const float x0 = at_x[k], y0 = at_y[k], z0 = at_z[k];
                const float m00 = f[0], m01 = f[count], m02 = f[2 * count];
                const float m10 = f[3 * count], m11 = f[4 * count], m12 = f[5 * count];
                const float m20 = f[6 * count], m21 = f[7 * count], m22 = f[8 * count];
                const float ax = middle[0] - f[9 * count], ay = middle[1] - f[10 * count];
                const float* l = sides.data + 9;
                if (state[k] == 2 && seen == SIZE && !distorted) {
                    #pragma clang loop vectorize(enable) vectorize_width(16)
                    for (int i = 0; i < SIZE; ++i) {
                        $project
                        const float u = x * near + 1.0f, v = y * near + 1.0f;
                        const bool in = true;
                        $place
                    }
                } else if (!distorted) {
                    #pragma clang loop vectorize(enable) vectorize_width(16)
                    for (int i = 0; i < SIZE; ++i) {
                        $project
                        float u = x * near, v = y * near;
                        $test
                        $place
                    }
                } else {
                    #pragma clang loop vectorize(enable) vectorize_width(16)
                    for (int i = 0; i < SIZE; ++i) {
                        $project
                        const float xn = x * near, yn = y * near;
                        $distort
                        $test
                        $place
                    }
                }
                const $word* frame = (const $word*)words.data
                    + (size_t)__builtin_bit_cast(int, f[12 * count]) * frame_stride;
                for (int i = 0; i < SIZE; i += 4) {
                    __builtin_prefetch(frame + places[half + i]);
                }
            }
            if (turn > 0) {
                const int half = (turn - 1 & 1) * SIZE;
                const float* f = m + start + seeing[turn - 1];
                const $word* frame = (const $word*)words.data
                    + (size_t)__builtin_bit_cast(int, f[12 * count]) * frame_stride;
                $gains
                $mix
            }
        }
    }
    for (int i = 0; i < SIZE; ++i) {
        const int x = i % SIDE, y = i / SIDE;
        if (x >= columns || y >= rows) continue;
        const size_t pixel = (size_t)(top + y) * width + left + x;
        const float weight = $weight;
        const float share = weight > 0.0f ? weight : 1.0f;
        footprint.data[pixel] = weight * weight_unit;
        $store
    }
}""")

_PROJECT = """
                        const float x = x0 + m00 * px[i] + m01 * py[i] + m02 * pz[i];
                        const float y = y0 + m10 * px[i] + m11 * py[i] + m12 * pz[i];
                        const float z = z0 + m20 * px[i] + m21 * py[i] + m22 * pz[i];
                        const float near = 1.0f / z;
"""

_DISTORT = """
                        const float r2 = xn * xn + yn * yn;
                        const float radial = 1.0f + r2 * (l[4] + r2 * (l[5] + r2 * l[8]));
                        float u = l[0] * (xn * radial + 2.0f * l[6] * xn * yn
                            + l[7] * (r2 + 2.0f * xn * xn)) + l[2];
                        float v = l[1] * (yn * radial + l[6] * (r2 + 2.0f * yn * yn)
                            + 2.0f * l[7] * xn * yn) + l[3];
                        u = r2 <= l[9] ? u : -9.0f;
"""

_TEST = """
                        const float ex = ax + px[i], ey = ay + py[i];
                        const bool in = (z > 0.0f) & (u >= -0.5f) & (v >= -0.5f) & (u <= right)
                            & (v <= bottom) & (ex * ex + ey * ey <= reach * reach)
                            & (live[i] > 0.0f);
                        u = in ? u + 1.0f : 0.0f;
                        v = in ? v + 1.0f : 0.0f;
"""


_PLACE = """
                        const int ui = (int)u, vi = (int)v;
                        const float fu = u - (float)ui, fv = v - (float)vi;
                        places[half + i] = vi * row_stride + ui;
"""


def _snippet(form: Form) -> str:
    """C of the tile gather for one form of packed photos."""
    channels = range(form.channels)
    gains = "".join(f"const float gain_{c} = f[{13 + c} * count];\n" for c in channels)
    store = "".join(
        f"image.data[pixel * {form.channels} + {c}] = {form.sums[c]} * white / share;\n"
        for c in channels
    )
    return _TILE.substitute(
        word=form.word,
        declare=form.declare,
        clear=form.clear,
        gains=gains,
        project=_PROJECT,
        test=_TEST,
        distort=_DISTORT,
        place=_PLACE + form.place,
        mix=form.mix,
        weight=form.sums[-1],
        store=store,
    )


@lru_cache
def _tile_kernel(form: str) -> Any:
    @wp.func_native(_snippet(FORMS[form]))
    def gather_tile(
        tile: int,
        width: int,
        height: int,
        points: wp.array(dtype=wp.vec4),
        count: int,
        poses: wp.array(dtype=float),
        sides: wp.array(dtype=float),
        distorted: int,
        right: float,
        bottom: float,
        reach: float,
        row_stride: int,
        frame_stride: int,
        weight_unit: float,
        white: float,
        words: wp.array(dtype=wp.uint32),
        image: wp.array(dtype=float),
        footprint: wp.array(dtype=float),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def tile_kernel(
        offset: int,
        band: int,
        width: int,
        height: int,
        points: wp.array(dtype=wp.vec4),
        count: int,
        poses: wp.array(dtype=float),
        sides: wp.array(dtype=float),
        distorted: int,
        right: float,
        bottom: float,
        reach: float,
        row_stride: int,
        frame_stride: int,
        weight_unit: float,
        white: float,
        words: wp.array(dtype=wp.uint32),
        image: wp.array(dtype=float),
        footprint: wp.array(dtype=float),
    ):
        gather_tile(
            wp.tid() + offset,
            width,
            height,
            points,
            count,
            poses,
            sides,
            distorted,
            right,
            bottom,
            reach,
            row_stride,
            frame_stride,
            weight_unit,
            white,
            words,
            image,
            footprint,
        )

    return tile_kernel


def gather_tiles(
    camera: Camera,
    packed: Packed,
    poses: NDArray[np.float64],
    gains: NDArray[np.float64],
    order: NDArray[np.int32],
    reach: float,
    points: Any,
    size: tuple[int, int],
    image: Any,
    footprint: Any,
) -> None:
    """Integrate packed photos at given points, on the CPU.

    Args:
        camera: Camera of the photos.
        packed: The photos.
        poses: Shape (N, 4, 4), world from camera, relative to the points' origin.
        gains: Shape (N, 3), factors on the channels.
        order: Numbers of the frames to use.
        reach: Greatest horizontal distance of a photo from a point [m].
        points: Warp array (H * W) of vec4, see `focal_points`.
        size: (width, height) of the view [px].
        image: Warp array (H * W * C), float32, written.
        footprint: Warp array (H * W), float32, written.
    """
    count = len(order)
    rotation = poses[order, :3, :3].transpose(0, 2, 1)
    if not camera.has_distortion:
        rotation = camera.matrix() @ rotation
    rows = np.empty((16, count), np.float32)
    rows[:9] = rotation.reshape(count, 9).T
    rows[9:12] = poses[order, :3, 3].T
    rows[12] = order.astype(np.int32).view(np.float32)
    rows[13:16] = gains[order].T
    width, height = size
    tiles = -(-width // TILE) * -(-height // TILE)
    inputs = [
        *(width, height, points, count),
        wp.array(rows.ravel(), dtype=float, device="cpu"),
        wp.array(_sides(camera), dtype=float, device="cpu"),
        *(int(camera.has_distortion), camera.width - 0.5, camera.height - 0.5, reach),
        *(packed.row, packed.frame, packed.weight_unit * FORMS[packed.form].unit, packed.white),
        packed.words,
        *(pixel_view(x, wp.float32, (x.size,)) for x in (image, footprint)),
    ]
    launch(_tile_kernel(packed.form), tiles, inputs, wp.get_device("cpu"), _GRAIN)


def _sides(camera: Camera) -> NDArray[np.float32]:
    """Return the sides of a camera's view, and its lens, as the tile gather wants them.

    A side is a plane x = a z through the camera's centre, x in pixels (of normalised coordinates
    where the lens distorts): the four a, 0, the four factors that make x - a z a distance [m],
    and the intrinsics, the distortion and the square of the greatest radius.
    """
    if camera.has_distortion:
        a = _undistorted_bounds(camera)
        scale = np.ones(4)
        shift = np.zeros(4)
    else:
        a = np.array([-0.5, camera.width - 0.5, -0.5, camera.height - 0.5])
        scale = np.repeat([camera.fx, camera.fy], 2)
        shift = np.repeat([camera.cx, camera.cy], 2)
    # the rotation may be off by 1e-3 (see check_pose): the factor of 0.99 keeps the test safe
    factors = 0.99 / np.hypot(scale, a - shift)
    lens = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
    return np.array([*a, 0.0, *factors, *lens, min(camera.max_radius**2, 1e30)], np.float32)


def _undistorted_bounds(camera: Camera) -> NDArray[np.float64]:
    """Bounds of the normalised coordinates that the lens maps into the photo: x, x, y, y."""
    right, bottom = camera.width - 0.5, camera.height - 0.5
    across, along = np.linspace(-0.5, right, 65), np.linspace(-0.5, bottom, 65)
    border = np.concatenate(
        [
            *(np.column_stack([across, np.full(65, y)]) for y in (-0.5, bottom)),
            *(np.column_stack([np.full(65, x), along]) for x in (-0.5, right)),
        ]
    )
    rays = camera.back_project(border)[:, :2]
    if not np.isfinite(rays).all():  # the lens ends within the photo
        radius = min(camera.max_radius, 1e3)
        return np.array([-radius, radius, -radius, radius])
    low, high = rays.min(axis=0), rays.max(axis=0)
    margin = 0.02 * (high - low)
    low, high = low - margin, high + margin
    return np.array([low[0], high[0], low[1], high[1]])
