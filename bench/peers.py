"""The same integral with other tools, each in its best form, at the threads of our kernels."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import cv2
import numpy as np

from hsvaos.kernels.device import threads

Work = Callable[[], Any]


def plane_homography(matrix: np.ndarray, view: Any, pose: np.ndarray, down_m: float) -> np.ndarray:
    """Pixels of a photo for pixels of the view, over a horizontal plane."""

    def image_from_plane(world_from_camera: np.ndarray) -> np.ndarray:
        rotation = world_from_camera[:3, :3].T
        shift = rotation @ ([0.0, 0.0, down_m] - world_from_camera[:3, 3])
        return matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], shift])

    return image_from_plane(pose) @ np.linalg.inv(image_from_plane(view.world_from_camera))


def premultiply(images: np.ndarray, weights: np.ndarray) -> list[np.ndarray]:
    """RGBA photos: black and weightless where the mask is 0."""
    return [
        np.dstack([image * (weight[..., None] > 0), weight])
        for image, weight in zip(images, weights, strict=True)
    ]


def opencv(photos: list[np.ndarray], homographies: list[np.ndarray], side: int) -> Work:
    """warpPerspective on premultiplied RGBA and accumulate, a band of rows on each thread."""
    bands = threads()
    cv2.setNumThreads(1)
    pool = ThreadPoolExecutor(bands)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    result = np.empty((side, side, 4), np.float32)

    def band(number: int) -> None:
        top, end = side * number // bands, side * (number + 1) // bands
        total = result[top:end]
        total[:] = 0.0
        warped = np.empty((end - top, side, 4), np.uint8)
        shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        for photo, homography in zip(photos, homographies, strict=True):
            cv2.warpPerspective(photo, homography @ shift, (side, end - top), warped, flags)
            cv2.accumulate(warped, total)
        total[..., :3] /= np.maximum(total[..., 3:] / 255.0, 1e-6)

    def work() -> np.ndarray:
        list(pool.map(band, range(bands)))
        return result

    return work


def numba(photos: list[np.ndarray], homographies: list[np.ndarray], side: int) -> Work | None:
    """One parallel loop over rows; each pixel gathers all photos."""
    try:
        import numba as nb
    except ImportError:
        return skipped("numba")
    nb.set_num_threads(min(threads(), nb.config.NUMBA_NUM_THREADS))

    @nb.njit(parallel=True, fastmath=True)  # type: ignore[untyped-decorator, unused-ignore]
    def gather(photos: Any, homographies: Any, result: Any) -> None:
        count, height, width, _ = photos.shape
        for y in nb.prange(result.shape[0]):
            for x in range(result.shape[1]):
                r = g = b = a = np.float32(0.0)
                for n in range(count):
                    h = homographies[n]
                    near = np.float32(1.0) / (h[2, 0] * x + h[2, 1] * y + h[2, 2])
                    u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) * near
                    v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) * near
                    if u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1:
                        i, j = int(v), int(u)
                        fu, fv = u - np.float32(j), v - np.float32(i)
                        wd = fu * fv
                        wb, wc = fu - wd, fv - wd
                        wa = np.float32(1.0) - fu - wc
                        p, q = photos[n, i], photos[n, i + 1]
                        r += wa * p[j, 0] + wb * p[j + 1, 0] + wc * q[j, 0] + wd * q[j + 1, 0]
                        g += wa * p[j, 1] + wb * p[j + 1, 1] + wc * q[j, 1] + wd * q[j + 1, 1]
                        b += wa * p[j, 2] + wb * p[j + 1, 2] + wc * q[j, 2] + wd * q[j + 1, 2]
                        a += wa * p[j, 3] + wb * p[j + 1, 3] + wc * q[j, 3] + wd * q[j + 1, 3]
                scale = np.float32(255.0) / max(a, np.float32(1e-6))
                result[y, x, 0] = r * scale
                result[y, x, 1] = g * scale
                result[y, x, 2] = b * scale
                result[y, x, 3] = a

    stack = np.stack(photos)
    matrices = np.stack(homographies).astype(np.float32)
    result = np.empty((side, side, 4), np.float32)

    def work() -> np.ndarray:
        gather(stack, matrices, result)
        return result

    return work


def grid_sample(
    photos: list[np.ndarray], homographies: list[np.ndarray], side: int, device: str = "cpu"
) -> Work | None:
    """PyTorch's grid_sample, photo by photo, on planar float photos that lie ready."""
    try:
        import torch
    except ImportError:
        return skipped("torch")
    if device != "cpu" and not torch.cuda.is_available():
        return skipped("torch for CUDA")
    torch.set_num_threads(threads())
    height, width = photos[0].shape[:2]
    planar = (np.ascontiguousarray(p.transpose(2, 0, 1), np.float32) for p in photos)
    stack = [torch.from_numpy(p)[None].to(device) for p in planar]
    to_unit = np.array([[2 / (width - 1), 0, -1], [0, 2 / (height - 1), -1], [0, 0, 1.0]])
    matrices = [(to_unit @ h).tolist() for h in homographies]
    axis = torch.arange(side, dtype=torch.float32, device=device)
    x, y = axis[None, :], axis[:, None]

    def work() -> Any:
        with torch.inference_mode():
            total = torch.zeros((1, 4, side, side), device=device)
            for photo, h in zip(stack, matrices, strict=True):
                near = 1.0 / (h[2][0] * x + h[2][1] * y + h[2][2])
                u = (h[0][0] * x + h[0][1] * y + h[0][2]) * near
                v = (h[1][0] * x + h[1][1] * y + h[1][2]) * near
                grid = torch.stack([u, v], dim=-1)[None]
                total += torch.nn.functional.grid_sample(photo, grid, align_corners=True)
            total[:, :3] /= (total[:, 3:] / 255.0).clamp(min=1e-6)
            if device != "cpu":
                torch.cuda.synchronize()
                return total
            return np.asarray(total[0].permute(1, 2, 0))

    return work


def cupy(photos: list[np.ndarray], homographies: list[np.ndarray], side: int) -> Work | None:
    """CuPy's map_coordinates, photo by photo and channel by channel, on photos that lie ready."""
    try:
        import cupy as cp
        from cupyx.scipy.ndimage import map_coordinates
    except ImportError:
        return skipped("cupy")
    stack = [cp.asarray(np.ascontiguousarray(p.transpose(2, 0, 1), np.float32)) for p in photos]
    axis = cp.arange(side, dtype=cp.float32)
    x, y = axis[None, :], axis[:, None]
    matrices = [h.tolist() for h in homographies]

    def work() -> Any:
        total = cp.zeros((4, side, side), cp.float32)
        for photo, h in zip(stack, matrices, strict=True):
            near = 1.0 / (h[2][0] * x + h[2][1] * y + h[2][2])
            at = cp.stack(
                [
                    (h[1][0] * x + h[1][1] * y + h[1][2]) * near,
                    (h[0][0] * x + h[0][1] * y + h[0][2]) * near,
                ]
            )
            for channel, sums in zip(photo, total, strict=True):
                sums += map_coordinates(channel, at, order=1, mode="constant")
        total[:3] /= cp.maximum(total[3:] / 255.0, 1e-6)
        cp.cuda.get_current_stream().synchronize()
        return total

    return work


def skipped(name: str) -> None:
    """Say that a peer is not there."""
    sys.stderr.write(f"{name} is not installed: left out\n")


PEERS = {
    "OpenCV warpPerspective + accumulate": opencv,
    "numba parallel gather": numba,
    "PyTorch grid_sample": grid_sample,
}

GPU_PEERS = {"PyTorch grid_sample": partial(grid_sample, device="cuda"), "CuPy": cupy}
