"""Photos and masks decoded: lazily, in threads ahead of the consumer, damage found and named."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.flight import Flight, FlightError, Frame
from hsvaos.formats.header import ImageHeader, fault, read_header

Image = NDArray[Any]
Mask = NDArray[np.uint8]
OnError = Callable[[Frame, FlightError], None]

_HEADER_BYTES = 1 << 18
"""Read first for the header; enough but for photos with large previews before the picture."""
_MOST_WORKERS = 8
"""More threads only hold more photos in memory: the kernels are slower than eight decoders."""


@dataclass(frozen=True, eq=False)
class Photo:
    """One decoded photo.

    Args:
        image: Shape (H, W, 3) RGB or (H, W) grey; uint8, uint16 or float32, contiguous.
        alpha: Shape (H, W), uint8, 0 = ignore, 255 = use; None where every pixel may be used.
    """

    image: Image
    alpha: Mask | None


class _Quiet:
    """Keeps OpenCV's warnings, such as of TIFF tags it does not know, off the error stream.

    OpenCV has one level for the whole process: the first thread that decodes sets it, and the last
    one that ends restores what was there before.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._before = 0

    def __enter__(self) -> None:
        with self._lock:
            if self._inside == 0:
                level = cv2.utils.logging.getLogLevel()
                self._before = level
                cv2.utils.logging.setLogLevel(min(level, cv2.utils.logging.LOG_LEVEL_ERROR))
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                cv2.utils.logging.setLogLevel(self._before)


_QUIET = _Quiet()


def decode(path: str | Path) -> Image:
    """Decode a photo as it is stored: no turning by its Exif orientation, alpha left away.

    Args:
        path: JPEG, PNG, TIFF or what else OpenCV reads.

    Returns:
        Shape (H, W, 3) RGB or (H, W) grey; uint8, uint16 or float32.

    Raises:
        FlightError: If the file cannot be read, is cut off, or holds another kind of picture.
    """
    return decode_photo(path).image


def decode_photo(path: str | Path) -> Photo:
    """Decode a photo and its valid pixels: the alpha channel, and finite values of float photos.

    Args:
        path: As for `decode`.

    Raises:
        FlightError: As for `decode`.
    """
    path = Path(path)
    data = _read(path)
    problem = fault(data)
    if problem is not None:
        raise FlightError(f"{path}: expected a whole image, got a {problem}")
    try:
        with _QUIET:
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise FlightError(f"{path}: expected an image, OpenCV says: {error.err}") from None
    if pixels is None:
        raise FlightError(f"{path}: expected an image, got {len(data)} bytes that do not decode")
    pixels = np.asarray(pixels)
    header = read_header(data)
    if header is not None and header.channels == 1 and pixels.shape[2:] == (4,):
        pixels = pixels[..., 2:]  # OpenCV spreads grey with alpha over four channels
    return _photo(path, pixels)


def _photo(path: Path, pixels: Image) -> Photo:
    if pixels.dtype not in (np.uint8, np.uint16, np.float32):
        raise FlightError(
            f"{path}: expected pixels of type uint8, uint16 or float32, got {pixels.dtype}"
        )
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    alpha: Mask | None = None
    if channels in (2, 4):
        alpha = _as_mask(pixels[..., -1])
        pixels = pixels[..., :-1]
        channels -= 1
    if channels == 1:
        image = np.ascontiguousarray(pixels.reshape(pixels.shape[:2]))
    elif channels == 3:
        image = np.ascontiguousarray(pixels[..., ::-1])  # OpenCV's order is blue, green, red
    else:
        raise FlightError(f"{path}: expected 1 to 4 channels, got {channels}")
    if image.dtype == np.float32:
        finite = np.isfinite(image) if image.ndim == 2 else np.isfinite(image).all(axis=2)
        if not finite.all():
            image[~finite] = 0.0
            valid = np.where(finite, np.uint8(255), np.uint8(0))
            alpha = valid if alpha is None else np.minimum(alpha, valid)
    if alpha is not None and (alpha == 255).all():
        alpha = None
    return Photo(image, alpha)


def _as_mask(values: Image) -> Mask:
    if values.dtype == np.uint8:
        return np.ascontiguousarray(values)
    if values.dtype == np.uint16:
        return (values >> 8).astype(np.uint8)
    scaled: Image = np.round(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255.0)
    return scaled.astype(np.uint8)


def read_mask(path: str | Path, width: int, height: int) -> Mask:
    """Read a user mask: where photos may be used.

    A picture with an alpha channel that is not opaque everywhere is read by its alpha, another
    one by its brightest channel. A mask of pixels 0 and 1 is understood as 0 and 255.

    Args:
        path: Image file.
        width: Columns of the photos [px].
        height: Rows of the photos [px].

    Returns:
        Shape (height, width), uint8; 0 = ignore, 255 = use.

    Raises:
        FlightError: If it cannot be decoded or has another size than the photos.
    """
    photo = decode_photo(path)
    if photo.image.shape[:2] != (height, width):
        raise FlightError(
            f"{path}: expected a mask of {width} x {height} px like the photos, "
            f"got {photo.image.shape[1]} x {photo.image.shape[0]}"
        )
    if photo.alpha is not None:
        return photo.alpha
    values = photo.image if photo.image.ndim == 2 else photo.image.max(axis=2)
    mask = _as_mask(values)
    return mask * np.uint8(255) if values.dtype == np.uint8 and mask.max() == 1 else mask


def image_header(path: str | Path) -> ImageHeader:
    """Return size and channels of an image file, from its header where that is possible.

    Raises:
        FlightError: If the file cannot be read or is no image.
    """
    path = Path(path)
    header = read_header(_read(path, _HEADER_BYTES)) or read_header(_read(path))
    if header is None:
        image = decode(path)
        header = ImageHeader(image.shape[1], image.shape[0], 1 if image.ndim == 2 else 3)
    if header.width < 1 or header.height < 1:
        raise FlightError(f"{path}: expected an image, got one of {header.width}x{header.height}")
    return header


def image_size(path: str | Path) -> tuple[int, int]:
    """Return (width, height) of an image file [px], from its header where that is possible.

    Raises:
        FlightError: If the file cannot be read or is no image.
    """
    return image_header(path)[:2]


def _read(path: Path, most: int = -1) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(most)
    except FileNotFoundError:
        raise FlightError(f"{path}: no such image") from None
    except OSError as error:
        raise FlightError(f"{path}: cannot be read ({error.strerror})") from None
    if not data:
        raise FlightError(f"{path}: expected an image, got an empty file")
    return data


def decode_ahead(
    flight: Flight, workers: int | None = None, on_error: OnError | None = None
) -> Iterator[Any]:
    """Yield the photos of a flight in order, decoded in threads ahead of the consumer.

    Args:
        flight: The flight.
        workers: Threads that decode; by default one a core, at most 8.
        on_error: Called with a frame that cannot be used and why; its place then yields None.
            Without it the error is raised.

    Yields:
        Shape (H, W, 3) RGB or (H, W) grey, uint8, uint16 or float32, as `decode` returns them;
        None for a frame that was reported.

    Raises:
        FlightError: If a photo cannot be decoded, has another size than the camera, or is of
            another kind (grey or colour, pixel type) than the first one.
    """
    for photo in photos_ahead(flight, workers, on_error):
        yield None if photo is None else photo.image


def photos_ahead(
    flight: Flight, workers: int | None = None, on_error: OnError | None = None
) -> Iterator[Photo | None]:
    """Yield photos with their valid pixels: `decode_ahead` with all user masks applied.

    `Photo.alpha` is then the least of the photo's own alpha, the flight's mask and the frame's.

    Args:
        flight: The flight.
        workers: As for `decode_ahead`.
        on_error: As for `decode_ahead`.

    Raises:
        FlightError: As for `decode_ahead`; always if the flight's own mask cannot be used.
    """
    threads = workers or min(os.cpu_count() or 1, _MOST_WORKERS)
    camera = flight.camera
    mask = read_mask(flight.mask, camera.width, camera.height) if flight.mask else None
    pool = ThreadPoolExecutor(threads, thread_name_prefix="hsvaos-decode")
    waiting: deque[tuple[Frame, Future[Photo]]] = deque()
    todo = iter(flight.frames)
    kind: tuple[int, Any] | None = None
    try:
        while True:
            # One more than there are threads: none of them idles while the consumer works.
            while len(waiting) <= threads and (frame := next(todo, None)) is not None:
                waiting.append((frame, pool.submit(_usable_photo, frame, flight, mask)))
            if not waiting:
                return
            frame, future = waiting.popleft()
            photo: Photo | None = None
            try:
                photo = future.result()
                kind = kind or _kind(photo)
                _check_kind(frame, photo, kind)
            except FlightError as error:
                if on_error is None:
                    raise
                photo = None
                on_error(frame, error)
            yield photo
    finally:
        # Also on close(), an exception of the consumer or Ctrl-C: what runs ends, the rest never
        # starts.
        pool.shutdown(wait=True, cancel_futures=True)


def _usable_photo(frame: Frame, flight: Flight, mask: Mask | None) -> Photo:
    photo = decode_photo(frame.path)
    width, height = flight.camera.width, flight.camera.height
    if photo.image.shape[:2] != (height, width):
        raise FlightError(
            f"{frame.path}: expected {width} x {height} px like the camera, "
            f"got {photo.image.shape[1]} x {photo.image.shape[0]}"
        )
    masks = [photo.alpha, mask, read_mask(frame.mask, width, height) if frame.mask else None]
    parts = [part for part in masks if part is not None]
    return Photo(photo.image, np.minimum.reduce(parts) if parts else None)


def _kind(photo: Photo) -> tuple[int, Any]:
    return photo.image.ndim, photo.image.dtype


def _check_kind(frame: Frame, photo: Photo, kind: tuple[int, Any]) -> None:
    if _kind(photo) != kind:
        raise FlightError(
            f"{frame.path}: expected {_kind_text(kind)} like the first photo, "
            f"got {_kind_text(_kind(photo))}"
        )


def _kind_text(kind: tuple[int, Any]) -> str:
    return f"{'grey' if kind[0] == 2 else 'RGB'} {kind[1]}"
