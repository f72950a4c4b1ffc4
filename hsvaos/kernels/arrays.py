"""User arrays as Warp arrays of pixels, without copies where the memory allows."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hsvaos.kernels.device import resolve_device

SCALE = {wp.uint8: 255.0, wp.uint16: 65535.0, wp.float32: 1.0}
"""Value of full white by scalar type; float images are 0..1 where colour matters."""

_TINY = 16
"""Side from which (H, W, 3) is one RGB image, and not H grey ones three pixels wide."""

RGB = {wp.uint8: wp.vec3ub, wp.uint16: wp.vec3us, wp.float32: wp.vec3}
"""Pixel type of RGB images by scalar type."""

_SCALARS = {"uint8": wp.uint8, "uint16": wp.uint16, "float32": wp.float32}


def to_array(values: Any, device: Any, name: str) -> Any:
    """Return any array as a contiguous Warp array of uint8, uint16 or float32 on the device.

    Nothing is copied where the memory already lies on the device in the right order.

    Args:
        values: NumPy array, Warp array, or anything with DLPack or `__cuda_array_interface__`.
        device: Warp device.
        name: What to call it in messages.

    Raises:
        TypeError: If the element type is none of the three (bool counts as uint8 0 or 255).
    """
    if isinstance(values, wp.array):
        array = values
    elif hasattr(values, "__cuda_array_interface__"):
        array = wp.array(values, copy=False)
    elif hasattr(values, "__dlpack__") and not isinstance(values, np.ndarray):
        array = wp.from_dlpack(values)
    else:
        host = np.asarray(values)
        if host.dtype == bool:
            host = host.astype(np.uint8) * np.uint8(255)
        if host.dtype.name not in _SCALARS:
            raise TypeError(f"{name} must be uint8, uint16 or float32, got {host.dtype.name}")
        # image[None] has a stride of 0, which Warp would take for a gap and copy pixel by pixel
        host = np.ascontiguousarray(host).reshape(-1).reshape(host.shape)
        if not host.flags.writeable:  # Warp takes no read-only memory without a copy
            host = host.copy()
        array = wp.array(host, dtype=_SCALARS[host.dtype.name], device="cpu", copy=False)
    if array.dtype in RGB.values():  # e.g. (N, H, W) of vec3ub
        array = _as_scalars(array, next(s for s, v in RGB.items() if v is array.dtype))
    if array.dtype not in SCALE:
        raise TypeError(f"{name} must be uint8, uint16 or float32, got {array.dtype.__name__}")
    return array.contiguous().to(device)


def _as_scalars(array: Any, scalar: Any) -> Any:
    packed = array.contiguous()
    return pixel_view(packed, scalar, (*packed.shape, 3))


def pixel_view(array: Any, dtype: Any, shape: tuple[int, ...]) -> Any:
    """Return the memory of a contiguous Warp array under another type and shape."""
    view = wp.array(ptr=array.ptr, dtype=dtype, shape=shape, device=array.device, copy=False)
    view._ref = array  # keeps the memory alive as long as its view
    return view


def scalar_type(dtype: Any) -> Any:
    """Return the Warp scalar type of a dtype.

    Raises:
        TypeError: If it is none of uint8, uint16 and float32.
    """
    name = np.dtype(dtype).name
    if name not in _SCALARS:
        raise TypeError(f"dtype must be uint8, uint16 or float32, got {name}")
    return _SCALARS[name]


class Stack:
    """Images of equal size as one Warp array (N, H * W) of pixels.

    Args:
        images: Shape (N, H, W, 3) or (N, H, W); uint8, uint16 or float32; see `to_array`.
        device: Warp device.
        name: What to call the images in messages.

    Raises:
        TypeError: If the element type is not supported.
        ValueError: If the shape is not that of images.
    """

    def __init__(self, images: Any, device: Any, name: str = "images") -> None:
        if isinstance(images, (list, tuple)):
            images = _stacked(images, name)
        array = to_array(images, device, name)
        if array.ndim not in (3, 4) or (array.ndim == 4 and array.shape[3] != 3):
            raise ValueError(
                f"{name} must have shape (N, H, W, 3) or (N, H, W), got {tuple(array.shape)}"
            )
        if array.ndim == 3 and array.shape[2] == 3 and min(array.shape[:2]) > _TINY:
            raise ValueError(
                f"{name} must have shape (N, H, W, 3) or (N, H, W), got {tuple(array.shape)}: one "
                f"RGB image needs an axis in front, images[None]"
            )
        if 0 in array.shape:
            raise ValueError(f"{name} must not be empty, got shape {tuple(array.shape)}")
        self.array = array
        self.device = device
        self.scalar = array.dtype
        self.white = SCALE[array.dtype]
        self.channels = 3 if array.ndim == 4 else 1
        self.count, self.height, self.width = array.shape[:3]
        self.size = self.height * self.width
        self.pixel = RGB[self.scalar] if self.channels == 3 else self.scalar
        self.pixels = pixel_view(array, self.pixel, (self.count, self.size))

    def require_colour(self) -> None:
        """Raise where the images are grey.

        Raises:
            ValueError: If the images have one channel.
        """
        if self.channels != 3:
            raise ValueError("images must be RGB, shape (N, H, W, 3): grey images have no colour")


def _stacked(images: Any, name: str) -> Any:
    """One array of a list of images, which must be alike."""
    arrays = [
        image
        if isinstance(image, np.ndarray) or not hasattr(image, "__dlpack__")
        else np.from_dlpack(image)
        for image in images
    ]
    arrays = [np.asarray(array) for array in arrays]
    kinds = {(array.shape, array.dtype.name) for array in arrays}
    if len(kinds) != 1:
        found = ", ".join(f"{shape} {kind}" for shape, kind in sorted(kinds)) or "none"
        raise ValueError(f"{name} must be alike in shape and type, got {found}")
    return np.stack(arrays)


def require_unit_range(stack: Stack) -> None:
    """Raise where float images are clearly not 0..1, as colours are judged on that scale.

    Raises:
        ValueError: If a value above 2 is among a sample of the pixels.
    """
    if stack.scalar is not wp.float32:
        return
    for i in range(stack.count):
        sample = stack.array[i].numpy()[::4, ::4]
        top = float(np.max(sample, initial=0.0, where=np.isfinite(sample)))
        if top > 2.0:
            raise ValueError(
                f"float images must run from 0 to 1, got values up to {top:.4g}: divide by 255?"
            )


def valid_array(valid: Any, stack: Stack) -> Any:
    """Return user masks as a Warp array (N or 1, H * W) of uint8, 255 = use.

    Args:
        valid: Shape (H, W) for all images or (N, H, W), uint8 (0 = ignore, 255 = full weight) or
            bool; None for all pixels.
        stack: The images they belong to.

    Raises:
        ValueError: If the shape does not fit the images.
        TypeError: If the type is not uint8 or bool.
    """
    if valid is None:
        return wp.full((1, stack.size), 255, dtype=wp.uint8, device=stack.device)
    array = to_array(valid, stack.device, "valid")
    if array.dtype is not wp.uint8:
        raise TypeError(f"valid must be uint8 or bool, got {array.dtype.__name__}")
    shape = tuple(array.shape)
    if shape == (stack.height, stack.width):
        shape = (1, *shape)
    if shape[1:] != (stack.height, stack.width) or shape[0] not in (1, stack.count):
        raise ValueError(
            f"valid must have shape {(stack.height, stack.width)} or "
            f"{(stack.count, stack.height, stack.width)}, got {tuple(array.shape)}"
        )
    rows = array.reshape((shape[0], stack.size))
    if is_binary(rows):  # a mask of 0 and 1 means the same as one of 0 and 255
        rows = to_array(rows.numpy() * np.uint8(255), stack.device, "valid")
    return rows


def is_binary(weights: Any) -> bool:
    """Whether rows of uint8 hold 0 and 1 only, and both or only 1: a mask, not weights of 255ths.

    Args:
        weights: Warp array (N, H * W) of uint8. The first row of a mask of 0 and 255 decides.
    """
    seen_zero = False
    for i in range(weights.shape[0]):
        row = weights[i].numpy()
        if row.max() > 1:
            return False
        seen_zero = seen_zero or row.min() == 0
    return True


def pixel_scales(stack: Stack, gains: Any = None) -> list[Any]:
    """Return N vectors that bring the pixels of each image to 0..1, gains included.

    Args:
        stack: The images.
        gains: See `check_gains`.

    Raises:
        ValueError: As `check_gains`.
    """
    return [wp.vec3(*row) for row in check_gains(gains, stack) / stack.white]


def check_gains(gains: Any, stack: Stack) -> NDArray[np.float64]:
    """Return factors on the channels of each image, shape (N, 3).

    Args:
        gains: Shape (N, 3), positive factors on R, G and B of each image; None for ones.
        stack: The images.

    Raises:
        ValueError: If the shape is not (N, 3) or a gain is not positive.
    """
    factors = np.ones((stack.count, 3)) if gains is None else np.asarray(gains, dtype=np.float64)
    if factors.shape != (stack.count, 3) or not (np.isfinite(factors) & (factors > 0.0)).all():
        raise ValueError(f"gains must be ({stack.count}, 3) positive numbers, got {gains!r}")
    return factors


def device_of(values: Any, device: Any = None) -> Any:
    """Return the device asked for, or the one the input lies on, or the CPU."""
    if device is None:
        device = values.device if isinstance(values, wp.array) else None
    if device is None and hasattr(values, "__cuda_array_interface__"):
        device = wp.array(values, copy=False).device
    return resolve_device("cpu" if device is None else device)


def like_input(array: Any, images: Any) -> Any:
    """Return a result as NumPy if the input was host memory, else as the Warp array it is."""
    on_device = isinstance(images, wp.array) or hasattr(images, "__cuda_array_interface__")
    return array if on_device else array.numpy()


def output_array(out: Any, shape: tuple[int, ...], scalar: Any, device: Any, name: str) -> Any:
    """Return `out` as a Warp array that kernels write in place, or a new one if it is None.

    Raises:
        ValueError: If shape, type or place of `out` do not allow writing the result into it.
    """
    if out is None:
        return wp.empty(shape, dtype=scalar, device=device)
    if isinstance(out, np.ndarray) and not (out.flags.c_contiguous and out.flags.writeable):
        raise ValueError(f"{name} must be a writeable C-contiguous array")
    array = to_array(out, device, name)
    if tuple(array.shape) != shape or array.dtype is not scalar:
        raise ValueError(
            f"{name} must have shape {shape} and type {scalar.__name__}, got "
            f"{tuple(array.shape)} and {array.dtype.__name__}"
        )
    pointer = out.ctypes.data if isinstance(out, np.ndarray) else array.ptr
    if pointer != array.ptr:
        raise ValueError(f"{name} must lie on {device.alias}")
    return array
