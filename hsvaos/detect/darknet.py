"""Darknet networks (YOLOv3, YOLOv4 and their tiny forms) as ONNX.

    python -m hsvaos.detect.darknet yolov4-tiny.cfg yolov4-tiny.weights out.onnx --names coco.names

The network that comes out takes (B, 3, H, W), RGB from 0 to 1, scaled to the size in the cfg, and
gives boxes (B, N, 1, 4), corners as shares of width and height, and confs (B, N, classes).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from hsvaos.detect.darknet_files import Weights, read_cfg
from hsvaos.detect.darknet_layers import Converter

_OPSET, _IR_VERSION = 13, 8


def convert_darknet(
    cfg: str | Path, weights: str | Path, out: str | Path, names: str | Path | None = None
) -> None:
    """Write a Darknet network as ONNX, in the layout "yolov4" of `hsvaos.Detector`.

    Args:
        cfg: The network as text, with layers convolutional, dropout, maxpool, route, upsample,
            shortcut and yolo.
        weights: Its numbers.
        out: ONNX file to write.
        names: Names of the classes, one a line; they go into the metadata.

    Raises:
        ValueError: If a file is not what it should be, a layer is not supported, cfg and weights
            do not belong together, or the package onnx is missing.
        OSError: If the file cannot be written.
    """
    try:
        import onnx
        from onnx import TensorProto, helper
    except ImportError:
        raise ValueError("this needs the package onnx: pip install 'hsvaos[train]'") from None
    numbers = Weights(weights)
    net = Converter(read_cfg(cfg), numbers)
    numbers.check_end()
    classes = {head[2] for head in net.heads}
    if len(classes) != 1:
        raise ValueError(f"{cfg}: its [yolo] layers tell apart {sorted(classes)} classes")
    net.graph.node("Concat", *[head[0] for head in net.heads], name="boxes", axis=1)
    net.graph.node("Concat", *[head[1] for head in net.heads], name="confs", axis=1)

    def port(name: str, *sizes: Any) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *sizes])

    count = classes.pop()
    graph = helper.make_graph(
        net.graph.nodes,
        "darknet",
        [port("images", net.channels, *net.size)],
        [port("boxes", None, 1, 4), port("confs", None, count)],
        net.graph.constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)])
    model.ir_version = _IR_VERSION
    if names is not None:
        helper.set_model_props(model, {"names": repr(_class_names(Path(names), count))})
    onnx.checker.check_model(model)
    Path(out).write_bytes(model.SerializeToString())


def _class_names(path: Path, count: int) -> dict[int, str]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected a name a line, got: {error}") from None
    listed = [line.strip() for line in lines if line.strip()]
    if len(listed) != count:
        raise ValueError(f"{path}: expected {count} names, got {len(listed)}")
    return dict(enumerate(listed))


def main(
    cfg: Path,
    weights: Path,
    out: Path,
    names: Annotated[Path | None, typer.Option(help="Names of the classes, one a line.")] = None,
) -> None:
    """Write a Darknet network as ONNX."""
    try:
        convert_darknet(cfg, weights, out, names)
    except (ValueError, OSError) as error:
        sys.stderr.write(f"error: {error}\n")
        raise typer.Exit(2) from None


if __name__ == "__main__":
    typer.run(main)
