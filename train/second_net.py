"""The network of the second look: one patch to a score and a box."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from hsvaos.detect.network_input import CHANNELS
from hsvaos.detect.second_look import LOOK_PX
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
        dropout: Share of that layer that is left out while training.
    """

    def __init__(
        self, widths: tuple[int, int, int, int, int] = (32, 48, 72, 96, 96), dropout: float = 0.2
    ) -> None:
        super().__init__()
        first, second, third, fourth, last = widths
        self.body = nn.Sequential(
            conv(len(CHANNELS) + 1, first, 5, 2),
            conv(first, second, 3, 2),
            Residual(second),
            conv(second, third, 3, 2),
            Residual(third),
            conv(third, fourth, 3, 2),
            Residual(fourth),
        )
        self.where = conv(fourth, _PLACES, 1)
        side = LOOK_PX // _STRIDE
        self.mixed = nn.Linear(2 * fourth + _PLACES * side * side + FACTS, last)
        self.dropout = nn.Dropout(dropout)
        self.score = nn.Linear(last, 1)
        self.box = nn.Linear(last, 4)
        for layer in (self.score, self.box):  # at first, the first network's opinion
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(self, patches: Tensor, facts: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits (B,) and shifts (B, 4)."""
        found = self.body(patches)
        whole = found.mean(dim=(2, 3))
        strongest = found.amax(dim=(2, 3))
        places = self.where(found).flatten(1)
        mixed = F.relu(self.mixed(torch.cat([whole, strongest, places, facts], dim=1)))
        mixed = self.dropout(mixed)
        return facts[:, 0] + self.score(mixed)[:, 0], self.box(mixed)


class MeanOfNets(nn.Module):
    """Networks of several seeds, asked together: each is wrong in its own way.

    Args:
        nets: The networks.
    """

    def __init__(self, nets: Sequence[SecondNet]) -> None:
        super().__init__()
        self.nets = nn.ModuleList(nets)

    def forward(self, patches: Tensor, facts: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean logits (B,) and mean shifts (B, 4)."""
        logits, shifts = zip(*(net(patches, facts) for net in self.nets), strict=True)
        return torch.stack(logits).mean(dim=0), torch.stack(shifts).mean(dim=0)


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
        "channels": ",".join(CHANNELS),
        "license": "Apache-2.0",
        "training": json.dumps(story),
    }
    batch = {0: "batch"}
    example = (len(CHANNELS) + 1, LOOK_PX, LOOK_PX)
    outputs = {"scores": batch, "shifts": batch}
    shifted = ExportedSecond(net.eval(), shift).eval()
    as_onnx(shifted, example, path, outputs, facts, {"facts": FACTS}, False)
