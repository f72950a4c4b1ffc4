"""Tiny ONNX networks of each layout: a box a grid cell that is red, or blue for another class."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from hsvaos.detect.network_input import CHANNELS
from hsvaos.detect.second_look import LOOK_PX, SECOND_CHANNELS

SIDE = 96
"""Side of the input of networks of a fixed size [px]."""


class Net:
    """A graph under construction; every method adds a node and returns the name of its output."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def const(self, value: object, dtype: type = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype), name))
        return name

    def node(self, kind: str, *inputs: str, **attributes: object) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def named(self, value: str, name: str) -> str:
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        return name

    def shares(self, picture: str, stride: int, weights: list[float], bias: float) -> str:
        """(B, 1, h, w): weighted mean of the channels over each cell, plus a bias."""
        kernel = np.tile(np.reshape(weights, (1, -1, 1, 1)), (1, 1, stride, stride)) / stride**2
        return self.node(
            "Conv", picture, self.const(kernel), self.const([bias]), strides=[stride, stride]
        )

    def flat(self, value: str) -> str:
        return self.node("Reshape", value, self.const([0, 1, -1], np.int64))

    def cells(
        self, picture: str, strides: tuple[int, ...], *mixes: tuple[list[float], float]
    ) -> tuple[list[str], list[str]]:
        """(B, 1, N) each: left, top, right, bottom of every cell; and one mean for every mix."""
        parts: list[list[str]] = []
        for stride in strides:
            means = [self.shares(picture, stride, *mix) for mix in mixes]
            steps = self.node("Mul", means[0], self.const(0.0))
            steps = self.node("Add", steps, self.const(float(stride)))
            right = self.node("CumSum", steps, self.const(3, np.int64))
            bottom = self.node("CumSum", steps, self.const(2, np.int64))
            left = self.node("Sub", right, steps)
            top = self.node("Sub", bottom, steps)
            parts.append([self.flat(v) for v in (left, top, right, bottom, *means)])
        joined = [self.node("Concat", *column, axis=2) for column in zip(*parts, strict=True)]
        return joined[:4], joined[4:]

    def centred(self, corners: list[str]) -> list[str]:
        left, top, right, bottom = corners
        half = self.const(0.5)
        return [
            self.node("Mul", self.node("Add", left, right), half),
            self.node("Mul", self.node("Add", top, bottom), half),
            self.node("Sub", right, left),
            self.node("Sub", bottom, top),
        ]

    def rows(self, *columns: str) -> str:
        """(B, N, K) of K columns (B, 1, N)."""
        return self.node("Transpose", self.node("Concat", *columns, axis=1), perm=[0, 2, 1])

    def zero(self, like: str, value: float = 0.0) -> str:
        return self.node("Add", self.node("Mul", like, self.const(0.0)), self.const(value))

    def model(
        self,
        inputs: dict[str, tuple[list[int | str], int]],
        outputs: dict[str, int],
        metadata: dict[str, str] | None = None,
        types: dict[str, int] | None = None,
    ) -> bytes:
        graph = helper.make_graph(
            self.nodes,
            "net",
            [helper.make_tensor_value_info(n, t, s) for n, (s, t) in inputs.items()],
            [
                helper.make_tensor_value_info(
                    n, (types or {}).get(n, TensorProto.FLOAT), [f"{n}{i}" for i in range(d)]
                )
                for n, d in outputs.items()
            ],
            self.constants,
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
        model.ir_version = 8
        helper.set_model_props(model, metadata or {})
        onnx.checker.check_model(model)
        return bytes(onnx.shape_inference.infer_shapes(model).SerializeToString())


def _score(net: Net, mean: str) -> str:
    """2 mean - 1, not below 0: grey borders score nothing."""
    twice = net.node("Sub", net.node("Mul", mean, net.const(2.0)), net.const(1.0))
    return net.node("Relu", twice)


def _classes(net: Net, person: str, other: str, count: int, at: int) -> list[str]:
    """Scores of all classes: people at `at`, another thing at the next one, else 0."""
    columns = [net.zero(person)] * count
    columns[at] = person
    if count > 1:
        columns[(at + 1) % count] = other
    return columns


def _shape(dynamic: bool, batch: int | str | None, channels: int = 3) -> list[int | str]:
    first = ("b" if dynamic else 1) if batch is None else batch
    return [first, channels, "h", "w"] if dynamic else [first, channels, SIDE, SIDE]


def photo_net(
    layout: str,
    *,
    dynamic: bool = False,
    batch: int | str | None = None,
    classes: int = 80,
    person: int = 0,
    metadata: dict[str, str] | None = None,
    strides: tuple[int, ...] = (8, 16, 32),
    half: bool = False,
) -> bytes:
    """A network of a layout that takes photos; people are red, another class is blue."""
    net = Net()
    red, blue = ([1.0, 0.0, 0.0], 0.0), ([0.0, 0.0, 1.0], 0.0)
    if layout == "yolox":  # blue, green, red; 0 to 255
        red, blue = ([0.0, 0.0, 1.0 / 255.0], 0.0), ([1.0 / 255.0, 0.0, 0.0], 0.0)
    if layout == "rfdetr":
        red, blue = ([0.229, 0.0, 0.0], 0.485), ([0.0, 0.0, 0.225], 0.406)
    picture = "images"
    if half:
        picture = net.node("Cast", picture, to=TensorProto.FLOAT)
    corners, means = net.cells(picture, strides, red, blue)
    people, others = (_score(net, mean) for mean in means)
    scores = _classes(net, people, others, classes, person)
    one = net.zero(people, 1.0)
    inputs = {
        "images": (_shape(dynamic, batch), TensorProto.FLOAT16 if half else TensorProto.FLOAT)
    }
    share = net.const(1.0 / SIDE)
    if layout == "yolov8":
        joined = net.node("Concat", *net.centred(corners), *scores, axis=1)
        net.named(joined, "output0")
        return net.model(inputs, {"output0": 3}, metadata)
    if layout == "yolov5":
        rows = net.rows(*net.centred(corners), one, *scores)
        net.named(net.node("Concat", rows, rows, rows, axis=1), "output0")
        return net.model(inputs, {"output0": 3}, metadata)
    if layout == "yolox":
        middle, log1 = net.zero(people, 0.5), net.zero(people)
        net.named(net.rows(middle, middle, log1, log1, one, *scores), "output")
        return net.model(inputs, {"output": 3}, metadata)
    if layout == "end2end":
        both = [net.node("Concat", c, c, axis=2) for c in corners]
        score = net.node("Concat", people, others, axis=2)
        label = net.node(
            "Concat", net.zero(people, person), net.zero(people, (person + 1) % classes), axis=2
        )
        net.named(net.rows(*both, score, label), "output0")
        return net.model(inputs, {"output0": 3}, metadata)
    if layout == "yolov4":
        boxes = net.node("Mul", net.rows(*corners), share)
        net.named(net.node("Unsqueeze", boxes, net.const([2], np.int64)), "boxes")
        net.named(net.rows(*scores), "confs")
        return net.model(inputs, {"boxes": 4, "confs": 3}, metadata)
    if layout == "rfdetr":
        net.named(net.node("Mul", net.rows(*net.centred(corners)), share), "dets")
        logits = net.node("Mul", net.rows(*scores), net.const(8.0))
        net.named(net.node("Sub", logits, net.const(4.0)), "labels")
        return net.model(inputs, {"dets": 3, "labels": 3}, metadata)
    if layout == "dfine":
        sizes = net.node("Cast", "orig_target_sizes", to=TensorProto.FLOAT)
        sizes = net.node("Concat", sizes, sizes, axis=1)
        sizes = net.node("Unsqueeze", sizes, net.const([1], np.int64))
        boxes = net.node("Mul", net.node("Mul", net.rows(*corners), share), sizes)
        net.named(boxes, "boxes")
        flat = net.const([0, -1], np.int64)
        net.named(net.node("Reshape", people, flat), "scores")
        labels = net.node("Reshape", net.zero(people, float(person)), flat)
        net.named(net.node("Cast", labels, to=TensorProto.INT64), "labels")
        inputs["orig_target_sizes"] = ([inputs["images"][0][0], 2], TensorProto.INT64)
        outputs = {"labels": 2, "boxes": 3, "scores": 2}
        return net.model(inputs, outputs, metadata, {"labels": TensorProto.INT64})
    raise ValueError(layout)


OWN = {"layout": "hsvaos", "names": "{0: 'person'}", "stride": "16", "score_threshold": "0.4"}
"""Metadata of our own networks."""


def own_net(
    weights: list[float],
    bias: float = 0.0,
    *,
    dynamic: bool = True,
    metadata: dict[str, str] | None = None,
    batch: int | str | None = None,
) -> bytes:
    """A network of our own layout: cells of 16 px, scored by the sigmoid of their mean.

    Channels without a weight do not count.
    """
    told = OWN if metadata is None else metadata
    channels = len(told["channels"].split(",")) if "channels" in told else len(CHANNELS)
    weights = weights + [0.0] * (channels - len(weights))
    net = Net()
    corners, (mean,) = net.cells("input", (16,), (weights, bias))
    net.named(net.node("Sub", net.rows(*corners), net.const(0.5)), "boxes")
    score = net.node("Reshape", net.node("Sigmoid", mean), net.const([0, -1], np.int64))
    net.named(score, "scores")
    inputs = {"input": (_shape(dynamic, batch, channels), TensorProto.FLOAT)}
    return net.model(inputs, {"boxes": 3, "scores": 2}, told)


def second_net(
    channel: str,
    gain: float,
    shifts: tuple[float, float, float, float],
    bias: float = 0.0,
    **metadata: str,
) -> bytes:
    """A network of the second look: the logit it is told, plus the mean of a channel; fixed shifts.

    A bias is added to the logit.
    """
    net = Net()
    weights = np.zeros((len(SECOND_CHANNELS) + 1, 1))
    weights[SECOND_CHANNELS.index(channel)] = gain
    means = net.node("ReduceMean", "input", axes=[2, 3], keepdims=0)
    told = net.node("Slice", "facts", *(net.const([n], np.int64) for n in (0, 1, 1)))
    logit = net.node("Add", told, net.node("MatMul", means, net.const(weights)))
    score = net.node("Sigmoid", net.node("Add", logit, net.const(bias)))
    net.named(net.node("Reshape", score, net.const([-1], np.int64)), "scores")
    nothing = net.node("Mul", told, net.const(0.0))
    net.named(net.node("Add", nothing, net.const([shifts])), "shifts")
    inputs = {
        "input": (["b", len(SECOND_CHANNELS) + 1, LOOK_PX, LOOK_PX], TensorProto.FLOAT),
        "facts": (["b", 3], TensorProto.FLOAT),
    }
    outputs = {"scores": 1, "shifts": 2}
    return net.model(inputs, outputs, {"channels": ",".join(SECOND_CHANNELS), **metadata})
