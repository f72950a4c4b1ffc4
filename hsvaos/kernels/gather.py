"""The plain gather: one thread a pixel loops over the photos. It runs on every device."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import warp as wp

from hsvaos.kernels.arrays import Stack, pixel_view
from hsvaos.kernels.device import launch
from hsvaos.kernels.lens import Lens, project
from hsvaos.kernels.pixels import as_value, times_gain
from hsvaos.kernels.stations import Pose

wp.set_module_options({"enable_backward": False})


@lru_cache
def _gather_kernel(pixel: Any, weight: Any, value: Any) -> Any:
    @wp.kernel(module="unique", enable_backward=False)
    def gather_kernel(
        offset: int,
        band: int,
        lens: Lens,
        poses: wp.array(dtype=Pose),
        order: wp.array(dtype=int),
        aperture2: float,
        points: wp.array(dtype=wp.vec4),
        images: wp.array2d(dtype=pixel),
        weights: wp.array2d(dtype=weight),
        weight_unit: float,
        weight_step: int,
        image: wp.array(dtype=value),
        footprint: wp.array(dtype=float),
    ):
        i = wp.tid() + offset
        point = points[i]
        total = value(0.0)
        sum_of_weights = float(0.0)
        if point[3] > 0.0:
            place = wp.vec3(point[0], point[1], point[2])
            for k in range(order.shape[0]):
                n = order[k]
                pose = poses[n]
                away = place - pose.centre
                if away[0] * away[0] + away[1] * away[1] <= aperture2:
                    at = project(pose.rotation * away, lens)
                    u, v = at[0], at[1]
                    # a photo covers the area of its pixels; its edge pixels reach to the border
                    if (
                        at[2] > 0.0
                        and u >= -0.5
                        and v >= -0.5
                        and u <= float(lens.width) - 0.5
                        and v <= float(lens.height) - 0.5
                    ):
                        left = wp.floor(u)
                        top = wp.floor(v)
                        fx = u - left
                        fy = v - top
                        x0 = wp.max(int(left), 0)
                        y0 = wp.max(int(top), 0)
                        x1 = wp.min(int(left) + 1, lens.width - 1)
                        y1 = wp.min(int(top) + 1, lens.height - 1)
                        a = y0 * lens.width + x0
                        b = y0 * lens.width + x1
                        c = y1 * lens.width + x0
                        d = y1 * lens.width + x1
                        wa = (1.0 - fx) * (1.0 - fy)
                        wb = fx * (1.0 - fy)
                        wc = (1.0 - fx) * fy
                        wd = fx * fy
                        if weight_unit > 0.0:
                            wa *= float(weights[n * weight_step, a]) * weight_unit
                            wb *= float(weights[n * weight_step, b]) * weight_unit
                            wc *= float(weights[n * weight_step, c]) * weight_unit
                            wd *= float(weights[n * weight_step, d]) * weight_unit
                        share = wa + wb + wc + wd
                        if share > 0.0:  # most rays end on masked leaves: spare their pixels
                            here = (
                                as_value(images[n, a]) * wa
                                + as_value(images[n, b]) * wb
                                + as_value(images[n, c]) * wc
                                + as_value(images[n, d]) * wd
                            )
                            total += times_gain(here, pose.gain)
                            sum_of_weights += share
        if sum_of_weights > 0.0:
            total = total / sum_of_weights
        image[i] = total
        footprint[i] = sum_of_weights

    return gather_kernel


@dataclass(frozen=True, eq=False)
class PlacedPhotos:
    """Photos as they are, and from where they were taken, on the device.

    Args:
        stack: The photos.
        weights: Warp array (N or 1, H * W), uint8, uint16 or float32.
        weight_unit: Weight of 1 in that array; 0 if all pixels have the weight 1.
        lens: Lens of their camera.
        poses: Warp array (N) of `Pose`, relative to the points' origin, see `Stations.seen_from`.
        order: Warp array of int, numbers of the photos to use.
    """

    stack: Stack
    weights: Any
    weight_unit: float
    lens: Any
    poses: Any
    order: Any


def gather(photos: PlacedPhotos, reach: float, points: Any, image: Any, footprint: Any) -> None:
    """Integrate photos as they are at given points; only launches.

    Args:
        photos: The photos.
        reach: Greatest horizontal distance of a photo from a point [m].
        points: Warp array (H * W) of vec4, see `focal_points`.
        image: Warp array of H * W * C float32, written.
        footprint: Warp array of H * W float32, written.
    """
    stack, weights, size = photos.stack, photos.weights, points.size
    value = wp.vec3 if stack.channels == 3 else wp.float32
    inputs = [
        *(photos.lens, photos.poses, photos.order, reach * reach),
        *(points, stack.pixels, weights, photos.weight_unit, int(weights.shape[0] > 1)),
        *(pixel_view(image, value, (size,)), pixel_view(footprint, wp.float32, (size,))),
    ]
    launch(_gather_kernel(stack.pixel, weights.dtype, value), size, inputs, stack.device)
