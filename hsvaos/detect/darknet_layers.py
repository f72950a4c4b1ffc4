"""Layers of Darknet networks as nodes of an ONNX graph."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hsvaos.detect.darknet_files import Section, Weights

_SLOPE = 0.1
"""Of Darknet's leaky rectifier below 0."""


@dataclass(frozen=True)
class _Layer:
    """What a layer gives.

    Args:
        name: Of its tensor; empty for a detection head, which nothing may follow.
        channels: Of it.
        height: Of it [px].
        width: Of it [px].
    """

    name: str
    channels: int = 0
    height: int = 0
    width: int = 0


class _Graph:
    """Nodes and constants of an ONNX graph under construction."""

    def __init__(self) -> None:
        from onnx import helper, numpy_helper

        self._helper, self._numpy_helper = helper, numpy_helper
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any, dtype: type = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(self._numpy_helper.from_array(np.asarray(value, dtype), name))
        return name

    def node(self, kind: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        name = name or f"n{len(self.nodes)}"
        self.nodes.append(self._helper.make_node(kind, list(inputs), [name], **attributes))
        return name


class Converter:
    """Turns sections into nodes, one after the other.

    Attributes:
        graph: Nodes and constants; its input is called "images".
        size: Height and width of the input [px].
        channels: Of the input.
        heads: Names of boxes (B, N, 1, 4) and confs (B, N, classes) of each [yolo], and how many
            classes there are.

    Args:
        sections: Of the .cfg file.
        weights: Of the .weights file.

    Raises:
        ValueError: If a layer is not supported or does not fit, or the weights are too few.
    """

    def __init__(self, sections: list[Section], weights: Weights) -> None:
        net = sections[0]
        self.graph = _Graph()
        self.weights = weights
        self.size = net.number("height"), net.number("width")
        self.channels = net.number("channels", 3)
        self.layers: list[_Layer] = []
        self.heads: list[tuple[str, str, int]] = []
        kinds: dict[str, Callable[[Section, _Layer], _Layer]] = {
            "convolutional": self._convolutional,
            "dropout": self._dropout,
            "maxpool": self._maxpool,
            "route": self._route,
            "upsample": self._upsample,
            "shortcut": self._shortcut,
            "yolo": self._yolo,
        }
        last = _Layer("images", self.channels, *self.size)
        for section in sections[1:]:
            if section.kind not in kinds:
                raise ValueError(
                    f"{section.where}: layer [{section.kind}] is not supported; known are "
                    f"{', '.join(kinds)}"
                )
            if not last.name and section.kind != "route":
                raise ValueError(f"{section.where}: only a [route] can follow a [yolo]")
            last = kinds[section.kind](section, last)
            if last.name and min(last.channels, last.height, last.width) < 1:
                raise ValueError(f"{section.where}: [{section.kind}] leaves nothing of the picture")
            self.layers.append(last)
        if not self.heads:
            raise ValueError(f"{net.where}: the network has no [yolo] layer")

    def _convolutional(self, section: Section, last: _Layer) -> _Layer:
        filters, size = section.number("filters"), section.number("size")
        stride, groups = section.number("stride", 1), section.number("groups", 1)
        pad = size // 2 if section.number("pad", 0) else section.number("padding", 0)
        for key in ("dilation", "antialiasing", "binary", "xnor"):
            if section.number(key, 0) > (key == "dilation"):
                raise ValueError(f"{section.where}: [convolutional] {key} is not supported")
        if min(filters, size, stride, groups) < 1 or last.channels % groups or filters % groups:
            raise ValueError(
                f"{section.where}: [convolutional] of {filters} filters of {size} px in {groups} "
                f"groups every {stride} px does not fit {last.channels} channels"
            )
        kernel, bias = self.weights.convolution(
            filters,
            last.channels // groups,
            size,
            section.number("batch_normalize", 0) > 0,
        )
        name = self.graph.node(
            "Conv",
            last.name,
            self.graph.constant(kernel),
            self.graph.constant(bias),
            strides=[stride, stride],
            pads=[pad] * 4,
            group=groups,
        )
        height, width = ((s + 2 * pad - size) // stride + 1 for s in (last.height, last.width))
        return _Layer(self._activated(name, section), filters, height, width)

    def _activated(self, name: str, section: Section) -> str:
        node = self.graph.node
        kind = section.values.get("activation", "linear")
        if kind == "linear":
            return name
        if kind == "leaky":
            return node("LeakyRelu", name, alpha=_SLOPE)
        if kind == "relu":
            return node("Relu", name)
        if kind == "logistic":
            return node("Sigmoid", name)
        if kind == "swish":
            return node("Mul", name, node("Sigmoid", name))
        if kind == "mish":
            return node("Mul", name, node("Tanh", node("Softplus", name)))
        raise ValueError(f"{section.where}: activation {kind!r} is not supported")

    def _maxpool(self, section: Section, last: _Layer) -> _Layer:
        stride = section.number("stride", 1)
        size = section.number("size", stride)
        pad = section.number("padding", size - 1)
        before, after = pad // 2, pad - pad // 2
        name = self.graph.node(
            "MaxPool",
            last.name,
            kernel_shape=[size, size],
            strides=[stride, stride],
            pads=[before, before, after, after],
        )
        height, width = ((s + pad - size) // stride + 1 for s in (last.height, last.width))
        return _Layer(name, last.channels, height, width)

    def _dropout(self, section: Section, last: _Layer) -> _Layer:
        """Only training drops anything."""
        return last

    def _route(self, section: Section, last: _Layer) -> _Layer:
        sources = [self._earlier(section, int(value)) for value in section.numbers("layers")]
        groups, group = section.number("groups", 1), section.number("group_id", 0)
        if not sources or not 0 <= group < groups:
            raise ValueError(f"{section.where}: [route] needs layers, and group_id below groups")
        names = []
        for source in sources:
            if (source.height, source.width) != (sources[0].height, sources[0].width):
                raise ValueError(f"{section.where}: [route] joins layers of different sizes")
            share, rest = divmod(source.channels, groups)
            if rest:
                raise ValueError(
                    f"{section.where}: [route] {source.channels} channels in {groups} groups"
                )
            names.append(source.name if groups == 1 else self._part(source, share * group, share))
        name = names[0] if len(names) == 1 else self.graph.node("Concat", *names, axis=1)
        channels = sum(source.channels // groups for source in sources)
        return _Layer(name, channels, sources[0].height, sources[0].width)

    def _part(self, source: _Layer, first: int, count: int) -> str:
        bounds = [self.graph.constant([v], np.int64) for v in (first, first + count, 1)]
        return self.graph.node("Slice", source.name, *bounds)

    def _earlier(self, section: Section, number: int) -> _Layer:
        """The layer of that number, counted back from here if negative."""
        index = number if number >= 0 else len(self.layers) + number
        if not 0 <= index < len(self.layers) or not self.layers[index].name:
            raise ValueError(f"{section.where}: [{section.kind}] layer {number} cannot be taken")
        return self.layers[index]

    def _upsample(self, section: Section, last: _Layer) -> _Layer:
        factor = section.number("stride", 2)
        name = self.graph.node(
            "Resize",
            last.name,
            "",
            self.graph.constant([1, 1, factor, factor]),
            mode="nearest",
            coordinate_transformation_mode="asymmetric",
            nearest_mode="floor",
        )
        return _Layer(name, last.channels, last.height * factor, last.width * factor)

    def _shortcut(self, section: Section, last: _Layer) -> _Layer:
        other = self._earlier(section, section.number("from"))
        if (other.channels, other.height, other.width) != (last.channels, last.height, last.width):
            raise ValueError(f"{section.where}: [shortcut] adds layers of different shapes")
        name = self.graph.node("Add", last.name, other.name)
        return _Layer(self._activated(name, section), last.channels, last.height, last.width)

    def _yolo(self, section: Section, last: _Layer) -> _Layer:
        """Boxes and scores of a head: a box an anchor and cell, anchors first, then rows."""
        classes = section.number("classes")
        anchors = np.reshape(section.numbers("anchors"), (-1, 2))
        mask = [int(value) for value in section.numbers("mask", list(range(len(anchors))))]
        if not mask or max(mask) >= len(anchors) or last.channels != len(mask) * (5 + classes):
            raise ValueError(
                f"{section.where}: [yolo] of {len(mask)} anchors and {classes} classes does not "
                f"fit {last.channels} channels"
            )
        node, const = self.graph.node, self.graph.constant
        count, cells = len(mask), last.height * last.width
        shape = const([-1, count, 5 + classes, cells], np.int64)
        whole = node("Reshape", last.name, shape)

        def part(first: int, end: int) -> str:
            bounds = (const([value], np.int64) for value in (first, end, 2))
            return node("Slice", whole, *bounds)

        plain = section.number("new_coords", 0) > 0  # then the last layer is logistic already
        (stretch,) = section.numbers("scale_x_y", [1])
        squash = (lambda name: name) if plain else (lambda name: node("Sigmoid", name))
        rows, columns = np.mgrid[0 : last.height, 0 : last.width].reshape(2, 1, 1, 1, cells)
        corner = np.concatenate([columns, rows], axis=2) - 0.5 * (stretch - 1.0)
        moved = node("Mul", squash(part(0, 2)), const(stretch))
        grid = const(np.reshape([last.width, last.height], (1, 1, 2, 1)))
        middle = node("Div", node("Add", moved, const(corner)), grid)
        sizes = anchors[mask] / (self.size[1], self.size[0])
        if plain:
            twice = node("Mul", part(2, 4), const(2.0))
            sides = node("Mul", twice, twice)
        else:
            sides = node("Exp", part(2, 4))
        half = node("Mul", sides, const(0.5 * sizes.reshape(1, count, 2, 1)))
        corners = node("Concat", node("Sub", middle, half), node("Add", middle, half), axis=2)
        scores = node("Mul", squash(part(4, 5)), squash(part(5, 5 + classes)))
        boxes, confs = (
            node("Reshape", node("Transpose", value, perm=[0, 1, 3, 2]), const(shape, np.int64))
            for value, shape in ((corners, [0, -1, 1, 4]), (scores, [0, -1, classes]))
        )
        self.heads.append((boxes, confs, classes))
        return _Layer("")
