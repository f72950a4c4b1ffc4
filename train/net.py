"""The person network: small, anchor-free, one scale (stride 8)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from hsvaos.detect.network_input import CHANNELS

STRIDE = 8
MULTIPLE = 16
"""Sides of the input must be multiples of this."""

SIZE_UNIT = 16.0
"""Box sides are learned as logarithms in this unit [px]."""


def conv(before: int, after: int, size: int = 3, stride: int = 1) -> nn.Sequential:
    """Return a convolution, normalised and rectified.

    Args:
        before: Channels that come in.
        after: Channels that go out.
        size: Of the filters [px].
        stride: Of the convolution [px].
    """
    return nn.Sequential(
        nn.Conv2d(before, after, size, stride, (size - 1) // 2, bias=False),
        nn.BatchNorm2d(after),
        nn.ReLU(inplace=True),
    )


class Residual(nn.Module):
    """Two convolutions, added to what comes in.

    Args:
        width: Channels.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = conv(width, width)
        self.second = nn.Sequential(
            nn.Conv2d(width, width, 3, 1, 1, bias=False), nn.BatchNorm2d(width)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return features of the same shape."""
        return F.relu(x + self.second(self.first(x)), inplace=True)


class PersonNet(nn.Module):
    """Maps channels of `network_input` to a score and a box at every eighth pixel.

    Args:
        channels: Input channels, by default all.
        widths: Channels after the first two layers, at stride 8 and 16, and of the head.
    """

    def __init__(
        self,
        channels: int = len(CHANNELS),
        widths: tuple[int, int, int, int, int] = (40, 64, 96, 128, 96),
    ) -> None:
        super().__init__()
        first, second, middle, deep, head = widths
        self.channels = channels
        self.stem = nn.Sequential(
            conv(channels, first, 5, 2), conv(first, second, 3, 2), Residual(second)
        )
        self.middle = nn.Sequential(conv(second, middle, 3, 2), Residual(middle), Residual(middle))
        self.deep = nn.Sequential(conv(middle, deep, 3, 2), Residual(deep))
        self.lift = conv(deep, middle, 1)
        self.join = conv(2 * middle, middle)
        self.head = conv(middle, head)
        self.score = nn.Conv2d(head, 1, 1)
        self.box = nn.Conv2d(head, 4, 1)
        nn.init.constant_(self.score.bias, -4.6)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits (B, 1, h, w) and box values (B, 4, h, w): dx, dy, log w, log h."""
        middle = self.middle(self.stem(x))
        deep = F.interpolate(self.lift(self.deep(middle)), scale_factor=2.0, mode="nearest")
        joined = self.head(self.join(torch.cat([middle, deep], dim=1)))
        return self.score(joined), self.box(joined)


def cell_centres(height: int, width: int) -> Tensor:
    """Return the centres of the cells, shape (h * w, 2), x and y [px], pixel centres at integers.

    Args:
        height: Rows of cells.
        width: Columns of cells.
    """
    y, x = torch.meshgrid(
        torch.arange(height, dtype=torch.float32),
        torch.arange(width, dtype=torch.float32),
        indexing="ij",
    )
    return torch.stack([x, y], dim=-1).reshape(-1, 2) * STRIDE + (STRIDE - 1) / 2.0


def boxes_of(values: Tensor, centres: Tensor) -> Tensor:
    """Return boxes xyxy [px], shape (..., 4), of box values (..., 4) at cell centres (..., 2)."""
    middle = centres + values[..., :2] * STRIDE
    half = 0.5 * SIZE_UNIT * torch.exp(values[..., 2:].clamp(-4.0, 4.0))
    return torch.cat([middle - half, middle + half], dim=-1)


class Exported(nn.Module):
    """The network as it is shipped: input to boxes (B, N, 4) and scores (B, N).

    Args:
        net: The trained network.
    """

    def __init__(self, net: PersonNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return boxes xyxy [px] and scores 0..1 of every cell."""
        logits, values = self.net(x)
        # cumulative sums instead of arange: they follow dynamic sizes through the export
        ones = torch.ones_like(logits)
        column = (torch.cumsum(ones, dim=3) - 1.0) * STRIDE + (STRIDE - 1) / 2.0
        row = (torch.cumsum(ones, dim=2) - 1.0) * STRIDE + (STRIDE - 1) / 2.0
        centres = torch.cat([column, row], dim=1).flatten(2).transpose(1, 2)
        boxes = boxes_of(values.flatten(2).transpose(1, 2), centres)
        return boxes, torch.sigmoid(logits).flatten(1)
