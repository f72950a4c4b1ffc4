"""The fragment network: a U of four levels over single photos, and its export."""

from __future__ import annotations

import json
from pathlib import Path

from torch import Tensor, nn
from torch.nn import functional as F

from hsvaos.detect.fragments import FRAGMENT_CHANNELS
from train.export import as_onnx
from train.net import conv

_WIDTHS = 16, 24, 40, 56
"""Channels at half, a quarter, an eighth and a sixteenth of the photo's size."""

_SHIFT = 2.0
"""Evidence is log(1 + exp(logit + shift)) / span, from 0 to 1: weak hints of many rays count too,
and a single sure one does not outweigh them all."""

_SPAN = 10.0


class FragmentModel(nn.Module):
    """Photos (B, 5, H, W) to logits (B, 2, H, W) of person and ground; H and W multiples of 16."""

    def __init__(self) -> None:
        super().__init__()
        half, quarter, eighth, sixteenth = _WIDTHS
        # 3 x 3 squares of 2 x 2 pixels; as squares put into channels first it takes a third longer
        self.first = conv(len(FRAGMENT_CHANNELS), half, 6, 2)
        self.down1 = nn.Sequential(conv(half, quarter, 3, 2), conv(quarter, quarter))
        self.down2 = nn.Sequential(conv(quarter, eighth, 3, 2), conv(eighth, eighth))
        self.down3 = nn.Sequential(
            conv(eighth, sixteenth, 3, 2),
            conv(sixteenth, sixteenth),
            conv(sixteenth, sixteenth),
        )
        self.lift3 = conv(sixteenth, eighth, 1)
        self.join2 = conv(eighth, eighth)
        self.lift2 = conv(eighth, quarter, 1)
        self.join1 = conv(quarter, quarter)
        self.lift1 = conv(quarter, half, 1)
        self.join0 = conv(half, half)
        self.out = nn.Conv2d(half, 8, 1)
        nn.init.constant_(self.out.bias[:4], -3.0)

    def forward(self, x: Tensor) -> Tensor:
        """Return logits of the shares of pixels as in the training crops."""
        fine = self.first(x)
        middle = self.down1(fine)
        coarse = self.down2(middle)
        coarse = self.join2(coarse + _doubled(self.lift3(self.down3(coarse))))
        middle = self.join1(middle + _doubled(self.lift2(coarse)))
        fine = self.join0(fine + _doubled(self.lift1(middle)))
        return F.pixel_shuffle(self.out(fine), 2)


def _doubled(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")


class Evidence(nn.Module):
    """The network as it is shipped: photos to evidence and ground, (B, 1, H, W) each, 0 to 1.

    Args:
        model: The trained network.
    """

    def __init__(self, model: FragmentModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the evidence of every pixel, and how much it counts as one of the ground."""
        person, ground = self.model(x).split(1, dim=1)
        # squared: the many that are hardly likely to be ground would outweigh the few that are
        return (F.softplus(person + _SHIFT) / _SPAN).clamp(0.0, 1.0), ground.sigmoid().square()


def export_fragments(model: FragmentModel, path: Path, story: dict[str, object]) -> None:
    """Write the network as ONNX of dynamic batch and size.

    Args:
        model: The trained network.
        path: The file.
        story: How it was trained; kept in the metadata.
    """
    facts = {
        "channels": ",".join(FRAGMENT_CHANNELS),
        "license": "Apache-2.0",
        "training": json.dumps(story),
    }
    free = {0: "batch", 2: "height", 3: "width"}
    example = len(FRAGMENT_CHANNELS), 64, 96
    as_onnx(Evidence(model).eval(), example, path, {"evidence": free, "ground": free}, facts)
