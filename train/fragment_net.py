"""The fragment network: a shallow U of three levels over single photos, and its export."""

from __future__ import annotations

import json
from pathlib import Path

from torch import Tensor, nn
from torch.nn import functional as F

from hsvaos.detect.fragments import FRAGMENT_CHANNELS
from train.export import as_onnx
from train.net import conv

_WIDTHS = 16, 24, 32
"""Channels at half, a quarter and an eighth of the photo's size."""

_SHIFT = 2.0
"""Evidence is log(1 + exp(logit + shift)) / span, from 0 to 1: weak hints of many rays count too,
and a single sure one does not outweigh them all."""

_SPAN = 10.0


class FragmentModel(nn.Module):
    """Photos (B, 5, H, W) to logits (B, 1, H, W); H and W multiples of 8."""

    def __init__(self) -> None:
        super().__init__()
        half, quarter, eighth = _WIDTHS
        self.first = conv(4 * len(FRAGMENT_CHANNELS), half)
        self.down1 = nn.Sequential(conv(half, quarter, 3, 2), conv(quarter, quarter))
        self.down2 = nn.Sequential(
            conv(quarter, eighth, 3, 2), conv(eighth, eighth), conv(eighth, eighth)
        )
        self.lift2 = conv(eighth, quarter, 1)
        self.join1 = conv(quarter, quarter)
        self.lift1 = conv(quarter, half, 1)
        self.join0 = conv(half, half)
        self.out = nn.Conv2d(half, 4, 1)
        nn.init.constant_(self.out.bias, -3.0)

    def forward(self, x: Tensor) -> Tensor:
        """Return logits of the share of people's pixels as in the training crops."""
        fine = self.first(F.pixel_unshuffle(x, 2))
        middle = self.down1(fine)
        middle = self.join1(middle + _doubled(self.lift2(self.down2(middle))))
        fine = self.join0(fine + _doubled(self.lift1(middle)))
        return F.pixel_shuffle(self.out(fine), 2)


def _doubled(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")


class Evidence(nn.Module):
    """The network as it is shipped: photos to evidence (B, 1, H, W), 0 to 1.

    Args:
        model: The trained network.
    """

    def __init__(self, model: FragmentModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, x: Tensor) -> Tensor:
        """Return the evidence of every pixel."""
        return (F.softplus(self.model(x) + _SHIFT) / _SPAN).clamp(0.0, 1.0)


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
    as_onnx(Evidence(model).eval(), example, path, {"evidence": free}, facts)
