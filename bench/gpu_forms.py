"""Other forms of the gather for CUDA, to be raced where there is a GPU.

None is in the package: nobody has yet seen what they are worth there. The tests hold each to the
package's kernel on the CPU, and compile it for CUDA.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from bench.peers import premultiply
from hsvaos.kernels.lens import Lens, lens, project
from hsvaos.kernels.rays import focal_points
from hsvaos.kernels.stations import Pose, Stations

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


@wp.func
def _between(words: wp.array2d(dtype=wp.uint32), n: int, lens: Lens, u: float, v: float) -> wp.vec4:
    """Premultiplied RGBA of a photo between its pixels."""
    left, top = wp.floor(u), wp.floor(v)
    fx, fy = u - left, v - top
    x0, y0 = wp.max(int(left), 0), wp.max(int(top), 0)
    x1, y1 = wp.min(int(left) + 1, lens.width - 1), wp.min(int(top) + 1, lens.height - 1)
    upper = _bytes(words[n, y0 * lens.width + x0]) * (1.0 - fx)
    upper += _bytes(words[n, y0 * lens.width + x1]) * fx
    lower = _bytes(words[n, y1 * lens.width + x0]) * (1.0 - fx)
    lower += _bytes(words[n, y1 * lens.width + x1]) * fx
    return upper * (1.0 - fy) + lower * fy


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
            total += _between(words, n, lens, at[0], at[1])
    image[i] = _mean(total)
    footprint[i] = total[3] / 255.0


@lru_cache
def shared_kernel(photos: int) -> wp.Kernel:
    """Words again, the poses read from a tile that the threads of a block share.

    Args:
        photos: How many; a tile's size is fixed when it is compiled.
    """

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        lens: Lens,
        rows: wp.array2d(dtype=float),
        points: wp.array(dtype=wp.vec4),
        words: wp.array2d(dtype=wp.uint32),
        image: wp.array(dtype=wp.vec3),
        footprint: wp.array(dtype=float),
    ):
        block, lane = wp.tid()
        poses = wp.tile_load(rows, shape=(photos, 12), storage="shared")
        i = block * wp.block_dim() + lane
        if i < points.shape[0]:
            point = wp.vec3(points[i][0], points[i][1], points[i][2])
            total = wp.vec4(0.0)
            for n in range(photos):
                pose = Pose()
                pose.rotation = wp.mat33(
                    poses[n, 0], poses[n, 1], poses[n, 2], poses[n, 3], poses[n, 4], poses[n, 5],
                    poses[n, 6], poses[n, 7], poses[n, 8],
                )  # fmt: skip
                pose.centre = wp.vec3(poses[n, 9], poses[n, 10], poses[n, 11])
                at = _place(point, pose, lens)
                if at[2] > 0.0:
                    total += _between(words, n, lens, at[0], at[1])
            image[i] = _mean(total)
            footprint[i] = total[3] / 255.0

    return kernel


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


def _work(
    scene: Any, device: Any, kernel: Any, photos: Any, poses_of: Any = None, threads: int = 0
) -> Work:
    """One integral from photos that lie on the device; nothing waits, nothing is allocated.

    Args:
        scene: Photos, poses and view.
        device: Where.
        kernel: What gathers.
        photos: In its form.
        poses_of: What the kernel wants for an array of poses; None for that array.
        threads: Of a block that shares tiles; 0 where nothing is shared.
    """
    stations = Stations(scene.poses, np.ones((len(scene.poses), 3)), device)
    shape, eye = lens(scene.camera), scene.view.world_from_camera[:3, 3]
    width, height = scene.view.size
    points = focal_points(scene.view, scene.surface, device=device)
    image = wp.empty((height, width), dtype=wp.vec3, device=device)
    footprint = wp.empty((height, width), dtype=float, device=device)

    def work() -> tuple[Any, Any]:
        focal_points(scene.view, scene.surface, out=points, device=device)
        poses = stations.seen_from(eye)
        inputs = [shape, poses if poses_of is None else poses_of(poses), points, photos]
        inputs += [image.flatten(), footprint.flatten()]
        if threads:
            blocks = [-(-points.size // threads)]
            wp.launch_tiled(kernel, dim=blocks, inputs=inputs, block_dim=threads, device=device)
        else:
            wp.launch(kernel, dim=points.size, inputs=inputs, device=device)
        wp.synchronize_device(device)
        return image, footprint

    return work


def _words_of(scene: Any, device: Any) -> Any:
    pixels = np.stack(premultiply(scene.images, scene.weights))
    packed = pixels.view(np.uint32).reshape(len(pixels), -1)
    return wp.array(packed, dtype=wp.uint32, device=device)


def words(scene: Any, device: Any) -> Work:
    """The form of `words_kernel`."""
    return _work(scene, device, words_kernel, _words_of(scene, device))


def shared(scene: Any, device: Any) -> Work:
    """The form of `shared_kernel`."""
    count, floats = len(scene.poses), wp.types.type_size_in_bytes(Pose) // 4

    def rows(poses: Any) -> Any:
        strides = (4 * floats, 4)
        return wp.array(
            ptr=poses.ptr, dtype=float, shape=(count, 12), strides=strides, device=device
        )

    threads = 1 if device.is_cpu else 256
    return _work(scene, device, shared_kernel(count), _words_of(scene, device), rows, threads)


def textures(scene: Any, device: Any) -> Work:
    """The form of `textures_kernel`; hardware weighs by 8 bits of a pixel."""
    photos = wp.Texture3D(
        np.stack(premultiply(scene.images, scene.weights)),
        filter_mode=wp.TextureFilterMode.LINEAR,
        normalized_coords=False,
        device=device,
    )
    return _work(scene, device, textures_kernel, photos)


FORMS = {
    "words (not in the package)": words,
    "words, poses in shared tiles (not in the package)": shared,
    "hardware textures (not in the package)": textures,
}
