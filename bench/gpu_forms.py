"""Other forms of the gather for CUDA, to be raced where there is a GPU.

None is in the package: nobody has yet seen what they are worth there. The tests hold each to the
package's kernel on the CPU, and compile it for CUDA.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from bench.peers import premultiply
from hsvaos.kernels.arrays import Stack
from hsvaos.kernels.gather import Pose, place_photos
from hsvaos.kernels.lens import Lens, project
from hsvaos.kernels.rays import focal_points

wp.set_module_options({"enable_backward": False})

Work = Callable[[], tuple[Any, Any]]


@wp.func
def _place(place: wp.vec3, pose: Pose, lens: Lens) -> wp.vec3:
    """Pixel where a photo sees a point, and 1, or 0 where it does not."""
    at = project(pose.rotation * (place - pose.centre), lens)
    right, bottom = float(lens.width) - 0.5, float(lens.height) - 0.5
    if at[0] < -0.5 or at[1] < -0.5 or at[0] > right or at[1] > bottom:
        return wp.vec3(0.0, 0.0, 0.0)
    return at


@wp.func
def _bytes(word: wp.uint32) -> wp.vec4:
    """The four bytes of a word, the lowest first."""
    byte = wp.uint32(255)
    return wp.vec4(
        float(word & byte),
        float((word >> wp.uint32(8)) & byte),
        float((word >> wp.uint32(16)) & byte),
        float(word >> wp.uint32(24)),
    )


@wp.func
def _mean(total: wp.vec4) -> wp.vec3:
    """Colour of a premultiplied sum."""
    return wp.vec3(total[0], total[1], total[2]) * (255.0 / wp.max(total[3], 1.0e-6))


@wp.kernel(module="unique", enable_backward=False)
def words_kernel(
    lens: Lens,
    poses: wp.array(dtype=Pose),
    points: wp.array(dtype=wp.vec4),
    words: wp.array2d(dtype=wp.uint32),
    image: wp.array(dtype=wp.vec3),
    footprint: wp.array(dtype=float),
):
    """Premultiplied RGBA in a word: four reads of 32 bits a ray, interpolated by hand."""
    i = wp.tid()
    point = wp.vec3(points[i][0], points[i][1], points[i][2])
    total = wp.vec4(0.0)
    for n in range(poses.shape[0]):
        at = _place(point, poses[n], lens)
        if at[2] > 0.0:
            left, top = wp.floor(at[0]), wp.floor(at[1])
            fx, fy = at[0] - left, at[1] - top
            x0, y0 = wp.max(int(left), 0), wp.max(int(top), 0)
            x1 = wp.min(int(left) + 1, lens.width - 1)
            y1 = wp.min(int(top) + 1, lens.height - 1)
            upper = _bytes(words[n, y0 * lens.width + x0]) * (1.0 - fx)
            upper += _bytes(words[n, y0 * lens.width + x1]) * fx
            lower = _bytes(words[n, y1 * lens.width + x0]) * (1.0 - fx)
            lower += _bytes(words[n, y1 * lens.width + x1]) * fx
            total += upper * (1.0 - fy) + lower * fy
    image[i] = _mean(total)
    footprint[i] = total[3] / 255.0


@wp.kernel(module="unique", enable_backward=False)
def textures_kernel(
    lens: Lens,
    poses: wp.array(dtype=Pose),
    points: wp.array(dtype=wp.vec4),
    photos: wp.Texture3D,
    image: wp.array(dtype=wp.vec3),
    footprint: wp.array(dtype=float),
):
    """Premultiplied RGBA in a texture, a photo a layer: the texture units interpolate."""
    i = wp.tid()
    point = wp.vec3(points[i][0], points[i][1], points[i][2])
    total = wp.vec4(0.0)
    for n in range(poses.shape[0]):
        at = _place(point, poses[n], lens)
        if at[2] > 0.0:
            place = wp.vec3(at[0] + 0.5, at[1] + 0.5, float(n) + 0.5)
            total += wp.texture_sample(photos, place, dtype=wp.vec4f)
    image[i] = _mean(total)
    footprint[i] = total[3]


def _work(scene: Any, device: Any, kernel: Any, photos: Any) -> Work:
    """One integral from photos that lie on the device; nothing waits, nothing is allocated."""
    stack = Stack(scene.images, device)
    weights = (wp.empty((1, 1), dtype=wp.uint8, device=device), 0.0)
    poses = scene.poses.copy()
    poses[:, :3, 3] -= scene.view.world_from_camera[:3, 3]
    order = np.arange(len(poses), dtype=np.int32)
    placed = place_photos(scene.camera, stack, weights, poses, np.ones((len(poses), 3)), order)
    width, height = scene.view.size
    points = focal_points(scene.view, scene.surface, device=device)
    image = wp.empty((height, width), dtype=wp.vec3, device=device)
    footprint = wp.empty((height, width), dtype=float, device=device)

    def work() -> tuple[Any, Any]:
        focal_points(scene.view, scene.surface, out=points, device=device)
        inputs = [placed.lens, placed.poses, points, photos]
        outputs = [image.flatten(), footprint.flatten()]
        wp.launch(kernel, dim=points.size, inputs=inputs, outputs=outputs, device=device)
        wp.synchronize_device(device)
        return image, footprint

    return work


def words(scene: Any, device: Any) -> Work:
    """The form of `words_kernel`."""
    pixels = np.stack(premultiply(scene.images, scene.weights))
    packed = pixels.view(np.uint32).reshape(len(pixels), -1)
    return _work(scene, device, words_kernel, wp.array(packed, dtype=wp.uint32, device=device))


def textures(scene: Any, device: Any) -> Work:
    """The form of `textures_kernel`; hardware weighs by 8 bits of a pixel."""
    photos = wp.Texture3D(
        np.stack(premultiply(scene.images, scene.weights)),
        filter_mode=wp.TextureFilterMode.LINEAR,
        normalized_coords=False,
        device=device,
    )
    return _work(scene, device, textures_kernel, photos)


FORMS = {"words (not in the package)": words, "hardware textures (not in the package)": textures}
