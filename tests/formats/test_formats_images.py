from __future__ import annotations

import struct
import threading
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hsvaos.camera import Camera
from hsvaos.flight import Flight, FlightError, Frame
from hsvaos.formats.header import fault, read_header
from hsvaos.formats.images import (
    decode,
    decode_ahead,
    decode_photo,
    image_size,
    photos_ahead,
    read_mask,
)

RNG = np.random.default_rng(1)
NOISE = RNG.integers(0, 256, (40, 60, 3), dtype=np.uint8)


def encoded(suffix, pixels, *options):
    return cv2.imencode(suffix, pixels, list(options))[1].tobytes()


JPEGS = {
    "baseline": encoded(".jpg", NOISE),
    "grey": encoded(".jpg", NOISE[..., 0]),
    "progressive": encoded(".jpg", NOISE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "restarts": encoded(".jpg", NOISE, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
}
IMAGES = JPEGS | {"png": encoded(".png", NOISE), "tiff": encoded(".tiff", NOISE)}


def folder_of(tmp_path, images, masks=None):
    """A flight of images as given, each bytes or pixels."""
    frames = []
    for i, image in enumerate(images):
        path = tmp_path / f"{i:03d}.png"
        path.write_bytes(image if isinstance(image, bytes) else encoded(".png", image))
        frames.append(Frame(path.name, path, np.eye(4), mask=(masks or {}).get(i)))
    return Flight("test", Camera.from_fov(60, 40, 60.0), tuple(frames), source=tmp_path)


@pytest.mark.parametrize(
    ("suffix", "pixels"),
    [
        (".png", NOISE),
        (".png", NOISE[..., 0]),
        (".png", NOISE.astype(np.uint16) * 257),
        (".tiff", NOISE),
        (".tiff", NOISE[..., 1].astype(np.uint16) * 100),
        (".tiff", NOISE.astype(np.float32) / 7),
        (".tiff", NOISE[..., 2].astype(np.float32) / 7),
    ],
)
def test_lossless_files_come_back_as_rgb(tmp_path, suffix, pixels):
    path = tmp_path / ("wrong_name.jpg")  # content counts, not the name
    path.write_bytes(encoded(suffix, pixels if pixels.ndim == 2 else pixels[..., ::-1]))
    image = decode(path)
    assert image.dtype == pixels.dtype
    np.testing.assert_array_equal(image, pixels)
    assert image_size(path) == (60, 40)
    assert decode_photo(path).alpha is None


@pytest.mark.parametrize("name", IMAGES)
def test_header_and_completeness(name):
    header = read_header(IMAGES[name])
    assert header == (60, 40, 1 if name == "grey" else 3)
    assert fault(IMAGES[name]) is None
    assert fault(IMAGES[name] + b"trailing preview data") is None


@settings(max_examples=60)
@given(st.sampled_from(sorted(IMAGES)), st.floats(0.0, 0.999))
def test_every_cut_is_found(name, share):
    data = IMAGES[name]
    if name == "tiff":  # OpenCV writes the pixels first and the tags last
        share = min(share, 0.95)
    cut = data[: max(8, int(len(data) * share))]
    assert "truncated" in (fault(cut) or "")


def test_end_marker_of_a_preview_does_not_count():
    jpeg, preview = JPEGS["baseline"], JPEGS["grey"]
    segment = b"\xff\xe1" + struct.pack(">H", len(preview) + 8) + b"Exif\0\0" + preview
    whole = jpeg[:2] + segment + jpeg[2:]
    assert fault(whole) is None
    assert fault(whole[: len(segment) + 700]) is not None


def test_truncated_and_unreadable_are_named(tmp_path):
    for name, content, what in (
        ("cut.jpg", JPEGS["baseline"][:-500], "truncated JPEG"),
        ("cut.png", IMAGES["png"][:-20], "truncated PNG"),
        ("bits.png", IMAGES["png"][:900] + b"\0\0\0" + IMAGES["png"][903:], "damaged PNG.*IDAT"),
        ("text.jpg", b"hello, not an image", "do not decode"),
        ("empty.jpg", b"", "empty file"),
        ("double.tiff", encoded(".tiff", NOISE.astype(np.float64)), "float64"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FlightError, match=what) as error:
            decode(tmp_path / name)
        assert name in str(error.value)
        assert "\n" not in str(error.value)
    with pytest.raises(FlightError, match="no such image"):
        decode(tmp_path / "absent.jpg")


def test_exif_orientation_is_ignored(tmp_path):
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    jpeg = JPEGS["baseline"]
    path = tmp_path / "turned.jpg"
    path.write_bytes(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:])
    assert decode(path).shape == (40, 60, 3)


def test_alpha_comes_apart(tmp_path):
    alpha = np.where(np.arange(60) < 20, 0, 255).astype(np.uint8) * np.ones((40, 1), np.uint8)
    path = tmp_path / "alpha.png"
    path.write_bytes(encoded(".png", np.dstack([NOISE[..., ::-1], alpha])))
    photo = decode_photo(path)
    np.testing.assert_array_equal(photo.image, NOISE)
    np.testing.assert_array_equal(photo.alpha, alpha)
    np.testing.assert_array_equal(read_mask(path, 60, 40), alpha)


def test_grey_with_alpha_stays_grey(tmp_path):
    def chunk(kind, content):
        crc = struct.pack(">I", zlib.crc32(kind + content))
        return struct.pack(">I", len(content)) + kind + content + crc

    path = tmp_path / "grey_alpha.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 1, 8, 4, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(b"\0" + bytes([10, 200, 20, 100])))
        + chunk(b"IEND", b"")
    )
    photo = decode_photo(path)
    np.testing.assert_array_equal(photo.image, [[10, 20]])
    np.testing.assert_array_equal(photo.alpha, [[200, 100]])


def test_nan_pixels_are_ignored(tmp_path):
    pixels = NOISE[..., 0].astype(np.float32)
    pixels[3, 4] = np.nan
    path = tmp_path / "thermal.tiff"
    path.write_bytes(encoded(".tiff", pixels))
    photo = decode_photo(path)
    assert np.isfinite(photo.image).all()
    assert photo.alpha[3, 4] == 0
    assert (photo.alpha == 0).sum() == 1


def test_mask_of_zeros_and_ones_and_of_wrong_size(tmp_path):
    path = tmp_path / "mask.png"
    path.write_bytes(encoded(".png", np.eye(40, dtype=np.uint8)))
    np.testing.assert_array_equal(read_mask(path, 40, 40), np.eye(40, dtype=np.uint8) * 255)
    with pytest.raises(FlightError, match="60 x 40 px like the photos, got 40 x 40"):
        read_mask(path, 60, 40)


@pytest.mark.parametrize("workers", [1, 3, None])
def test_decode_ahead_keeps_the_order(tmp_path, workers):
    flight = folder_of(tmp_path, [np.full((40, 60), i, np.uint8) for i in range(12)])
    assert [int(image[0, 0]) for image in decode_ahead(flight, workers)] == list(range(12))
    assert len(list(flight.images())) == 12


def test_look_ahead_is_bounded_and_ends_on_close(tmp_path, monkeypatch):
    import hsvaos.formats.images as module

    flight = folder_of(tmp_path, [NOISE] * 20)
    opened = []
    decode_as_it_is = module.decode_photo

    def counted(path):
        opened.append(path.name)
        return decode_as_it_is(path)

    monkeypatch.setattr(module, "decode_photo", counted)
    photos = decode_ahead(flight, 2)
    next(photos)
    photos.close()
    assert len(opened) <= 4
    assert not [t for t in threading.enumerate() if t.name.startswith("hsvaos-decode")]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_threads_end_when_the_consumer_fails(tmp_path, error):
    photos = decode_ahead(folder_of(tmp_path, [NOISE] * 8), 2)
    next(photos)
    with pytest.raises(error):
        photos.throw(error())
    assert not [t for t in threading.enumerate() if t.name.startswith("hsvaos-decode")]


def test_bad_photos_raise_or_are_reported(tmp_path):
    images = [NOISE, IMAGES["png"][:-30], NOISE[:20], NOISE[..., 0], NOISE]
    flight = folder_of(tmp_path, images)
    with pytest.raises(FlightError, match=r"001\.png.*truncated"):
        list(decode_ahead(flight))
    reported = []
    photos = list(decode_ahead(flight, on_error=lambda f, e: reported.append((f.name, str(e)))))
    assert [photo is None for photo in photos] == [False, True, True, True, False]
    names, reasons = zip(*reported, strict=True)
    assert names == ("001.png", "002.png", "003.png")
    assert "truncated" in reasons[0]
    assert "expected 60 x 40 px like the camera, got 60 x 20" in reasons[1]
    assert "expected RGB uint8 like the first photo, got grey uint8" in reasons[2]


def test_masks_of_flight_frame_and_photo_are_all_applied(tmp_path):
    alpha, of_flight, of_frame = (np.full((40, 60), 255, np.uint8) for _ in range(3))
    alpha[0], of_flight[1], of_frame[2] = 0, 0, 0
    for name, mask in (("flight", of_flight), ("frame", of_frame)):
        (tmp_path / f"{name}.png").write_bytes(encoded(".png", mask))
    images = [np.dstack([NOISE, alpha]), NOISE]
    flight = folder_of(tmp_path, images, {0: tmp_path / "frame.png"})
    flight = flight.replace(mask=tmp_path / "flight.png")
    first, second = photos_ahead(flight)
    ignored = [np.flatnonzero((photo.alpha == 0).all(axis=1)).tolist() for photo in (first, second)]
    assert ignored == [[0, 1, 2], [1]]


def tiff_with_tag(pixels, tag):
    """A TIFF with one more tag of text, which OpenCV warns of where it does not know it."""
    data = encoded(".tiff", pixels)
    at = struct.unpack_from("<I", data, 4)[0]
    count = struct.unpack_from("<H", data, at)[0]
    entries = data[at + 2 : at + 2 + 12 * count] + struct.pack("<HHI4s", tag, 2, 4, b"abc")
    directory = struct.pack("<H", count + 1) + entries + struct.pack("<I", 0)
    return data[:4] + struct.pack("<I", len(data)) + data[8:] + directory


def test_unknown_tags_are_passed_over_quietly(tmp_path, capfd):
    flight = folder_of(tmp_path, [tiff_with_tag(NOISE, 42112)] * 20)
    before = cv2.utils.logging.getLogLevel()
    for image in decode_ahead(flight, workers=4):
        np.testing.assert_array_equal(image, NOISE[..., ::-1])
    assert capfd.readouterr() == ("", "")
    assert cv2.utils.logging.getLogLevel() == before
    cv2.imdecode(np.frombuffer(tiff_with_tag(NOISE, 42112), np.uint8), cv2.IMREAD_UNCHANGED)
    assert "42112" in capfd.readouterr().err
