"""Integral images on disk: `integral.npz` of a run, or any picture."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import FlightError
from hsvaos.formats.images import decode_photo

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class StoredView:
    """An integral image as it lies on disk, with what lies beside it.

    Args:
        image: Shape (H, W, 3) RGB or (H, W) grey; uint8, uint16, or float32 with NaN where
            nothing is seen.
        rays: Shape (H, W), float32, rays of each pixel, or else its sum of weights; or None.
        rarity: Shape (H, W), float32, the rarity map; or None.
        gsd_m: Ground sampling distance [m/px] of a ground grid; or None.
    """

    image: Array
    rays: Array | None = None
    rarity: Array | None = None
    gsd_m: float | None = None

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Shape (H, W), where the image holds a value."""
        if self.image.dtype.kind != "f":
            return np.ones(self.image.shape[:2], bool)
        finite = np.isfinite(self.image)
        return np.asarray(finite if finite.ndim == 2 else finite.all(axis=2))


def read_view(path: str | Path) -> StoredView:
    """Read an integral image: `integral.npz` of `hsvaos run`, or a PNG, JPEG or TIFF file.

    What a picture's alpha channel hides counts as not seen.

    Args:
        path: The file.

    Raises:
        FlightError: If it cannot be read, or holds something else.
    """
    path = Path(path)
    if path.is_dir():
        raise FlightError(f"{path}: expected an image or integral.npz, got a folder")
    if path.suffix.lower() == ".npz":
        return _from_arrays(path)
    photo = decode_photo(path)
    image = photo.image
    if photo.alpha is not None:
        image = image.astype(np.float32)
        image[photo.alpha == 0] = np.nan
    return StoredView(image)


def _from_arrays(path: Path) -> StoredView:
    try:
        with np.load(path, allow_pickle=False) as stored:
            names = ("image", "footprint", "rays", "rarity_map", "rarity", "ortho")
            arrays = {name: np.asarray(stored[name]) for name in names if name in stored}
    except FileNotFoundError:
        raise FlightError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise FlightError(f"{path}: expected arrays as of integral.npz, got: {error}") from None
    image = arrays.get("image")
    if image is None:
        raise FlightError(f"{path}: expected an array called image, as in integral.npz")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim not in (2, 3) or image.dtype.kind not in "uif":
        raise FlightError(f"{path}: image must be (H, W, C) numbers, got {image.shape}")
    maps = [arrays.get(name) for name in ("footprint", "rays")]
    maps.append(arrays.get("rarity_map", arrays.get("rarity")))
    for found in maps:
        if found is not None and (found.shape != image.shape[:2] or found.dtype.kind not in "uif"):
            raise FlightError(
                f"{path}: expected maps of the image's size {image.shape[:2]}, got {found.shape}"
            )
    footprint, rays, rarity = maps
    if footprint is not None:
        image = image.astype(np.float32)
        image[footprint <= 0.0] = np.nan  # 0 stands there, which is no measurement
    grid = arrays.get("ortho")
    gsd_m = float(grid[2]) if grid is not None and grid.shape == (3,) else None
    return StoredView(image, footprint if rays is None else rays, rarity, gsd_m)
