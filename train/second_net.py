"""The network of the second look: one patch to a score and a box."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from hsvaos.detect.second_look import LOOK_PX, SECOND_CHANNELS
from train.export import as_onnx
from train.net import Residual, conv

FACTS = 3
"""Numbers that it is told of a box, see `hsvaos.detect.second_look.facts_of`."""

_STRIDE = 16
_PLACES = 24
"""Channels of which it matters where in the patch something is: for the box above all."""


class SecondNet(nn.Module):
    """Maps patches with a channel of the box, and facts of the box, to a logit and a shift.

    Args:
        widths: Channels at stride 2, 4, 8 and 16, and of the last layer but one.
        depths: Residual parts at each of these strides.
        dropout: Share of that layer that is left out while training.
        channels: How many of `SECOND_CHANNELS` it sees, from the first.
    """

    def __init__(
        self,
        widths: tuple[int, int, int, int, int] = (48, 64, 96, 128, 128),
        depths: tuple[int, int, int, int] = (0, 1, 2, 2),
        dropout: float = 0.2,
        channels: int = len(SECOND_CHANNELS),
    ) -> None:
        super().__init__()
        self.channels = channels
        *stages, last = widths
        parts: list[nn.Module] = []
        before = channels + 1
        for number, (width, depth) in enumerate(zip(stages, depths, strict=True)):
            parts.append(conv(before, width, 3 if number else 5, 2))
            parts += [Residual(width) for _ in range(depth)]
            before = width
        self.body = nn.Sequential(*parts)
        self.where = conv(before, _PLACES, 1)
        side = LOOK_PX // _STRIDE
        self.mixed = nn.Linear(2 * before + _PLACES * side * side + FACTS, last)
        self.dropout = nn.Dropout(dropout)
        self.score = nn.Linear(last, 1)
        self.box = nn.Linear(last, 4)
        for layer in (self.score, self.box):  # at first, the first network's opinion
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(self, patches: Tensor, facts: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits (B,) and shifts (B, 4)."""
        if self.channels + 1 < patches.shape[1]:
            patches = torch.cat([patches[:, : self.channels], patches[:, -1:]], dim=1)
        found = self.body(patches)
        whole = found.mean(dim=(2, 3))
        strongest = found.amax(dim=(2, 3))
        places = self.where(found).flatten(1)
        mixed = F.relu(self.mixed(torch.cat([whole, strongest, places, facts], dim=1)))
        mixed = self.dropout(mixed)
        return facts[:, 0] + self.score(mixed)[:, 0], self.box(mixed)


def net_like(shapes: Sequence[tuple[int, ...]]) -> SecondNet:
    """Return a new network whose layers have given shapes.

    Args:
        shapes: Of the weights of its layers, in order.

    Raises:
        ValueError: If no such network has them.
    """
    *filters, _ = [shape for shape in shapes if len(shape) == 4] or [()]
    matrices = [shape for shape in shapes if len(shape) == 2]
    widths: list[int] = []
    layers: list[int] = []
    for out, into, *_ in filters:
        if widths and out == into == widths[-1]:
            layers[-1] += 1
        else:
            widths.append(out)
            layers.append(0)
    if len(widths) != 4 or not matrices:
        raise ValueError(f"expected the layers of SecondNet, got filters of {filters}")
    a, b, c, d = widths
    depths = [count // 2 for count in layers]
    channels = filters[0][1] - 1
    return SecondNet((a, b, c, d, matrices[0][0]), (*depths,), channels=channels)  # type: ignore[arg-type]


class MeanOfNets(nn.Module):
    """Several networks, asked together: each is wrong in its own way.

    Args:
        nets: The networks.
        weights: Of each; by default all count the same.
        first: Share of the first network's opinion in the score; boxes are put right without it.
    """

    def __init__(
        self,
        nets: Sequence[SecondNet],
        weights: Sequence[float] | None = None,
        first: float = 0.0,
    ) -> None:
        super().__init__()
        self.first = first
        self.nets = nn.ModuleList(nets)
        given = torch.tensor([1.0] * len(nets) if weights is None else weights)
        self.weights = [float(weight) for weight in given / given.sum()]

    def forward(self, patches: Tensor, facts: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean logits (B,) and mean shifts (B, 4)."""
        logits, shifts = zip(*(net(patches, facts) for net in self.nets), strict=True)
        score = _mean(logits, self.weights)
        if self.first:
            score = torch.lerp(score, facts[:, 0], self.first)
        return score, _mean(shifts, self.weights)


def _mean(parts: Sequence[Tensor], weights: Sequence[float]) -> Tensor:
    weighed = [part * weight for part, weight in zip(parts, weights, strict=True)]
    return torch.stack(weighed).sum(dim=0)


class ExportedSecond(nn.Module):
    """The network as it is shipped: to scores (B,) and shifts (B, 4).

    Args:
        net: The trained network, or the mean of several.
        shift: Added to its logits.
    """

    def __init__(self, net: nn.Module, shift: float = 0.0) -> None:
        super().__init__()
        self.net = net
        self.shift = shift

    def forward(self, patches: Tensor, facts: Tensor) -> tuple[Tensor, Tensor]:
        """Return scores 0..1 and shifts."""
        logits, shifts = self.net(patches, facts)
        return torch.sigmoid(logits + self.shift), shifts


def export_second(net: nn.Module, path: Path, shift: float, story: dict[str, object]) -> None:
    """Write the network as ONNX of any number of patches.

    Args:
        net: The trained network, or the mean of several.
        path: The file.
        shift: Added to logits, so that the threshold of the first network holds.
        story: How it was trained; kept in the metadata.
    """
    facts = {
        "channels": ",".join(SECOND_CHANNELS),
        "license": "Apache-2.0",
        "training": json.dumps(story),
    }
    batch = {0: "batch"}
    example = (len(SECOND_CHANNELS) + 1, LOOK_PX, LOOK_PX)
    outputs = {"scores": batch, "shifts": batch}
    shifted = ExportedSecond(net.eval(), shift).eval()
    as_onnx(shifted, example, path, outputs, facts, {"facts": FACTS}, any_size=False, half=True)
