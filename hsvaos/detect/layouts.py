"""The layouts of detection networks: what goes in, what comes out, and how they are told apart."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hsvaos.detect import decode
from hsvaos.detect.classes import class_names
from hsvaos.detect.grey_input import GREY_CHANNELS
from hsvaos.detect.network import Network
from hsvaos.detect.network_input import CHANNELS

Shapes = dict[str, tuple[int | None, ...]]

_MOST_END2END = 300
_PROBE_PX = 320
"""Side of the picture with which free sizes are tried out: 2100 cells, unlike 300 boxes."""

_IMAGENET_MEAN, _IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class Layout:
    """How pictures go into networks of a family, and how boxes come out.

    Args:
        name: Its name.
        decode: Gives boxes and scores from the outputs.
        fit: "centre" and "corner": scaled alike in both directions, with a grey border around or
            to the right and below; "stretch": scaled to the size of the input; "pad": not scaled,
            zeros to the right and below.
        bgr: Whether blue is the first channel.
        peak: Value of white.
        mean: Of each channel, taken away at a white of 1.
        std: Of each channel, divided by.
        needs_nms: Whether boxes of one object must be merged.
        iou: Overlap from which two boxes are one, by default. People who lie in a forest seldom
            overlap, and half hidden their boxes are uncertain: our own networks merge early.
        score: Score from which a box counts, by default.
    """

    name: str
    decode: decode.Decoder
    fit: str
    bgr: bool = False
    peak: float = 1.0
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    needs_nms: bool = True
    iou: float = 0.45
    score: float = 0.25


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout("hsvaos", decode.hsvaos, "pad", iou=0.25, score=0.5),
        Layout("yolov8", decode.yolov8, "centre"),
        Layout("yolov5", decode.yolov5, "centre"),
        Layout("end2end", decode.end2end, "centre", needs_nms=False),
        Layout("yolox", decode.yolox, "corner", bgr=True, peak=255.0),
        Layout("yolov4", decode.yolov4, "stretch"),
        Layout(
            "rfdetr",
            decode.rfdetr,
            "stretch",
            mean=_IMAGENET_MEAN,
            std=_IMAGENET_STD,
            needs_nms=False,
            score=0.5,
        ),
        Layout("dfine", decode.dfine, "stretch", needs_nms=False, score=0.5),
    )
}
"""Layouts by name."""

ALIASES = {
    "yolov11": "yolov8",
    "yolo11": "yolov8",
    "yolov7": "yolov5",
    "yolov10": "end2end",
    "darknet": "yolov4",
    "yolov4-tiny": "yolov4",
    "rf-detr": "rfdetr",
    "d-fine": "dfine",
}


def layout_of(network: Network, asked: str) -> tuple[Layout, Shapes]:
    """Return the layout of a network: as asked, else by metadata, output names, then shape.

    Args:
        network: The network.
        asked: A name in `LAYOUTS` or `ALIASES`, or "auto".

    Returns:
        The layout, and the shapes of the outputs as far as they are known.

    Raises:
        ValueError: If there is no such layout, the network does not have it, or none or several
            would fit.
    """
    name = ALIASES.get(asked.lower(), asked.lower())
    if name != "auto" and name not in LAYOUTS:
        raise ValueError(f"layout must be auto or one of {', '.join(LAYOUTS)}, got {asked!r}")
    shapes: Shapes = {port.name: port.shape for port in network.outputs}
    channels = network.picture.shape[1]
    if name == "auto":
        name = _by_metadata(network) or _by_names(network, channels) or ""
    if name not in ("", "hsvaos") and channels not in (3, None):
        raise ValueError(f"{network.name}: expected 3 input channels (RGB), got {channels}")
    if _needs_shapes(name, shapes):
        shapes = _probed(network)
    if name == "":
        name = _by_shape(network, shapes)
    layout = LAYOUTS[name]
    _check(network, layout, shapes)
    return layout, shapes


def own_channels(network: Network) -> tuple[str, ...]:
    """Return the names of the channels that a network of our own takes, in its order.

    Its metadata name them, so that a network goes on working when later ones are shown more. All
    are channels of `network_input`, or all of `grey_input`.

    Args:
        network: The network.

    Raises:
        ValueError: If it names a channel that there is not.
    """
    told = network.metadata.get("channels")
    if told is None:
        return CHANNELS
    names = tuple(name.strip() for name in told.split(","))
    known = GREY_CHANNELS if names[0] in GREY_CHANNELS else CHANNELS
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(
            f"{network.name}: expected channels among {', '.join(known)} in the metadata, got "
            f"{unknown[0]!r}"
        )
    return names


def class_count(layout: Layout, shapes: Shapes) -> int | None:
    """Return how many classes the outputs tell apart, or None where they do not show it."""
    if layout.name == "hsvaos":
        return 1
    if layout.name in ("yolov4", "rfdetr"):
        return shapes["confs" if layout.name == "yolov4" else "labels"][-1]
    last = _box_shape(shapes)
    if layout.name == "yolov8":
        return None if last[1] is None else last[1] - 4
    if layout.name in ("yolov5", "yolox"):
        return None if last[2] is None else last[2] - 5
    return None


def _by_metadata(network: Network) -> str | None:
    told = network.metadata.get("layout")
    if told in LAYOUTS:
        return told
    task = network.metadata.get("task", "detect")
    if task != "detect":
        raise ValueError(f"{network.name}: expected a detection network, got one for {task!r}")
    if network.metadata.get("end2end", "").lower() == "true":
        return "end2end"
    return None


def _by_names(network: Network, channels: int | None) -> str | None:
    names = {port.name for port in network.outputs}
    asks_sizes = any(port.name == "orig_target_sizes" for port in network.inputs)
    if {"labels", "boxes", "scores"} <= names and asks_sizes:
        return "dfine"
    if {"dets", "labels"} <= names:
        return "rfdetr"
    if {"boxes", "confs"} <= names:
        return "yolov4"
    if {"boxes", "scores"} <= names and channels == len(CHANNELS):
        return "hsvaos"
    return None


def _by_shape(network: Network, shapes: Shapes) -> str:
    """Tell the families with a single output apart by what its sizes can mean."""
    _, a, b = (size or 0 for size in _box_shape(shapes, network.name))
    height, width = probe_size(network)
    grids = [decode.cells((height, width), strides) for strides in decode.STRIDES]
    fitting = []
    if a >= 5 and (a < b or b in grids):
        fitting.append("yolov8")
    if b == 6 and a <= _MOST_END2END:
        fitting.append("end2end")
    if b >= 6 and a in [3 * count for count in grids]:
        fitting.append("yolov5")
    if b >= 6 and a in grids:
        fitting.append("yolox")
    text = network.metadata.get("names")
    if text is not None and len(fitting) > 1:  # only then: a broken entry is reported later
        classes = len(class_names(text, network.name))
        sizes = {"yolov8": a - 4, "yolov5": b - 5, "yolox": b - 5, "end2end": classes}
        fitting = [name for name in fitting if sizes[name] == classes]
    if len(fitting) != 1:
        meaning = f"may be {' or '.join(fitting)}" if fitting else "fits no known layout"
        raise ValueError(
            f"{network.name}: its output (1, {a}, {b}) {meaning}; say layout= "
            f"(one of {', '.join(LAYOUTS)})"
        )
    return fitting[0]


def _box_shape(shapes: Mapping[str, tuple[int | None, ...]], where: str = "") -> Any:
    found = next((shape for shape in shapes.values() if len(shape) == 3), None)
    if found is None:
        listed = ", ".join(f"{name} {list(shape)}" for name, shape in shapes.items())
        raise ValueError(
            f"{where}: its outputs ({listed}) fit no known layout; expected one of "
            f"{', '.join(LAYOUTS)}"
        )
    return found


def _needs_shapes(name: str, shapes: Shapes) -> bool:
    """Whether sizes that decide are left free by the network."""
    if name in ("hsvaos", "dfine", "end2end"):
        return False
    free = [None in shape[1:] for shape in shapes.values() if name == "" or len(shape) >= 3]
    return any(free)


def probe_size(network: Network) -> tuple[int, int]:
    """Return height and width that a network takes, or some that it should where it takes any."""
    height, width = network.picture.shape[2:]
    return height or _PROBE_PX, width or _PROBE_PX


def _probed(network: Network) -> Shapes:
    """Shapes of the outputs for an empty picture; they tell layouts apart."""
    picture = network.picture
    batch, channels = picture.shape[0] or 1, picture.shape[1] or 3
    feeds: dict[str, Any] = {
        picture.name: np.zeros((batch, channels, *probe_size(network)), np.float32)
    }
    if len(feeds) != len(network.inputs):
        raise ValueError(
            f"{network.name}: inputs {', '.join(port.name for port in network.inputs)} fit no "
            f"known layout; expected one input, or images and orig_target_sizes"
        )
    return {name: value.shape for name, value in network.run(feeds).items()}


_NAMED: dict[str, dict[str, int]] = {
    "hsvaos": {"boxes": 3, "scores": 2},
    "yolov4": {"boxes": 4, "confs": 3},
    "rfdetr": {"dets": 3, "labels": 3},
    "dfine": {"boxes": 3, "scores": 2, "labels": 2},
}
"""Outputs that layouts have by name, with their dimensions."""


def _check(network: Network, layout: Layout, shapes: Shapes) -> None:
    """Refuse a layout that the network does not have."""
    expected = _NAMED.get(layout.name)
    got = ", ".join(f"{name} {list(shape)}" for name, shape in shapes.items())
    if expected is not None:
        fits = all(len(shapes.get(name, ())) == count for name, count in expected.items())
        wanted = " and ".join(f"{name} of {n} dimensions" for name, n in expected.items())
    else:
        last = _box_shape(shapes, network.name)
        axis, least = (1, 5) if layout.name == "yolov8" else (2, 6)
        fits = last[axis] is None or last[axis] >= least
        fits &= layout.name != "end2end" or last[2] in (6, None)
        wanted = f"at least {least} values a box"
    if layout.name == "dfine":
        fits &= any(port.name == "orig_target_sizes" for port in network.inputs)
    elif len(network.inputs) != 1:
        fits = False
    channels = len(own_channels(network)) if layout.name == "hsvaos" else 3
    if network.picture.shape[1] not in (channels, None):
        fits, wanted = False, f"{channels} input channels"
        got = f"{network.picture.shape[1]}"
    if not fits:
        raise ValueError(f"{network.name}: layout {layout.name} expects {wanted}, got {got}")


def input_size(network: Network, asked: int | None) -> tuple[int, int]:
    """Return height and width of the pictures for a network whose layout scales them.

    Args:
        network: The network.
        asked: Side that the user asks for, where the network takes any.

    Raises:
        ValueError: If the network takes one size only and another one is asked for.
    """
    height, width = network.picture.shape[2:]
    if height is not None and width is not None:
        if asked is not None and (asked, asked) != (height, width):
            raise ValueError(
                f"{network.name}: takes pictures of {width} x {height} px only, asked for {asked}"
            )
        return height, width
    side = asked or _trained_size(network) or 640
    return height or side, width or side


def _trained_size(network: Network) -> int | None:
    """Side of the pictures that Ultralytics' metadata tell."""
    try:
        sizes = ast.literal_eval(network.metadata.get("imgsz", ""))
        return max(int(size) for size in (sizes if isinstance(sizes, list | tuple) else [sizes]))
    except (ValueError, SyntaxError, TypeError):
        return None
