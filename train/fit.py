"""Fit a person network to crops."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Iterator
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from train.net import STRIDE, PersonNet, boxes_of, cell_centres
from train.samples import CROP_PX, Sample, visit
from train.warm import unfolded

CROPS_A_VISIT = 48
BATCH = 16
_MEASURED_ON = 8
"""Batches on which the layers of a network brought back are measured."""

_CORE_PX = 7.0
"""Cells whose centre lies this near the middle of a box answer for it; the nearest always does."""


class Crops(IterableDataset[Any]):
    """Endless batches of crops from the maps of a folder; maps that come later are found.

    Args:
        folder: Of the maps.
        seed: Of everything that is drawn.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        super().__init__()
        self.folder = folder
        self.seed = seed

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        rng = np.random.default_rng([self.seed, worker.id if worker else 0])
        pool: list[Sample] = []
        while True:
            paths = sorted(p for p in self.folder.glob("*.npz") if ".part." not in p.name)
            for k in rng.permutation(len(paths))[:64]:
                pool += visit(paths[k], rng, CROPS_A_VISIT)
                # crops of one map lie in different batches
                while len(pool) >= 16 * BATCH:
                    chosen = rng.permutation(len(pool))[:BATCH]
                    yield collate([pool[i] for i in chosen])
                    pool = [s for i, s in enumerate(pool) if i not in set(chosen.tolist())]


def collate(samples: list[Sample]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return inputs, and for every cell: wanted (1, 0, or -1 where it does not count) and boxes.

    Args:
        samples: A batch.

    Returns:
        whole (B, C, 256, 256), wanted (B, n), boxes (B, n, 4), number of people (B,).
    """
    side = CROP_PX // STRIDE
    centres = cell_centres(side, side).numpy().astype(np.float64)
    wanted = np.zeros((len(samples), len(centres)), dtype=np.float32)
    boxes = np.zeros((len(samples), len(centres), 4), dtype=np.float32)
    for k, sample in enumerate(samples):
        for box in np.concatenate([sample.ignored, sample.boxes]):
            wanted[k][_inside(centres, box)] = -1.0
        for box in sample.boxes:
            away = np.hypot(*(centres - 0.5 * (box[:2] + box[2:])).T)
            own = (away <= _CORE_PX) | (away == away.min())
            wanted[k][own] = 1.0
            boxes[k][own] = box
    whole = torch.from_numpy(np.stack([s.whole for s in samples]))
    people = torch.tensor([len(s.boxes) for s in samples])
    return whole, torch.from_numpy(wanted), torch.from_numpy(boxes), people


def _inside(centres: NDArray[np.float64], box: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(
        (centres >= box[:2] - 2.0).all(axis=1) & (centres <= box[2:] + 2.0).all(axis=1)
    )


def overlap(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Return IoU and generalised IoU (Rezatofighi 2019) of boxes (..., 4), pair by pair."""
    low = torch.maximum(first[..., :2], second[..., :2])
    high = torch.minimum(first[..., 2:], second[..., 2:])
    common = (high - low).clamp(min=0.0).prod(dim=-1)
    area = (first[..., 2:] - first[..., :2]).prod(-1) + (second[..., 2:] - second[..., :2]).prod(-1)
    union = area - common
    iou = common / union.clamp(min=1e-6)
    hull = (
        torch.maximum(first[..., 2:], second[..., 2:])
        - torch.minimum(first[..., :2], second[..., :2])
    ).prod(dim=-1)
    return iou, iou - (hull - union) / hull.clamp(min=1e-6)


def loss_of(net: PersonNet, batch: tuple[Tensor, Tensor, Tensor, Tensor]) -> dict[str, Tensor]:
    """Return the parts of the loss: focal loss (Lin 2017) of the scores, and of the boxes.

    A cell that answers for a person shall score the overlap its box reaches (quality focal loss,
    Li 2020), so that the better of two boxes wins.

    Args:
        net: The network.
        batch: From `collate`.
    """
    whole, wanted, boxes, _ = batch
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=short_floats()):
        logits, values = net(whole.to(memory_format=torch.channels_last))
    logits, values = logits.float().flatten(1), values.float()
    centres = cell_centres(*values.shape[2:])
    predicted = boxes_of(values.flatten(2).transpose(1, 2), centres)
    own = wanted > 0.0
    iou, giou = overlap(predicted[own], boxes[own])
    target = torch.zeros_like(logits)
    # at least one half: a poor box shall not hide a person
    target[own] = 0.5 + 0.5 * iou.detach().clamp(0.0, 1.0)
    score = torch.sigmoid(logits)
    plain = F.binary_cross_entropy_with_logits(logits, target, reduction="none")
    focal = plain * (target - score).abs().pow(2.0)
    people = own.sum().clamp(min=1)
    return {
        "score": (focal * (wanted >= 0.0)).sum() / people,
        "box": (1.0 - giou).sum() / people if own.any() else values.sum() * 0.0,
    }


@cache
def short_floats() -> bool:
    """Whether the CPU computes in bfloat16: then 2.6 times as fast, and no worse; else slower."""
    supported = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
    return any(bool(getattr(torch.cpu, name, bool)()) for name in supported)


def fit(
    source: Callable[[int], IterableDataset[Any]],
    out: Path,
    *,
    steps: int,
    seed: int = 1,
    workers: int = 1,
    tune: Any = None,
    tune_every: int = 1500,
    start_from: Path | None = None,
    rate: float = 2e-3,
    new_net: Callable[[], PersonNet] = PersonNet,
) -> PersonNet:
    """Train on crops; goes on where it was stopped.

    Args:
        source: Makes endless batches of crops from a seed, as `Crops` does.
        out: Folder for the state, the averaged weights and the curve.
        steps: Batches in all.
        seed: Of initial weights and crops.
        workers: Processes that draw crops.
        tune: Called with the averaged network; returns figures for the curve.
        tune_every: Steps between such calls.
        start_from: An exported network whose training goes on; by default a new one.
        rate: Highest learning rate.
        new_net: Makes a network of new weights.

    Raises:
        ValueError: If a stopped run in `out` had begun from other weights.
    """
    torch.manual_seed(seed)
    out.mkdir(parents=True, exist_ok=True)
    state_path, start = out / "state.pt", 0
    net, mean = new_net(), new_net()
    state = torch.load(state_path) if state_path.exists() else None
    begun_from = str(start_from) if start_from is not None else None
    if state is not None and state.get("start_from") != begun_from:
        raise ValueError(
            f"{state_path} goes on from {state.get('start_from') or 'new weights'}, asked was "
            f"{begun_from or 'new weights'}; move it away to begin anew"
        )
    if start_from is not None and state is None:
        some = islice(source(seed + 7), _MEASURED_ON)
        net = unfolded(start_from, (batch[0] for batch in some))
    net = net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    mean.load_state_dict(net.state_dict())
    optimizer = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=1e-3)
    if state is not None:
        net.load_state_dict(state["net"])
        mean.load_state_dict(state["mean"])
        optimizer.load_state_dict(state["optimizer"])
        start = int(state["step"])
    loader = DataLoader(
        source(seed + 1000 * start),
        batch_size=None,
        num_workers=workers,
        prefetch_factor=4 if workers else None,
    )
    sums: dict[str, float] = {}
    began = time.monotonic()
    for step, batch in zip(range(start, steps), loader, strict=False):
        for group in optimizer.param_groups:
            group["lr"] = rate * schedule(step, steps)
        net.train()
        parts = loss_of(net, batch)
        loss = parts["score"] + parts["box"]
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 10.0)
        optimizer.step()
        average(mean, net, min(0.998, (step + 1) / (step + 10)))
        for name, value in parts.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        if (step + 1) % 100 == 0 or step + 1 == steps:
            row: dict[str, Any] = {"step": step + 1, "seconds": round(time.monotonic() - began)}
            row |= {k: round(v / 100.0, 4) for k, v in sums.items()}
            sums = {}
            if tune is not None and ((step + 1) % tune_every == 0 or step + 1 == steps):
                row |= tune(mean.eval())
            note(out / "curve.csv", row)
            torch.save(
                {
                    "net": net.state_dict(),
                    "mean": mean.state_dict(),
                    "optimizer": optimizer.state_dict(),
                    "step": step + 1,
                    "start_from": begun_from,
                },
                state_path.with_suffix(".part"),
            )
            state_path.with_suffix(".part").replace(state_path)
    return mean.eval()


def schedule(step: int, steps: int, warm_up: int = 200) -> float:
    """Return the share of the highest learning rate: a ramp, then half a cosine.

    Args:
        step: From 0.
        steps: In all.
        warm_up: Length of the ramp.
    """
    warm = min(1.0, (step + 1) / warm_up)
    return warm * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * step / steps)))


def average(mean: nn.Module, net: nn.Module, keep: float) -> None:
    """Move averaged weights towards a network's.

    Args:
        mean: The averaged network, changed.
        net: The network.
        keep: Share of the old mean that is kept.
    """
    with torch.no_grad():
        for own, new in zip(mean.state_dict().values(), net.state_dict().values(), strict=True):
            if own.dtype.is_floating_point:
                own.mul_(keep).add_(new, alpha=1.0 - keep)
            else:
                own.copy_(new)


_COLUMNS = ("step", "seconds", "score", "box", "ap10", "ap25", "ap50", "recall95")


def note(path: Path, row: dict[str, Any], columns: tuple[str, ...] = _COLUMNS) -> None:
    """Add a row to a curve, and print it.

    Args:
        path: The curve, CSV.
        row: Values by column.
        columns: Of the curve.
    """
    fresh = not path.exists()
    with path.open("a", newline="") as stream:
        writer = csv.DictWriter(stream, columns)
        if fresh:
            writer.writeheader()
        writer.writerow(row)
    print(" ".join(f"{k} {v}" for k, v in row.items()), flush=True)
