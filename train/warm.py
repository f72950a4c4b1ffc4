"""Weights of an exported network brought back for further training.

The export folds each batch normalisation into the convolution before it. Brought back, a layer
gets the normalisation that undoes what it would do: its mean and deviation are measured on crops,
so that the network gives the same in training and in use as the file it came from.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from train.net import PersonNet
from train.second_net import SecondNet, net_like

Layer = nn.Conv2d | nn.Linear
Stored = list[tuple[Tensor, Tensor]]
"""Weights and biases of layers, in order."""


def unfolded(path: Path, batches: Iterable[Tensor]) -> PersonNet:
    """Return the network of an exported file, ready to be trained further.

    A file of fewer input channels or narrower layers than today's is taken too: at first the
    network gives the same, as it does not see the new channels, and nothing that was there sees
    what the new parts of layers give (Chen 2016, "Net2Net").

    Args:
        path: Written by `train.export`.
        batches: Inputs (B, 25, H, W) on which the layers' means and deviations are measured.

    Raises:
        ValueError: If the file holds another network.
    """
    net = PersonNet().eval()
    _unfold(net, _fitting(path, net), ((batch,) for batch in batches))
    return net


def unfolded_seconds(path: Path, batches: Sequence[tuple[Tensor, Tensor]]) -> list[SecondNet]:
    """Return the networks of an exported second look, ready to be trained further.

    Args:
        path: Written by `train.second_net.export_second`.
        batches: Patches (B, 26, side, side) and facts (B, 3) on which the layers' means and
            deviations are measured.

    Raises:
        ValueError: If the file holds other networks.
    """
    found = []
    for stored in _stored_seconds(path):
        net = _like(path, stored)
        _unfold(net, stored, batches)
        found.append(net)
    return found


def stored_seconds(path: Path) -> list[SecondNet]:
    """Return the networks of an exported second look as they are: to be used, not to be trained.

    Args:
        path: Written by `train.second_net.export_second`.

    Raises:
        ValueError: If the file holds other networks.
    """
    found = []
    for stored in _stored_seconds(path):
        net = _like(path, stored)
        _fill(net, stored)
        found.append(net)
    return found


def _stored_seconds(path: Path) -> list[Stored]:
    """Return the layers of each network of a file; a filter of 5 x 5 begins one."""
    stored = _stored(path)
    starts = [k for k, (weight, _) in enumerate(stored) if weight.shape[2:] == (5, 5)]
    return [stored[a:b] for a, b in pairwise([*(starts or [0]), len(stored)])]


def _like(path: Path, stored: Stored) -> SecondNet:
    """Return a new network, in use, that a file's layers fit."""
    try:
        net = net_like([tuple(weight.shape) for weight, _ in stored])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    _checked(path, net, stored)
    return net.eval()


def _unfold(net: nn.Module, stored: Stored, batches: Iterable[tuple[Tensor, ...]]) -> None:
    layers = _layers(net)
    factors: list[Tensor] = []
    with torch.no_grad():
        for (layer, norm), (weight, bias) in zip(layers, stored, strict=True):
            if norm is None:
                layer.weight.copy_(weight)
                layer.bias.copy_(bias)
                factors.append(torch.ones(len(weight)))
                continue
            # filters of length 1, so that a learning rate means the same for all
            length = weight.flatten(1).norm(dim=1)
            factor = torch.where(length > 1e-6, 1.0 / length.clamp(min=1e-6), 1.0)
            layer.weight.copy_(weight * factor[:, None, None, None])
            factors.append(factor)
            _normalise(norm, torch.zeros_like(bias), torch.ones_like(bias), factor, bias)
    moments = _measured(net, [layer for layer, norm in layers if norm is not None], batches)
    with torch.no_grad():
        for (layer, norm), (_, bias), factor in zip(layers, stored, factors, strict=True):
            if norm is not None:
                _normalise(norm, *moments[layer], factor, bias)


def blended(net: PersonNet, path: Path, share: float) -> PersonNet:
    """Return the network half way, or some other part of it, back to the file it began with.

    Weights between those before and after further training find more than either: Wortsman 2022,
    "Robust fine-tuning of zero-shot models". A narrower file is grown as `unfolded` does, with what
    its new parts have learnt since.

    Args:
        net: Trained further from the file; not changed.
        path: The file.
        share: Of the file's weights, 0 to 1.

    Returns:
        A network to be used, not to be trained: its normalisations do nothing.

    Raises:
        ValueError: If the file holds another network.
    """
    mixed = PersonNet().eval()
    _blend(mixed, net, _fitting(path, net), share)
    return mixed


def blended_second(net: SecondNet, path: Path, index: int, share: float) -> SecondNet:
    """Return what `blended` does of one of the networks of a second look.

    Args:
        net: Trained further from the file; not changed.
        path: The file.
        index: Which of its networks.
        share: Of the file's weights, 0 to 1.

    Raises:
        ValueError: If the file holds other networks.
    """
    stored = _stored_seconds(path)[index]
    mixed = _like(path, stored)
    _blend(mixed, net, stored, share)
    return mixed


def _blend(mixed: nn.Module, net: nn.Module, stored: Stored, share: float) -> None:
    parts = zip(_folded(net), stored, strict=True)
    with torch.no_grad():
        between = [
            (torch.lerp(new[0], old[0], share), torch.lerp(new[1], old[1], share))
            for new, old in parts
        ]
    _fill(mixed, between)


def _fill(net: nn.Module, stored: Stored) -> None:
    """Give a network layers into which their normalisations are folded."""
    with torch.no_grad():
        for (layer, norm), (weight, bias) in zip(_layers(net), stored, strict=True):
            layer.weight.copy_(weight)
            if norm is None:
                layer.bias.copy_(bias)
            else:
                one = torch.ones_like(bias)
                _normalise(norm, torch.zeros_like(bias), one - norm.eps, one, bias)


def _folded(net: nn.Module) -> Stored:
    """Return weights and biases of the layers with their normalisations folded in."""
    found: Stored = []
    for layer, norm in _layers(net):
        if norm is None:
            found.append((layer.weight, layer.bias))
            continue
        factor = norm.weight / torch.sqrt(norm.running_var + norm.eps)  # type: ignore[operator]
        bias = norm.bias - norm.running_mean * factor  # type: ignore[operator]
        found.append((layer.weight * factor[:, None, None, None], bias))
    return found


def _fitting(path: Path, net: PersonNet) -> Stored:
    """Return the layers of a file, grown to be those of the network."""
    return _checked(path, net, _grown(_stored(path), net))


def _checked(path: Path, net: nn.Module, stored: Stored) -> Stored:
    shapes = [tuple(layer.weight.shape) for layer, _ in _layers(net)]
    if [tuple(weight.shape) for weight, _ in stored] != shapes:
        raise ValueError(f"{path}: expected the layers {shapes} of {type(net).__name__}")
    return stored


def _grown(stored: Stored, net: PersonNet) -> Stored:
    """Return layers as wide as the network's, where they are narrower, that give the same.

    Parts that are new have the network's own weights. What cannot grow stays as it is.
    """
    layers = [layer for layer, _ in _layers(net)]
    if len(layers) != len(stored):
        return stored
    grown: Stored = []
    own = (tuple(part.detach().clone() for part in parts) for parts in _folded(net))
    for layer, (wide, level), (weight, bias) in zip(layers, own, stored, strict=True):
        parts = 2 if layer is net.join[0] else 1  # two inputs, one behind the other
        sides = zip(weight.shape, wide.shape, strict=False)
        if weight.ndim != wide.ndim or any(a > b for a, b in sides):
            return stored
        if weight.shape[2:] != wide.shape[2:] or weight.shape[1] % parts:
            return stored
        outputs, inputs = weight.shape[0], weight.shape[1] // parts
        wide[:outputs] = 0.0
        for part, old in enumerate(weight.chunk(parts, dim=1)):
            start = part * wide.shape[1] // parts
            wide[:outputs, start : start + inputs] = old
        level[:outputs] = bias
        grown.append((wide, level))
    return grown


def _normalise(
    norm: nn.BatchNorm2d, mean: Tensor, variance: Tensor, factor: Tensor, bias: Tensor
) -> None:
    norm.running_mean.copy_(mean)  # type: ignore[union-attr]
    norm.running_var.copy_(variance)  # type: ignore[union-attr]
    norm.weight.copy_(torch.sqrt(variance + norm.eps) / factor)
    norm.bias.copy_(bias + mean / factor)


def _layers(net: nn.Module) -> list[tuple[Layer, nn.BatchNorm2d | None]]:
    """Return the layers of weights in order, each with the normalisation that follows it."""
    found: list[tuple[Layer, nn.BatchNorm2d | None]] = []
    for module in net.modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            found.append((module, None))
        elif isinstance(module, nn.BatchNorm2d):
            found[-1] = (found[-1][0], module)
    return found


def _stored(path: Path) -> Stored:
    graph = onnx.load(str(path)).graph
    arrays = {entry.name: numpy_helper.to_array(entry) for entry in graph.initializer}
    for node in graph.node:  # equal arrays are stored once, and some in 16 bits
        if node.op_type in ("Identity", "Cast") and node.input[0] in arrays:
            arrays[node.output[0]] = arrays[node.input[0]].astype(np.float32)
    return [
        (torch.tensor(arrays[node.input[1]]), torch.tensor(arrays[node.input[2]]))
        for node in graph.node
        if node.op_type in ("Conv", "Gemm")
    ]


def _measured(
    net: nn.Module, convolutions: list[Layer], batches: Iterable[tuple[Tensor, ...]]
) -> dict[Layer, tuple[Tensor, Tensor]]:
    """Return mean and variance of what each convolution gives, by channel."""
    sums: dict[nn.Module, list[Tensor]] = {conv: [] for conv in convolutions}

    def note(conv: nn.Module, _: object, out: Tensor) -> None:
        sums[conv].append(torch.stack([out.mean(dim=(0, 2, 3)), (out**2).mean(dim=(0, 2, 3))]))

    hooks = [conv.register_forward_hook(note) for conv in convolutions]
    with torch.no_grad():
        for batch in batches:
            net(*batch)
    for hook in hooks:
        hook.remove()
    found = {}
    for conv in convolutions:
        mean, square = torch.stack(sums[conv]).mean(dim=0)
        found[conv] = (mean, (square - mean**2).clamp(min=1e-6))
    return found
