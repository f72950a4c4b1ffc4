"""The trained network as ONNX, with what a detector must know of it."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from hsvaos.detect.network_input import AIM_GSD_M, CHANNELS, TRAINED_GSD_M
from train.net import MULTIPLE, Exported, PersonNet

_OPSET = 17


def export(
    net: PersonNet,
    path: Path,
    score_threshold: float,
    story: dict[str, object],
    channels: Sequence[str] = CHANNELS,
    gsd_m: tuple[float, float] = TRAINED_GSD_M,
    aim_gsd_m: float = AIM_GSD_M,
) -> None:
    """Write the network as ONNX of dynamic batch and size.

    Args:
        net: The trained network.
        path: The file.
        score_threshold: Default threshold.
        story: How it was trained; kept in the metadata.
        channels: Names of its input channels.
        gsd_m: Ground sampling distances that need no resampling [m/px].
        aim_gsd_m: The one to which others are resampled [m/px].
    """
    whole = Exported(net).eval()
    low, high = gsd_m
    facts = {
        "layout": "hsvaos",
        "names": "{0: 'person'}",
        "stride": str(MULTIPLE),
        "channels": ",".join(channels),
        "score_threshold": f"{score_threshold:.3f}",
        "gsd_m": f"{low},{high}",
        "aim_gsd_m": f"{aim_gsd_m}",
        "license": "Apache-2.0",
        "training": json.dumps(story),
    }
    cells = {0: "batch", 1: "cells"}
    size = 4 * MULTIPLE, 6 * MULTIPLE
    outputs = {"boxes": cells, "scores": cells}
    as_onnx(whole, (len(channels), *size), path, outputs, facts, half=True)


def as_onnx(
    module: nn.Module,
    example: tuple[int, int, int],
    path: Path,
    outputs: dict[str, dict[int, str]],
    facts: dict[str, str],
    others: dict[str, int] | None = None,
    any_size: bool = True,
    half: bool = False,
) -> None:
    """Write a network of one picture as ONNX, dynamic in batch and size; it must equal torch.

    Args:
        module: In use, not in training.
        example: Channels, height and width of an input.
        path: The file.
        outputs: Free axes of each output, by name.
        facts: Its metadata.
        others: Further inputs (batch, n), n by name.
        any_size: Whether pictures may have another size than the example.
        half: Whether weights are stored in 16 bits; it computes in 32 all the same.

    Raises:
        RuntimeError: If onnxruntime gives other results than torch.
    """
    part = path.with_name(path.name + ".part")
    lengths = others or {}
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # torch would rather export in its new way, which needs more
        torch.onnx.export(
            module,
            (torch.zeros(1, *example), *(torch.zeros(1, n) for n in lengths.values())),
            str(part),
            input_names=["input", *lengths],
            output_names=list(outputs),
            dynamic_axes={
                "input": {0: "batch", **({2: "height", 3: "width"} if any_size else {})},
                **{name: {0: "batch"} for name in lengths},
                **outputs,
            },
            opset_version=_OPSET,
            dynamo=False,
        )
    model = onnx.load(str(part))
    for key, value in facts.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    if half:
        _halve(model.graph)
    onnx.checker.check_model(model)
    onnx.save(model, str(part))
    size = (10 * MULTIPLE, 7 * MULTIPLE) if any_size else example[1:]
    _compare(module, (example[0], *size), lengths, list(outputs), part, 1e-2 if half else 1e-3)
    part.replace(path)


def _halve(graph: onnx.GraphProto) -> None:
    """Store matrices and filters in 16 bits; loaded, they are 32 bits again."""
    for entry in list(graph.initializer):
        array = numpy_helper.to_array(entry)
        if array.dtype != np.float32 or array.ndim < 2:
            continue
        name, stored = entry.name, f"{entry.name}.half"
        entry.CopyFrom(numpy_helper.from_array(array.astype(np.float16), stored))
        cast = helper.make_node("Cast", [stored], [name], to=TensorProto.FLOAT)
        graph.node.insert(0, cast)


def _compare(
    module: nn.Module,
    picture: tuple[int, int, int],
    lengths: dict[str, int],
    outputs: list[str],
    path: Path,
    tolerance: float,
) -> None:
    """Raise unless onnxruntime gives what torch gives, of pictures of a shape (C, H, W)."""
    import onnxruntime

    rng = np.random.default_rng(0)
    feeds = {"input": rng.standard_normal((2, *picture), dtype=np.float32)}
    for name, length in lengths.items():
        feeds[name] = rng.standard_normal((2, length), dtype=np.float32)
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    have = session.run(outputs, feeds)
    with torch.no_grad():
        found = module(*(torch.from_numpy(x) for x in feeds.values()))
    want = [part.numpy() for part in (found if isinstance(found, tuple) else (found,))]
    for ours, theirs in zip(have, want, strict=True):
        if not np.allclose(ours, theirs, rtol=tolerance, atol=tolerance):
            raise RuntimeError(
                f"{path}: onnxruntime and torch differ by {np.abs(ours - theirs).max():.3g}"
            )
