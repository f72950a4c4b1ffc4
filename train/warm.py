"""Weights of an exported network brought back for further training.

The export folds each batch normalisation into the convolution before it. Brought back, a layer
gets the normalisation that undoes what it would do: its mean and deviation are measured on crops,
so that the network gives the same in training and in use as the file it came from.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from train.net import PersonNet


def unfolded(path: Path, batches: Iterable[Tensor]) -> PersonNet:
    """Return the network of an exported file, ready to be trained further.

    A file of fewer channels than today's is taken too: at first it does not see the new ones.

    Args:
        path: Written by `train.export`.
        batches: Inputs (B, 25, H, W) on which the layers' means and deviations are measured.

    Raises:
        ValueError: If the file holds another network.
    """
    net = PersonNet().eval()
    layers = _layers(net)
    stored = _fitting(path, net)
    factors: list[Tensor] = []
    with torch.no_grad():
        for (conv, norm), (weight, bias) in zip(layers, stored, strict=True):
            # filters of length 1, so that a learning rate means the same for all
            length = weight.flatten(1).norm(dim=1) if norm is not None else torch.ones(len(weight))
            factor = torch.where(length > 1e-6, 1.0 / length.clamp(min=1e-6), 1.0)
            conv.weight.copy_(weight * factor[:, None, None, None])
            factors.append(factor)
            if norm is None:
                conv.bias.copy_(bias)  # type: ignore[union-attr]
            else:
                _normalise(norm, torch.zeros_like(bias), torch.ones_like(bias), factor, bias)
    moments = _measured(net, [conv for conv, norm in layers if norm is not None], batches)
    with torch.no_grad():
        for (conv, norm), (_, bias), factor in zip(layers, stored, factors, strict=True):
            if norm is not None:
                _normalise(norm, *moments[conv], factor, bias)
    return net


def blended(net: PersonNet, path: Path, share: float) -> PersonNet:
    """Return the network half way, or some other part of it, back to the file it began with.

    Weights between those before and after further training find more than either: Wortsman 2022,
    "Robust fine-tuning of zero-shot models".

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
    stored = _fitting(path, mixed)
    with torch.no_grad():
        for (conv, norm), own, old in zip(_layers(mixed), _folded(net), stored, strict=True):
            weight, bias = (
                torch.lerp(new, before, share) for new, before in zip(own, old, strict=True)
            )
            conv.weight.copy_(weight)
            if norm is None:
                conv.bias.copy_(bias)  # type: ignore[union-attr]
            else:
                one = torch.ones_like(bias)
                _normalise(norm, torch.zeros_like(bias), one - norm.eps, one, bias)
    return mixed


def _folded(net: PersonNet) -> list[tuple[Tensor, Tensor]]:
    """Return weights and biases of the convolutions with their normalisations folded in."""
    found = []
    for conv, norm in _layers(net):
        if norm is None:
            found.append((conv.weight, conv.bias))
            continue
        factor = norm.weight / torch.sqrt(norm.running_var + norm.eps)  # type: ignore[operator]
        bias = norm.bias - norm.running_mean * factor  # type: ignore[operator]
        found.append((conv.weight * factor[:, None, None, None], bias))
    return found  # type: ignore[return-value]


def _fitting(path: Path, net: PersonNet) -> list[tuple[Tensor, Tensor]]:
    """Return the convolutions of a file, which must be those of the network."""
    stored = _stored(path)
    stored[0] = _widened(stored[0][0], net.channels), stored[0][1]
    shapes = [tuple(conv.weight.shape) for conv, _ in _layers(net)]
    if [tuple(weight.shape) for weight, _ in stored] != shapes:
        raise ValueError(f"{path}: expected the convolutions {shapes} of train.net")
    return stored


def _widened(weight: Tensor, channels: int) -> Tensor:
    """Return the first layer's filters with zeros for channels that came later."""
    missing = max(0, channels - weight.shape[1])
    return torch.nn.functional.pad(weight, (0, 0, 0, 0, 0, missing))


def _normalise(
    norm: nn.BatchNorm2d, mean: Tensor, variance: Tensor, factor: Tensor, bias: Tensor
) -> None:
    norm.running_mean.copy_(mean)  # type: ignore[union-attr]
    norm.running_var.copy_(variance)  # type: ignore[union-attr]
    norm.weight.copy_(torch.sqrt(variance + norm.eps) / factor)
    norm.bias.copy_(bias + mean / factor)


def _layers(net: PersonNet) -> list[tuple[nn.Conv2d, nn.BatchNorm2d | None]]:
    """Return convolutions in order, each with the normalisation that follows it."""
    found: list[tuple[nn.Conv2d, nn.BatchNorm2d | None]] = []
    for module in net.modules():
        if isinstance(module, nn.Conv2d):
            found.append((module, None))
        elif isinstance(module, nn.BatchNorm2d):
            found[-1] = (found[-1][0], module)
    return found


def _stored(path: Path) -> list[tuple[Tensor, Tensor]]:
    graph = onnx.load(str(path)).graph
    arrays = {entry.name: numpy_helper.to_array(entry) for entry in graph.initializer}
    for node in graph.node:  # equal arrays are stored once
        if node.op_type == "Identity" and node.input[0] in arrays:
            arrays[node.output[0]] = arrays[node.input[0]]
    return [
        (torch.tensor(arrays[node.input[1]]), torch.tensor(arrays[node.input[2]]))
        for node in graph.node
        if node.op_type == "Conv"
    ]


def _measured(
    net: PersonNet, convolutions: list[nn.Conv2d], batches: Iterable[Tensor]
) -> dict[nn.Conv2d, tuple[Tensor, Tensor]]:
    """Return mean and variance of what each convolution gives, by channel."""
    sums: dict[nn.Module, list[Tensor]] = {conv: [] for conv in convolutions}

    def note(conv: nn.Module, _: object, out: Tensor) -> None:
        sums[conv].append(torch.stack([out.mean(dim=(0, 2, 3)), (out**2).mean(dim=(0, 2, 3))]))

    hooks = [conv.register_forward_hook(note) for conv in convolutions]
    with torch.no_grad():
        for batch in batches:
            net(batch)
    for hook in hooks:
        hook.remove()
    found = {}
    for conv in convolutions:
        mean, square = torch.stack(sums[conv]).mean(dim=0)
        found[conv] = (mean, (square - mean**2).clamp(min=1e-6))
    return found
