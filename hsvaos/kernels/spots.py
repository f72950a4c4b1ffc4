"""In which pixel each photo sees a point: the nearest one, by photo, or for all photos at once."""

from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.kernels.lens import Lens, project
from hsvaos.kernels.stations import Pose

wp.set_module_options({"enable_backward": False})

# lens.project for all photos of a list, uncontracted: the same pixels as one by one
_FIND = """{
    #pragma clang fp contract(off)
    const int count = places.shape[1];
    const float* m = rows.data;
    int* to = places.data + (size_t)band * count;
    const float px = place[0], py = place[1], pz = place[2];
    const auto find = [&](auto bend) {
        #pragma clang loop vectorize(enable)
        for (int k = 0; k < count; ++k) {
            const float dx = px - m[9 * count + k], dy = py - m[10 * count + k];
            const float dz = pz - m[11 * count + k];
            const float x = m[k] * dx + m[count + k] * dy + m[2 * count + k] * dz;
            const float y = m[3 * count + k] * dx + m[4 * count + k] * dy + m[5 * count + k] * dz;
            const float z = m[6 * count + k] * dx + m[7 * count + k] * dy + m[8 * count + k] * dz;
            float u = x / z, v = y / z;
            const bool clear = bend(u, v);
            u = __builtin_floorf(lens.fx * u + lens.cx + 0.5f);
            v = __builtin_floorf(lens.fy * v + lens.cy + 0.5f);
            const bool in = (z > 0.0f) & clear & (dx * dx + dy * dy <= aperture2) & (u >= 0.0f)
                & (v >= 0.0f) & (u < (float)lens.width) & (v < (float)lens.height);
            to[k] = in ? (int)(in ? v : 0.0f) * lens.width + (int)(in ? u : 0.0f) : -1;
        }
    };
    if (lens.distorted == 0) {
        find([](float&, float&) { return true; });
    } else {
        find([&](float& x, float& y) {
            const float r2 = x * x + y * y;
            const float radial = 1.0f + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3));
            const float u = x * radial + 2.0f * lens.p1 * x * y + lens.p2 * (r2 + 2.0f * x * x);
            y = y * radial + lens.p1 * (r2 + 2.0f * y * y) + 2.0f * lens.p2 * x * y;
            x = u;
            return r2 <= lens.max_radius2;
        });
    }
}"""


@lru_cache
def spot_functions(at_once: bool) -> tuple[Any, Any]:
    """Return the functions that find spots and that tell them, for kernels.

    Args:
        at_once: Whether the first one finds them all, in C for the CPU, and the second one looks
            them up; else the first does nothing.

    Returns:
        find(band, place, aperture2, lens, rows, places), and tell(band, k, place, pose, aperture2,
        lens, places): the pixel of photo k of the list, -1 where it does not see the place.
    """
    if at_once:

        @wp.func_native(_FIND)
        def find_spots(
            band: int,
            place: wp.vec3,
            aperture2: float,
            lens: Lens,
            rows: wp.array(dtype=float),
            places: wp.array2d(dtype=int),
        ): ...

        @wp.func
        def tell_spot(
            band: int,
            k: int,
            place: wp.vec3,
            pose: Pose,
            aperture2: float,
            lens: Lens,
            places: wp.array2d(dtype=int),
        ) -> int:
            return places[band, k]

    else:

        @wp.func
        def find_spots(
            band: int,
            place: wp.vec3,
            aperture2: float,
            lens: Lens,
            rows: wp.array(dtype=float),
            places: wp.array2d(dtype=int),
        ):
            pass

        @wp.func
        def tell_spot(
            band: int,
            k: int,
            place: wp.vec3,
            pose: Pose,
            aperture2: float,
            lens: Lens,
            places: wp.array2d(dtype=int),
        ) -> int:
            away = place - pose.centre
            spot = int(-1)
            if away[0] * away[0] + away[1] * away[1] <= aperture2:
                at = project(pose.rotation * away, lens)
                x = int(wp.floor(at[0] + 0.5))
                y = int(wp.floor(at[1] + 0.5))
                if at[2] > 0.0 and x >= 0 and y >= 0 and x < lens.width and y < lens.height:
                    spot = y * lens.width + x
            return spot

    return find_spots, tell_spot


def spot_memory(poses: NDArray[Any], order: NDArray[np.int32], bands: int) -> tuple[Any, Any]:
    """Return what `find` reads and writes: the poses of a list of photos, and spots by band.

    Args:
        poses: Shape (N,), of `Pose`.
        order: Numbers of the photos of the list.
        bands: Parts of the launch.
    """
    chosen = poses[order]
    rows = np.concatenate([chosen["rotation"].reshape(-1, 9).T, chosen["centre"].T])
    rows = np.ascontiguousarray(rows, np.float32).ravel()
    places = wp.empty((bands, len(order)), dtype=int, device="cpu")
    return wp.array(rows, dtype=float, device="cpu"), places
