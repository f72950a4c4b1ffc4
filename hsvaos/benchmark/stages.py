"""The stages of the chain at the paper's sizes: what each does, reads, writes and computes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import warp as wp

from hsvaos.benchmark.scenes import lawnmower, masks, photos
from hsvaos.kernels.color import brighten
from hsvaos.kernels.device import in_vectors
from hsvaos.kernels.hue_mask import apply_hue_cut, measure_hue
from hsvaos.kernels.hue_pack import cut_and_pack
from hsvaos.kernels.integrate import Integrator
from hsvaos.kernels.packing import Packed
from hsvaos.kernels.rarity import rarity_weights
from hsvaos.settings import MaskSettings
from hsvaos.surface import FocalPlane

Work = Callable[[], object]

RARITY_PHOTOS = 4
"""Photos whose rarity is weighed at a time; the cost a photo is the same for any number."""

_HUE_OPERATIONS = 40
"""Arithmetic operations of a pixel's hue and its place in the histogram, as the kernels do them."""

_CUT_OPERATIONS = 90
"""Hue again, distance from the mean, brightening by two polynomials, packing."""

_RARITY_OPERATIONS = 60
"""Lab by two tables, the bin, its count, and the table of weights."""

_SAMPLE_OPERATIONS = 80
"""Of a sample: projection (20), borders and corners' weights (20), four corners of four
channels (32), sums (8)."""


@dataclass(frozen=True)
class Sizes:
    """How large the work is; the defaults are the paper's.

    Args:
        photo: Side of a photo [px].
        flight: Photos of the long integral.
        window: Photos of the short one, of the focal stack and of the chain.
        view: Side of the view of the short integral and of the focal stack [px].
        planes: Planes of the focal stack.
    """

    photo: int = 1024
    flight: int = 117
    window: int = 30
    view: int = 512
    planes: int = 32


@dataclass(frozen=True)
class Stage:
    """One stage.

    Args:
        name: What it does.
        per: What one unit is, of which the table gives milliseconds and rate.
        make: Gives the work to be timed; what is made before is not.
        units: Units of one call.
        moved: Bytes that a call must read and write at least.
        samples: Bilinear samples of a call; 0 where there are none.
        operations: Arithmetic operations of a call on pixels; 0 where nobody counted them.
        memory: Bytes that the stage holds.
    """

    name: str
    per: str
    make: Callable[[], Work]
    units: int = 1
    moved: float = 0.0
    samples: float = 0.0
    operations: float = 0.0
    memory: float = 0.0


def stages(sizes: Sizes, device: Any, folder: Path, model: Path | None = None) -> list[Stage]:
    """Return the stages in the order of the chain.

    Args:
        sizes: How large the work is.
        device: Warp device.
        folder: Where a photo may be written, to be decoded.
        model: ONNX network that looks for people; our own if None.
    """
    return [
        *_photo_stages(sizes, device, folder),
        _integral(sizes, sizes.flight, sizes.photo, device),
        _integral(sizes, sizes.window, sizes.view, device),
        _integral(sizes, sizes.window, sizes.view, device, sizes.planes),
        *(_detection(side, device, model) for side in (sizes.view, sizes.photo)),
        Stage(
            f"whole chain: a photo in, {sizes.window} seen",
            "photo",
            lambda: _chain(sizes, device, folder, model),
            memory=24.0 * sizes.window * sizes.photo**2,
        ),
    ]


def _photo_stages(sizes: Sizes, device: Any, folder: Path) -> list[Stage]:
    pixels = sizes.photo**2
    small = 64.0 * pixels

    def hue() -> Work:
        images = _on(device, photos(1, sizes.photo))
        return lambda: measure_hue(images)

    def cut() -> Work:
        cutter = Cutter(_on(device, photos(1, sizes.photo)))
        return lambda: cutter.cut(0)

    def rarity() -> Work:
        images = _on(device, photos(RARITY_PHOTOS, sizes.photo))
        out = wp.empty(images.shape[:3], dtype=wp.uint8, device=device)
        return lambda: rarity_weights(images, out=out)

    return [
        Stage("decode a JPEG", "photo", lambda: _decoding(sizes, folder), memory=small),
        Stage(
            "HSV and statistics",
            "photo",
            hue,
            moved=3.0 * pixels,
            operations=_HUE_OPERATIONS * pixels,
            memory=small,
        ),
        Stage(
            "mask, brighten, pack",
            "photo",
            cut,
            moved=8.0 * pixels,
            operations=_CUT_OPERATIONS * pixels,
            memory=small,
        ),
        Stage(
            "rarity weights",
            "photo",
            rarity,
            units=RARITY_PHOTOS,
            moved=7.0 * pixels * RARITY_PHOTOS,
            operations=_RARITY_OPERATIONS * pixels * RARITY_PHOTOS,
            memory=small * RARITY_PHOTOS,
        ),
    ]


def _integral(sizes: Sizes, count: int, view: int, device: Any, planes: int = 0) -> Stage:
    samples = float(max(planes, 1)) * count * view**2
    # a photo's pixel is read once, with its weight, where the view is as fine as the photos
    read = 4.0 * count * min(view, sizes.photo) ** 2
    return Stage(
        f"focal stack of {planes} planes, {count} photos to {view}"
        if planes
        else f"integrate {count} photos of {sizes.photo} to {view}",
        "stack" if planes else "picture",
        lambda: _integrating(sizes, count, view, device, planes),
        moved=read + 16.0 * max(planes, 1) * view**2,
        samples=samples,
        operations=_SAMPLE_OPERATIONS * samples,
        memory=9.0 * count * sizes.photo**2 + 32.0 * max(planes, 1) * view**2,
    )


def _integrating(sizes: Sizes, count: int, view_side: int, device: Any, planes: int) -> Work:
    camera, poses, view = lawnmower(count, sizes.photo, view_side)
    images, weights = photos(count, sizes.photo), masks(count, sizes.photo)
    integrator = Integrator(camera, _on(device, images), poses, weights)
    size = (view_side, view_side)
    if not planes:
        out = _pictures(size, device)
        return lambda: integrator.integrate(view, FocalPlane(0.0), out=out)
    downs = np.linspace(-3.0, 0.0, planes)
    stack = _pictures((planes, *size), device)
    return lambda: integrator.sweep(view, downs, out=stack)


def _detection(side: int, device: Any, model: Path | None) -> Stage:
    def make() -> Work:
        detect = _detector(device, model)
        image = photos(1, side)[0].astype(np.float32)
        rng = np.random.default_rng(2)
        rays = rng.integers(20, 60, image.shape[:2]).astype(np.float32)
        rarity = rng.exponential(0.05, image.shape[:2]).astype(np.float32)
        return lambda: detect(image, footprint=rays, rarity=rarity)

    return Stage(f"detect people in {side} x {side}", "picture", make, memory=1000.0 * side**2)


def _chain(sizes: Sizes, device: Any, folder: Path, model: Path | None) -> Work:
    """Every new photo takes the place of the oldest, and all that are held give a new picture."""
    decode = _decoding(sizes, folder)
    camera, poses, view = lawnmower(sizes.window, sizes.photo, sizes.view)
    images = _on(device, photos(sizes.window, sizes.photo))
    cutter = Cutter(images)
    for i in range(sizes.window):
        cutter.cut(i)
    integrator = Integrator(
        camera, cutter.bright, poses, cutter.masks, packed=cutter.packed, device=device
    )
    detect = _detector(device, model)
    out = _pictures((sizes.view, sizes.view), device)
    newest = 0

    def work() -> object:
        nonlocal newest
        wp.copy(images[newest], wp.array(decode(), dtype=wp.uint8, device="cpu", copy=False))
        cutter.measure(newest)
        cutter.cut(newest)
        newest = (newest + 1) % sizes.window
        integrator.integrate(view, FocalPlane(0.0), out=out)
        picture, rays = (part.numpy() for part in out)
        return detect(picture, footprint=rays)

    return work


class Cutter:
    """Hue cut and brightening of photos that lie on a device, one at a time, into their places.

    Args:
        images: Warp array (N, H, W, 3), uint8.
    """

    def __init__(self, images: Any) -> None:
        self.images = images
        settings = MaskSettings()
        self._amount = {
            "target_value": settings.target_value,
            "gamma": settings.gamma,
            "max_gain": settings.max_gain,
        }
        self._stats = [measure_hue(_one(images, i))[0][0] for i in range(images.shape[0])]
        self.masks = wp.zeros(images.shape[:3], dtype=wp.uint8, device=images.device)
        self.bright = images
        self.packed: Packed | None = None
        if in_vectors(images.device):
            both = cut_and_pack(images, self._stats, brightening=self._amount, out=self.masks)
            self.packed = None if both is None else both[1]
        else:
            self.bright = wp.empty_like(images)

    def measure(self, index: int) -> None:
        """Measure the hues of a photo again."""
        self._stats[index] = measure_hue(_one(self.images, index))[0][0]

    def cut(self, index: int) -> None:
        """Make mask and brightened photo, on the CPU packed."""
        image, mask = _one(self.images, index), _one(self.masks, index)
        stats = [self._stats[index]]
        if self.packed is not None:
            place = replace(self.packed, words=_one(self.packed.words, index))
            cut_and_pack(image, stats, brightening=self._amount, out=mask, photos=place)
            return
        apply_hue_cut(image, stats, out=mask)
        brighten(image, mask, out=_one(self.bright, index), **self._amount)


def _one(array: Any, index: int) -> Any:
    """Element of an array, as an array of one."""
    return array[index : index + 1]


def _decoding(sizes: Sizes, folder: Path) -> Callable[[], Any]:
    from hsvaos.formats.images import decode

    path = folder / "photo.jpg"
    if not path.exists():
        cv2.imwrite(str(path), photos(1, sizes.photo)[0][..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
    return lambda: decode(path)


def _detector(device: Any, model: Path | None) -> Callable[..., object]:
    from hsvaos.detect.yolo import Detector

    return Detector(model, provider=None if device.is_cuda else "cpu").detect


def _on(device: Any, images: Any) -> Any:
    return wp.array(images, dtype=wp.uint8, device=device, copy=device.is_cuda)


def _pictures(shape: tuple[int, ...], device: Any) -> tuple[Any, Any]:
    image = wp.empty((*shape, 3), dtype=float, device=device)
    return image, wp.empty(shape, dtype=float, device=device)
