"""The detector around its networks: our own layout, what is not seen, resampling, bad input."""

from __future__ import annotations

import contextlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hsvaos.detect.network as network
import hsvaos.detect.yolo as yolo
from hsvaos import Detector
from hsvaos.detect.fitting import as_bytes
from hsvaos.detect.network_input import CHANNELS, network_input
from hsvaos.detect.view_input import checked_view, windows
from tests.detect.nets import OWN, own_net, photo_net

RED_CONTRAST = [8.0, -4.0, -4.0] + [0.0] * 5


def forest(seed: int, height: int = 160, width: int = 200) -> np.ndarray:
    """A noisy green integral image in units of the photos."""
    rng = np.random.default_rng(seed)
    return rng.normal((60.0, 90.0, 50.0), 5.0, (height, width, 3)).astype(np.float32)


def with_person(seed: int, row: int, column: int, **size: int) -> np.ndarray:
    """The forest with 16 x 16 red pixels, first one at a row and column."""
    image = forest(seed, **size)
    image[row : row + 16, column : column + 16] = (190.0, 60.0, 50.0)
    return image


def test_own_layout_finds_a_cell_of_strong_contrast() -> None:
    detector = Detector(own_net(RED_CONTRAST, -5.0))
    assert (detector.layout, detector.people, detector.score) == ("hsvaos", (0,), 0.4)
    found = detector.detect(with_person(0, 64, 112))
    assert len(found) == 1
    np.testing.assert_allclose(found.boxes_xyxy[0], [111.5, 63.5, 127.5, 79.5], atol=1e-4)
    assert len(detector.detect(forest(0))) == 0
    assert (
        len(Detector(own_net(RED_CONTRAST, -5.0), score=1.0).detect(with_person(0, 64, 112))) == 0
    )


def test_own_layout_gets_all_channels() -> None:
    image, rays = with_person(1, 32, 48), np.full((160, 200), 30.0, np.float32)
    rarity = np.zeros((160, 200), np.float32)
    rarity[96:112, 16:32] = 1.0
    only = [0.0] * len(CHANNELS)
    only[CHANNELS.index("rarity")] = 8.0
    found = Detector(own_net(only, -4.0)).detect(image, footprint=rays, rarity=rarity)
    np.testing.assert_allclose(found.boxes_xyxy, [[15.5, 95.5, 31.5, 111.5]], atol=1e-4)
    only = [0.0] * len(CHANNELS)
    only[CHANNELS.index("plain red")] = 8.0
    plain = with_person(1, 0, 160)
    found = Detector(own_net(only, -4.0)).detect(image, footprint=rays, plain=plain)
    np.testing.assert_allclose(found.boxes_xyxy, [[159.5, -0.5, 175.5, 15.5]], atol=1e-4)
    only = [0.0] * len(CHANNELS)
    only[CHANNELS.index("rays")] = 100.0
    detector = Detector(own_net(only, -5.0), iou=0.9)
    assert len(detector.detect(image, footprint=rays)) == 10 * 13  # its last column is cut off
    assert len(detector.detect(image)) == 0  # nobody knows how many


def test_finds_on_ground_of_few_rays_are_doubted() -> None:
    image, rays = with_person(1, 32, 48), np.full((160, 200), 30.0, np.float32)
    weak = [0.1 * weight for weight in RED_CONTRAST]
    detector = Detector(own_net(weak, -1.0), score=0.3)
    known = {"footprint": rays, "rarity": np.zeros_like(rays)}
    sure = detector.detect(image, **known)
    assert float(sure.scores[0]) < 0.95
    rays[:, :100] = 3.0
    less = detector.detect(image, **known)
    assert len(sure) == len(less) == 1
    odds = [float(found.scores[0] / (1.0 - found.scores[0])) for found in (sure, less)]
    assert odds[1] == pytest.approx(0.6 * odds[0], rel=1e-3)
    strict = Detector(own_net(weak, -1.0), score=0.9 * float(sure.scores[0]))
    assert len(strict.detect(image, **known)) == 0
    # weights of a masked image are no count of rays
    alone = detector.detect(image, footprint=rays / 50.0)
    assert float(alone.scores[0]) == pytest.approx(float(sure.scores[0]), abs=1e-4)


def test_what_is_not_seen_is_nothing_and_is_not_found() -> None:
    detector = Detector(own_net(RED_CONTRAST, -5.0))
    image = with_person(2, 64, 112)
    hidden = image.copy()
    hidden[:, :80] = np.nan
    found = detector.detect(hidden)
    np.testing.assert_allclose(found.boxes_xyxy, [[111.5, 63.5, 127.5, 79.5]], atol=1e-4)
    rays = np.full(image.shape[:2], 9.0)
    rays[60:84, 108:132] = 0.0
    assert len(detector.detect(image, footprint=rays)) == 0
    for nothing in (np.full((50, 60, 3), np.nan), np.full((50, 60), np.inf, np.float64)):
        assert len(detector.detect(nothing)) == 0
    every = Detector(own_net([0.0] * 8, 9.0), iou=0.9)  # finds each cell
    assert len(every.detect(forest(0))) == 130
    half = forest(0)
    half[:, 96:] = np.nan
    assert len(every.detect(half)) == 60


@pytest.mark.parametrize("gsd_m", [0.02, 0.16, 0.05])
def test_views_are_resampled_to_what_was_trained(gsd_m: float) -> None:
    """A person of 0.8 m x 0.8 m is 16 pixels at 5 cm, whatever the view's distance is."""
    side = round(0.8 / gsd_m)
    image = cv2.resize(forest(3, 200, 240), None, fx=0.05 / gsd_m, fy=0.05 / gsd_m)
    # cell 4, 6 of the view at 5 cm
    row, column = 4 * side, 6 * side
    image[row : row + side, column : column + side] = (190.0, 60.0, 50.0)
    detector = Detector(own_net(RED_CONTRAST, -3.0))
    found = detector.detect(image, gsd_m=gsd_m)
    assert len(found) == 1
    box = np.array([column, row, column + side, row + side]) - 0.5
    np.testing.assert_allclose(found.boxes_xyxy[0], box, atol=0.02 * side)
    rays = np.full(image.shape[:2], 5, np.int32)
    again = detector.detect(image, footprint=rays, plain=image, rarity=rays * 0.1, gsd_m=gsd_m)
    np.testing.assert_allclose(again.boxes_xyxy, found.boxes_xyxy)


def test_unseen_does_not_bleed_when_resampled() -> None:
    image = np.full((60, 60), 100.0, np.float32)
    image[:, 30:] = np.nan
    for size in ((25, 25), (130, 130)):
        small = checked_view(image, rarity=image).resized(*size)
        for part in (small.image, small.rarity):
            known = part[np.isfinite(part)]
            np.testing.assert_allclose(known, 100.0, rtol=1e-5)
            assert 0.45 < len(known) / part.size < 0.55


def test_large_views_of_our_own_are_cut() -> None:
    image = forest(4, 700, 500)
    places = [(16, 16), (336, 240), (640, 464), (304, 0), (100, 300)]
    for row, column in places:
        image[row : row + 32, column : column + 32] = (190.0, 60.0, 50.0)
    whole = Detector(own_net(RED_CONTRAST, -3.0), slice_px=0).detect(image)
    for cut in (
        Detector(own_net(RED_CONTRAST, -3.0), slice_px=300),
        Detector(own_net(RED_CONTRAST, -3.0, dynamic=False)),
    ):
        found = cut.detect(image)
        for one, other in ((whole, found), (found, whole)):
            middle = (one.boxes_xyxy[:, :2] + one.boxes_xyxy[:, 2:]) / 2.0
            around = other.boxes_xyxy[None]
            inside = (middle[:, None] >= around[..., :2] - 16.0).all(axis=2)
            inside &= (middle[:, None] <= around[..., 2:] + 16.0).all(axis=2)
            assert inside.any(axis=1).all()


@given(
    height=st.integers(1, 900),
    width=st.integers(1, 900),
    side=st.integers(32, 400),
    overlap=st.integers(12, 30),
)
def test_windows_cover_each_place_once(height: int, width: int, side: int, overlap: int) -> None:
    parts = windows((height, width), (side, side), overlap)
    kept = np.zeros((height, width), int)
    for part in parts:
        assert 0 <= part.top < part.bottom <= height
        assert part.bottom - part.top == min(side, height)
        assert part.right - part.left == min(side, width)
        rows = np.arange(height)[:, None]
        columns = np.arange(width)[None]
        top, left, bottom, right = part.keep
        mine = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
        # what a window keeps lies within it, and not at its cut border
        inside = (rows >= part.top) & (rows < part.bottom)
        assert (mine <= (inside & (columns >= part.left) & (columns < part.right))).all()
        kept += mine
    assert kept.min() >= 1
    assert (kept == 1).mean() > 0.2 or side < 60


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (33, 1), (2, 3)])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_pictures_of_a_pixel(size: tuple[int, int], kind: type) -> None:
    for model in (
        own_net(RED_CONTRAST),
        photo_net("yolov8"),
        photo_net("yolox"),
        photo_net("dfine"),
    ):
        detector = Detector(model)
        for shape in (size, (*size, 3), (*size, 1)):
            found = detector.detect(np.zeros(shape, kind))
            assert found.boxes_xyxy.shape == (len(found), 4)


def test_grey_and_floats_are_stretched_for_networks_of_photos() -> None:
    rng = np.random.default_rng(0)
    grey = rng.normal(9000.0, 30.0, (80, 90)).astype(np.uint16)
    grey[40:48, 40:48] = 9800
    stretched = as_bytes(checked_view(grey))
    assert stretched.shape == (80, 90, 3)
    assert stretched[44, 44].tolist() == [255] * 3
    assert 10 < np.median(stretched) < 120
    colour = rng.integers(0, 255, (80, 90, 3)).astype(np.uint8)
    np.testing.assert_array_equal(as_bytes(checked_view(colour)), colour)
    part = colour.astype(np.float32) * 1e-3
    part[:10] = np.nan
    picture = as_bytes(checked_view(part))
    assert (picture[:10] == 114).all()
    np.testing.assert_allclose(picture[10:], colour[10:], atol=6)
    flat = as_bytes(checked_view(np.full((5, 5), 7.0, np.float32)))
    assert (flat == flat[0, 0]).all()


def test_empty_batch_and_nothing_found() -> None:
    detector = Detector(own_net(RED_CONTRAST, -99.0))
    assert detector.detect_batch([]) == []
    (found,) = detector.detect_batch([forest(1)], gsd_m=[None])
    assert found.boxes_xyxy.shape == (0, 4)
    assert found.boxes_xyxy.dtype == np.float32
    assert found.class_ids.dtype == np.int64


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"image": np.zeros((0, 5, 3))}, ValueError, "image must be"),
        ({"image": np.zeros((5, 5, 4))}, ValueError, "image must be"),
        ({"image": np.zeros((5, 5), np.int64)}, TypeError, "image must hold uint8"),
        ({"image": np.array(["a"]).reshape(1, 1)}, TypeError, "image must hold"),
        ({"footprint": np.ones((5, 6))}, ValueError, "footprint must have the image's shape"),
        ({"footprint": np.array([["a"] * 5] * 5)}, TypeError, "footprint must hold numbers"),
        ({"rarity": np.ones((4, 5))}, ValueError, "rarity must have"),
        ({"plain": np.ones((5, 6, 3))}, ValueError, "plain must have the image's size"),
        ({"gsd_m": 0.0}, ValueError, "gsd_m must be a positive"),
        ({"gsd_m": float("nan")}, ValueError, "gsd_m must be finite"),
        ({"gsd_m": "5 cm"}, TypeError, "gsd_m must be a number"),
        ({"gsd_m": 1e6}, ValueError, "is it in metres"),
        ({"gsd_m": 1e-9}, None, ""),
    ],
)
def test_wrong_arguments(
    arguments: dict[str, object], error: type[Exception] | None, message: str
) -> None:
    detector = Detector(own_net(RED_CONTRAST))
    given: dict[str, object] = {"image": np.zeros((5, 5))} | arguments
    if error is None:
        detector.detect(**given)  # type: ignore[arg-type]
        return
    with pytest.raises(error, match=message):
        detector.detect(**given)  # type: ignore[arg-type]


def test_counts_that_differ_are_refused() -> None:
    detector = Detector(own_net(RED_CONTRAST))
    with pytest.raises(ValueError, match="rarities must have one entry for each of 2"):
        detector.detect_batch([forest(0)] * 2, rarities=[None])
    with pytest.raises(ValueError, match="gsd_m must have one entry"):
        detector.detect_batch([forest(0)] * 2, gsd_m=[0.05])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"score": 2.0}, ValueError, "score must lie within"),
        ({"score": "high"}, TypeError, "score must be a number"),
        ({"iou": -0.1}, ValueError, "iou must lie within"),
        ({"max_finds": 0}, ValueError, "max_finds must be at least 1"),
        ({"slice_px": 8}, ValueError, "slice_px must be 0 or at least 32"),
        ({"size_px": 3}, ValueError, "size_px must be at least 32"),
        ({"size_px": 320}, ValueError, "takes pictures of 96 x 96 px only"),
        ({"provider": "cuda"}, ValueError, "provider 'cuda' is not here"),
        ({"provider": "abacus"}, ValueError, "provider 'abacus' is not here"),
        ({"layout": "yolov99"}, ValueError, "layout must be auto or one of hsvaos"),
        ({"layout": "yolov4"}, ValueError, "layout yolov4 expects boxes"),
        ({"layout": "hsvaos"}, ValueError, "layout hsvaos expects 25 input channels"),
        ({"layout": "end2end"}, ValueError, "layout end2end expects"),
        ({"person_class": 80}, ValueError, "person_class must lie within 0 to 79"),
        ({"person_class": "person"}, ValueError, "is no class name"),
        ({"person_class": 1.5}, TypeError, "person_class must be a number or a name"),
    ],
)
def test_wrong_options(options: dict[str, object], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Detector(photo_net("yolov8"), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({"names": "person"}, "expected class names such as"),
        ({"names": "{0: 5}"}, "expected class names such as"),
        ({"names": "[]"}, "expected class names such as"),
        ({"names": "['person']"}, "metadata name 1 classes .* output has 3"),
        ({"names": "{1: 'a', 2: 'b', 3: 'person'}"}, r"numbers 1 to 3\), its output has 3"),
        ({"names": "['car', 'bus', 'dog']"}, "no class is a person"),
        ({"task": "segment"}, "expected a detection network, got one for 'segment'"),
        ({}, "3 classes without names; say which number is the person_class"),
    ],
)
def test_wrong_metadata(metadata: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Detector(photo_net("yolov8", classes=3, metadata=metadata))


@pytest.mark.parametrize("key", ["stride", "score_threshold", "person_score_threshold"])
@pytest.mark.parametrize("value", ["", "-1", "sixteen", "nan"])
def test_wrong_metadata_of_our_own(key: str, value: str) -> None:
    with pytest.raises(ValueError, match=f"{key}|stride"):
        Detector(own_net([0.0] * 8, metadata=OWN | {key: value}))


@pytest.mark.parametrize(
    "told",
    [
        {"gsd_m": "0.04"},
        {"gsd_m": "fine,coarse"},
        {"gsd_m": "0.09,0.04"},
        {"gsd_m": "0.04,0.09", "aim_gsd_m": "0.1"},
        {"aim_gsd_m": "nan"},
    ],
)
def test_wrong_sampling_distances_of_our_own(told: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="expected gsd_m in the metadata as two distances"):
        Detector(own_net([0.0] * 8, metadata=OWN | told))


def test_a_network_is_shown_the_sampling_that_it_asks_for() -> None:
    seen: list[tuple[int, int]] = []

    class Watched(Detector):
        def _run(self, tiles):  # type: ignore[no-untyped-def]
            seen.extend(tile.planes.shape[1:] for tile in tiles)
            return super()._run(tiles)

    told = OWN | {"gsd_m": "0.1,0.2", "aim_gsd_m": "0.16"}
    detector = Watched(own_net([0.0] * 8, metadata=told))
    for gsd_m in (0.15, 0.05, 0.32):
        detector.detect(np.zeros((160, 320)), gsd_m=gsd_m)
    assert seen == [(160, 320), (64, 112), (320, 640)]


def test_files_that_are_no_network(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such ONNX file"):
        Detector(tmp_path / "gone.onnx")
    with pytest.raises(ValueError, match="cannot be read"):
        Detector(tmp_path)
    for content in (b"", b"this is no network", own_net([0.0] * 8)[:-300]):
        path = tmp_path / "bad.onnx"
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"bad.onnx: expected an ONNX network"):
            Detector(path)


def test_weights_that_are_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(yolo, "PACKAGED", tmp_path / "person.onnx")
    with pytest.raises(ValueError, match="no weights of its own"):
        Detector()


def test_network_that_fails_names_itself(tmp_path: Path) -> None:
    path = tmp_path / "stubborn.onnx"
    path.write_bytes(photo_net("yolov8", dynamic=True))
    detector = Detector(path, size_px=100)  # no multiple of 32: its grids do not fit
    assert len(detector.detect(np.zeros((50, 50, 3), np.uint8))) == 0
    mixed = tmp_path / "mixed.onnx"
    mixed.write_bytes(photo_net("yolov8", strides=(200,)))  # cells larger than the picture
    with pytest.raises(ValueError, match=r"mixed.onnx"):
        Detector(mixed).detect(np.zeros((50, 50, 3), np.uint8))


def test_provider_is_said_aloud(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="hsvaos"):
        detector = Detector(own_net([0.0] * 8), provider="cpu")
    assert detector.provider == "cpu"
    assert "runs on cpu" in caplog.text


class Session:
    """Stands for onnxruntime where CUDA is offered but cannot be started."""

    def __init__(self, content: bytes, options: object, providers: list[str], **_: object) -> None:
        if self.raises and "CUDAExecutionProvider" in providers:
            raise RuntimeError("no CUDA-capable device")
        self._real = real_session(content, options, providers=["CPUExecutionProvider"])

    raises = True

    def __getattr__(self, name: str) -> object:
        return getattr(self._real, name)


real_session = network.ort.InferenceSession


@pytest.mark.parametrize("raises", [True, False])
def test_gpu_that_cannot_be_started_is_said_aloud(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, raises: bool
) -> None:
    offered = ["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(network.ort, "get_available_providers", lambda: offered)
    monkeypatch.setattr(network.ort, "InferenceSession", Session)
    monkeypatch.setattr(Session, "raises", raises)
    detector = Detector(own_net([0.0] * 8))
    assert detector.provider == "cpu"
    assert detector.notes == ("cuda could not be started, the network runs on cpu",)
    assert "cuda could not be started" in caplog.text
    with pytest.raises(ValueError, match=r"cuda|CUDA"):
        Detector(own_net([0.0] * len(CHANNELS)), provider="cuda")


@given(seed=st.integers(0, 10**6))
def test_damaged_networks_work_or_say_why(seed: int) -> None:
    rng = np.random.default_rng(seed)
    content = bytearray(own_net(RED_CONTRAST))
    for _ in range(int(rng.integers(1, 6))):
        content[rng.integers(len(content))] = rng.integers(256)
    with contextlib.suppress(ValueError):
        Detector(bytes(content)).detect(np.zeros((20, 30, 3), np.uint8))


def test_network_gets_the_channels_it_names() -> None:
    image = with_person(5, 16, 32)
    whole = Detector(own_net([0.0, 0.0, 4.0, 8.0] + [0.0] * (len(CHANNELS) - 4)), score=0.0)
    names = {**OWN, "channels": "plain red, blue"}
    part = Detector(own_net([8.0, 4.0], metadata=names), score=0.0)
    for one, other in zip(part.detect(image).scores, whole.detect(image).scores, strict=True):
        assert one == pytest.approx(other, abs=1e-6)
    with pytest.raises(ValueError, match=r"expected channels among red, .* got 'infrared'"):
        Detector(own_net([1.0], metadata={**OWN, "channels": "infrared"}))


def test_input_is_what_training_prepares() -> None:
    """The mean of a channel over a cell, read back from the score, is that of network_input."""
    image, rays = with_person(5, 16, 32), np.full((160, 200), 12.0, np.float32)
    for number in range(len(CHANNELS)):
        weights = [0.0] * len(CHANNELS)
        weights[number] = 1.0
        detector = Detector(own_net(weights), score=0.0, iou=1.0)
        found = detector.detect(image, footprint=rays, rarity=rays / 100.0, plain=image[::-1])
        planes = network_input(image, rays, rays / 100.0, image[::-1])
        logits = np.log(found.scores / (1.0 - found.scores))
        for box, logit in zip(found.boxes_xyxy, logits, strict=True):
            x0, y0 = np.rint(box[:2] + 0.5).astype(int)
            cell = planes[number, y0 : y0 + 16, x0 : x0 + 16]
            expected = cell.sum() / 256.0  # zeros beyond the border
            assert logit == pytest.approx(expected, abs=1e-4)
