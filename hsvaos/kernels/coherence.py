"""Coherence of rays: whether rare colours at a point of the ground agree with each other.

Leaves let chance colours through; a person shows every ray that gets to them the same few colours.
Of the rays that reach a point, the one whose rare colour most other rare rays share stands for it.
"""

from functools import lru_cache
from typing import Any

import warp as wp

from hsvaos.kernels.arrays import pixel_view
from hsvaos.kernels.device import bands, in_vectors, launch
from hsvaos.kernels.gather import PlacedPhotos
from hsvaos.kernels.lab import lab_pixel, lab_tables
from hsvaos.kernels.lens import Lens
from hsvaos.kernels.pixels import as_colour, as_value, times_gain
from hsvaos.kernels.spots import spot_functions, spot_memory
from hsvaos.kernels.stations import Pose

wp.set_module_options({"enable_backward": False})

LEAST_WEIGHT = 0.02
"""Rays of less weight are leaves and ground like everywhere; they count as rays, no more."""

MOST_RAYS = 16
"""Of the rays above the least weight, the heaviest this many are compared: bounded work."""

LAB_SIGMA = 16.0
"""Colours that differ by this count as half alike (exp(-1))."""

LIGHTNESS_SHARE = 0.5
"""Factor on differences of lightness: one cloth is lit here and shaded there."""

_FARTHEST = 4.0
"""Squared distances in sigmas beyond which colours have nothing in common."""

_rays = wp.types.vector(length=MOST_RAYS, dtype=float)
_numbers = wp.types.vector(length=MOST_RAYS, dtype=int)


@wp.func
def likeness(apart: float) -> float:
    """How alike two colours are that lie so far apart, squared, in sigmas: 1 where equal."""
    if apart >= _FARTHEST:
        return 0.0
    return wp.exp(-apart)


@lru_cache
def _coherence_kernel(pixel: Any, weight: Any, value: Any, at_once: bool) -> Any:
    find_spots, tell_spot = spot_functions(at_once)

    @wp.kernel(module="unique", enable_backward=False)
    def coherence_kernel(
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
        white: float,
        gamma: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        rows: wp.array(dtype=float),
        places: wp.array2d(dtype=int),
        image: wp.array(dtype=value),
        coherence: wp.array(dtype=float),
    ):
        i = wp.tid() + offset
        point = points[i]
        held = _rays(0.0)
        photo = _numbers(0)
        spots = _numbers(0)
        count = int(0)
        seen = int(0)
        least = int(0)
        if point[3] > 0.0:
            place = wp.vec3(point[0], point[1], point[2])
            find_spots(band, place, aperture2, lens, rows, places)
            for k in range(order.shape[0]):
                n = order[k]
                spot = tell_spot(band, k, place, poses[n], aperture2, lens, places)
                if spot >= 0:
                    share = float(1.0)
                    if weight_unit > 0.0:
                        share = float(weights[n * weight_step, spot]) * weight_unit
                    if share > 0.0:
                        seen += 1
                    if share >= LEAST_WEIGHT and (count < MOST_RAYS or share > held[least]):
                        if count == MOST_RAYS:  # of equal rays the first stay
                            for j in range(least, MOST_RAYS - 1):
                                held[j] = held[j + 1]
                                photo[j] = photo[j + 1]
                                spots[j] = spots[j + 1]
                            count -= 1
                        held[count] = share
                        photo[count] = n
                        spots[count] = spot
                        count += 1
                        if count == MOST_RAYS:
                            least = int(0)
                            for j in range(1, MOST_RAYS):
                                if held[j] <= held[least]:
                                    least = j
        # three vectors, not a matrix, and each pair once: most of the time goes into this
        light = _rays(0.0)
        green = _rays(0.0)
        blue = _rays(0.0)
        alike = _rays(0.0)
        for a in range(count):
            colour = as_colour(
                times_gain(as_value(images[photo[a], spots[a]]), poses[photo[a]].gain)
            )
            lab = lab_pixel(colour / white, gamma, curve) / LAB_SIGMA
            grey = lab[0] * LIGHTNESS_SHARE
            own = held[a]
            agreed = own
            for b in range(a):
                dx = grey - light[b]
                dy = lab[1] - green[b]
                dz = lab[2] - blue[b]
                same = likeness(dx * dx + dy * dy + dz * dz)
                if same > 0.0:
                    agreed += held[b] * same
                    alike[b] += own * same
            light[a] = grey
            green[a] = lab[1]
            blue[a] = lab[2]
            alike[a] = agreed
        best = float(0.0)
        chosen = int(0)
        for a in range(count):
            if held[a] * alike[a] > best:
                best = held[a] * alike[a]
                chosen = a
        total = value(0.0)
        if best > 0.0:
            sum_of_weights = float(0.0)
            for b in range(count):
                dx = light[chosen] - light[b]
                dy = green[chosen] - green[b]
                dz = blue[chosen] - blue[b]
                share = held[b] * likeness(dx * dx + dy * dy + dz * dz)
                total += (
                    times_gain(as_value(images[photo[b], spots[b]]), poses[photo[b]].gain) * share
                )
                sum_of_weights += share
            total = total / sum_of_weights
            best = wp.sqrt(best / float(seen))
        image[i] = total
        coherence[i] = best

    return coherence_kernel


def gather_coherence(
    photos: PlacedPhotos, reach: float, points: Any, image: Any, coherence: Any
) -> None:
    """Measure coherence at given points; only launches.

    Args:
        photos: The photos.
        reach: Greatest horizontal distance of a photo from a point [m].
        points: Warp array (H * W) of vec4, see `focal_points`.
        image: Warp array of H * W * C float32, written: mean colour of the rays that agree.
        coherence: Warp array of H * W float32, written, 0..1.
    """
    stack, weights, size = photos.stack, photos.weights, points.size
    value = wp.vec3 if stack.channels == 3 else wp.float32
    at_once = in_vectors(stack.device)
    memory: tuple[Any, Any] = (None, None)
    if at_once:
        parts = len(bands(size, stack.device))
        memory = spot_memory(photos.poses.numpy(), photos.order.numpy(), parts)
    inputs = [
        *(photos.lens, photos.poses, photos.order, reach * reach),
        *(points, stack.pixels, weights, photos.weight_unit, int(weights.shape[0] > 1)),
        *(stack.white, *lab_tables(stack.device), *memory),
        *(pixel_view(image, value, (size,)), pixel_view(coherence, wp.float32, (size,))),
    ]
    kernel = _coherence_kernel(stack.pixel, weights.dtype, value, at_once)
    launch(kernel, size, inputs, stack.device)
