"""Darknet networks as ONNX against an independent forward pass in NumPy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest

from hsvaos import Detector
from hsvaos.detect.darknet import convert_darknet

TINY = """
[net]
# as in yolov4-tiny, but small
batch=1
width=64
height=32
channels=3

[convolutional]
batch_normalize=1
filters=8
size=3
stride=2
pad=1
activation=leaky

[convolutional]
batch_normalize=1
filters=8
size=3
stride=1
pad=1
activation=mish

[route]
layers=-1
groups=2
group_id=1

[convolutional]
filters=4
size=3
stride=1
pad=1
groups=2
activation=swish

[route]
layers = -1,-3

[maxpool]
size=2
stride=2

[convolutional]
batch_normalize=1
filters=6
size=1
activation=relu

[convolutional]
filters=6
size=3
pad=1
activation=logistic

[shortcut]
from=-2
activation=linear

[maxpool]
size=3
stride=1

[maxpool]
size=2
stride=1

[dropout]
probability=.15

[convolutional]
filters=14
size=1
stride=1
activation=linear

[yolo]
mask = 3,4
anchors = 10,14, 23,27, 37,58, 8,9, 5,30
classes=2
num=5
scale_x_y = 1.05

[route]
layers = 10

[upsample]
stride=2

[route]
layers = -1, 4

[convolutional]
size=1
stride=1
filters=21
activation=LAST

[yolo]
mask = 0,1,2
anchors = 10,14, 23,27, 37,58, 8,9, 5,30
classes=2
num=5
NEW
"""


def sections(text: str) -> list[tuple[str, dict[str, str]]]:
    found: list[tuple[str, dict[str, str]]] = []
    for line in text.splitlines():
        line = line.split("#")[0].strip()
        if line.startswith("["):
            found.append((line[1:-1], {}))
        elif line:
            key, value = line.split("=")
            found[-1][1][key.strip()] = value.strip()
    return found


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-x))


ACTIVATIONS = {
    "linear": lambda x: x,
    "leaky": lambda x: np.where(x > 0, x, 0.1 * x),
    "relu": lambda x: np.maximum(x, 0),
    "logistic": sigmoid,
    "swish": lambda x: x * sigmoid(x),
    "mish": lambda x: x * np.tanh(np.log1p(np.exp(x))),
}


def windows_of(x: np.ndarray, size: int, stride: int) -> np.ndarray:
    view = np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))
    return view[:, ::stride, ::stride]


class Darknet:
    """Draws random weights of a cfg, and runs one picture (3, H, W) through it in float64."""

    def __init__(self, text: str, seed: int) -> None:
        self.layers = sections(text)
        self.rng = np.random.default_rng(seed)
        self.stored: list[np.ndarray] = []
        self.drawn: dict[int, tuple[np.ndarray, ...]] = {}

    def draw(self, *shape: int, low: float = -0.6, high: float = 0.6) -> np.ndarray:
        values = self.rng.uniform(low, high, shape).astype(np.float32)
        self.stored.append(values)
        return values.astype(np.float64)

    def convolution(self, i: int, x: np.ndarray, v: dict[str, str]) -> np.ndarray:
        n, size, stride = int(v["filters"]), int(v["size"]), int(v.get("stride", 1))
        groups = int(v.get("groups", 1))
        share = x.shape[0] // groups
        normalised = v.get("batch_normalize") == "1"
        if i not in self.drawn:
            bias = self.draw(n)
            norm = (self.draw(n), self.draw(n), self.draw(n, low=0.2)) if normalised else ()
            self.drawn[i] = (bias, *norm, self.draw(n, share, size, size))
        bias, *norm, kernel = self.drawn[i]
        pad = size // 2 if v.get("pad") == "1" else 0
        x = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
        parts = []
        for g in range(groups):
            patches = windows_of(x[g * share : (g + 1) * share], size, stride)
            own = kernel[g * n // groups : (g + 1) * n // groups]
            parts.append(np.einsum("chwij,ncij->nhw", patches, own))
        y = np.concatenate(parts)
        if normalised:
            scale, mean, variance = (part[:, None, None] for part in norm)
            y = scale * (y - mean) / np.sqrt(variance + 1e-5)
        return ACTIVATIONS[v["activation"]](y + bias[:, None, None])

    def run(self, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        _, net = self.layers[0]
        x = picture.astype(np.float64)
        outputs: list[np.ndarray] = []
        boxes, scores = [], []
        for i, (kind, v) in enumerate(self.layers[1:]):
            if kind == "convolutional":
                x = self.convolution(i, x, v)
            elif kind == "maxpool":
                size, stride = int(v["size"]), int(v["stride"])
                before = (size - 1) // 2
                after = size - 1 - before
                edge = ((0, 0), (before, after), (before, after))
                x = windows_of(np.pad(x, edge, constant_values=-np.inf), size, stride)
                x = x.max(axis=(-2, -1))
            elif kind == "route":
                taken = [int(n) for n in v["layers"].split(",")]
                groups, group = int(v.get("groups", 1)), int(v.get("group_id", 0))
                parts = [outputs[n if n >= 0 else i + n] for n in taken]
                x = np.concatenate([np.split(part, groups)[group] for part in parts])
            elif kind == "upsample":
                x = x.repeat(2, axis=1).repeat(2, axis=2)
            elif kind == "shortcut":
                x = x + outputs[i + int(v["from"])]
            elif kind == "yolo":
                for box, score in head(x, v, int(net["width"]), int(net["height"])):
                    boxes.append(box)
                    scores.append(score)
            outputs.append(x)
        return np.array(boxes), np.array(scores)

    def write(
        self, folder: Path, text: str, version: tuple[int, int] = (0, 2)
    ) -> tuple[Path, Path]:
        cfg, weights = folder / "net.cfg", folder / "net.weights"
        cfg.write_text(text)
        seen = np.array([77], "<i8" if version >= (0, 2) else "<i4").tobytes()
        header = np.array([*version, 5], "<i4").tobytes() + seen
        weights.write_bytes(header + b"".join(v.astype("<f4").tobytes() for v in self.stored))
        return cfg, weights


def head(x: np.ndarray, v: dict[str, str], width: int, height: int):
    """Boxes and scores of a detection head, box by box, as Darknet's source has it."""
    anchors = [float(a) for a in v["anchors"].split(",")]
    classes = int(v["classes"])
    scale, fresh = float(v.get("scale_x_y", 1.0)), v.get("new_coords") == "1"
    for a, m in enumerate(int(m) for m in v["mask"].split(",")):
        block = x[a * (5 + classes) : (a + 1) * (5 + classes)]
        for row in range(x.shape[1]):
            for column in range(x.shape[2]):
                t = block[:, row, column]
                s = t if fresh else sigmoid(t)
                cx = (column + s[0] * scale - 0.5 * (scale - 1.0)) / x.shape[2]
                cy = (row + s[1] * scale - 0.5 * (scale - 1.0)) / x.shape[1]
                w, h = (4.0 * t[2:4] ** 2) if fresh else np.exp(t[2:4])
                w, h = w * anchors[2 * m] / width, h * anchors[2 * m + 1] / height
                yield [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2], s[4] * s[5:]


def text_of(fresh: bool) -> str:
    text = TINY.replace("LAST", "logistic" if fresh else "linear")
    return text.replace("NEW", "new_coords=1\nscale_x_y=2.0" if fresh else "")


@pytest.mark.parametrize("fresh", [False, True], ids=["exp", "new_coords"])
@pytest.mark.parametrize("version", [(0, 1), (0, 2), (1, 0)])
def test_onnx_equals_the_forward_pass(
    tmp_path: Path, fresh: bool, version: tuple[int, int]
) -> None:
    text = text_of(fresh)
    pictures = np.random.default_rng(5).uniform(0, 1, (3, 3, 32, 64)).astype(np.float32)
    net = Darknet(text, seed=8)
    expected = [net.run(picture) for picture in pictures]
    cfg, weights = net.write(tmp_path, text, version)
    convert_darknet(cfg, weights, tmp_path / "out.onnx")
    session = ort.InferenceSession(tmp_path / "out.onnx", providers=["CPUExecutionProvider"])
    boxes, confs = session.run(["boxes", "confs"], {"images": pictures})
    assert boxes.shape == (3, 8 * 16 * 2 + 16 * 32 * 3, 1, 4)
    for got, score, (wanted, strength) in zip(boxes, confs, expected, strict=True):
        np.testing.assert_allclose(got[:, 0], wanted, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(score, strength, rtol=1e-4, atol=1e-5)


def test_detector_takes_it(tmp_path: Path) -> None:
    text = text_of(False)
    net = Darknet(text, seed=8)
    net.run(np.zeros((3, 32, 64)))
    cfg, weights = net.write(tmp_path, text)
    names = tmp_path / "two.names"
    names.write_text("bicycle\nperson\n\n")
    out = tmp_path / "out.onnx"
    command = [sys.executable, "-m", "hsvaos.detect.darknet", str(cfg), str(weights), str(out)]
    done = subprocess.run(
        [*command, "--names", str(names)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    detector = Detector(out, score=0.0, iou=1.0, max_finds=10_000)
    assert (detector.layout, detector.people) == ("yolov4", (1,))
    picture = np.random.default_rng(1).integers(0, 256, (32, 64, 3)).astype(np.uint8)
    found = detector.detect(picture)
    boxes, scores = net.run(picture.transpose(2, 0, 1) / 255.0)
    order = np.argsort(-scores[:, 1])[:20]
    wanted = np.clip(boxes[order] * [64, 32, 64, 32], 0, [64, 32, 64, 32]) - 0.5
    np.testing.assert_allclose(found.boxes_xyxy[:20], wanted, atol=1e-3)
    np.testing.assert_allclose(found.scores[:20], scores[order, 1], rtol=1e-4)
    bad = subprocess.run([*command[:-1], "/nowhere/x.onnx"], capture_output=True, text=True)
    assert bad.returncode == 2
    assert bad.stderr.startswith("error: ")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[upsample]", "[crnn]", r"net.cfg:\d+: layer \[crnn\] is not supported"),
        ("activation=swish", "activation=gelu", "activation 'gelu' is not supported"),
        ("filters=14", "filters=15", "does not fit 15 channels"),
        ("filters=8\nsize=3\nstride=2", "size=3\nstride=2", r"\[convolutional\] has no filters"),
        ("size=3\nstride=2", "size=three\nstride=2", "size: expected numbers, got 'three'"),
        ("width=64", "width=64,32", "width: expected one number"),
        ("from=-2", "from=-4", "adds layers of different shapes"),
        ("from=-2", "from=-40", "layer -40 cannot be taken"),
        ("group_id=1", "group_id=2", "group_id below groups"),
        ("groups=2\nactivation=swish", "groups=3\nactivation=swish", "does not fit 4 channels"),
        ("[net]", "[conv]", "begins with \\[net\\]"),
        ("batch=1", "batch", "expected \\[section\\] or key=value"),
        ("layers = 10\n", "layers = 13\n", "layer 13 cannot be taken"),
        ("filters=6\nsize=1", "filters=7\nsize=1", "adds layers of different shapes"),
    ],
)
def test_cfg_mistakes(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = text_of(False)
    net = Darknet(text, seed=8)
    net.run(np.zeros((3, 32, 64)))
    net.draw(5000)  # enough for every change
    assert old in text
    cfg, weights = net.write(tmp_path, text.replace(old, new, 1))
    with pytest.raises(ValueError, match=message):
        convert_darknet(cfg, weights, tmp_path / "out.onnx")
    assert not (tmp_path / "out.onnx").exists()


def test_weights_of_another_cfg(tmp_path: Path) -> None:
    text = text_of(False)
    net = Darknet(text, seed=8)
    net.run(np.zeros((3, 32, 64)))
    cfg, weights = net.write(tmp_path, text)
    whole = weights.read_bytes()
    for content, message in (
        (whole[:-8], "too short for this cfg"),
        (whole + b"\0" * 12, "3 of .* numbers are left over"),
        (b"abc", "got 3 bytes"),
    ):
        weights.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            convert_darknet(cfg, weights, tmp_path / "out.onnx")
    weights.write_bytes(whole)
    names = tmp_path / "names"
    names.write_text("person")
    with pytest.raises(ValueError, match="expected 2 names, got 1"):
        convert_darknet(cfg, weights, tmp_path / "out.onnx", names)
    cfg.write_text(text.split("[yolo]")[0])
    with pytest.raises(ValueError, match="no \\[yolo\\] layer"):
        convert_darknet(cfg, weights, tmp_path / "out.onnx")
    with pytest.raises(ValueError, match="cannot be read"):
        convert_darknet(cfg, tmp_path / "gone", tmp_path / "out.onnx")
    with pytest.raises(ValueError, match="expected a Darknet cfg file"):
        convert_darknet(tmp_path / "gone", weights, tmp_path / "out.onnx")
