"""Fit the fragment network to crops of photos."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from train.fit import average, note, schedule, short_floats
from train.fragment_crops import SIDE_PX, FragmentCrops, as_input, read_crops
from train.fragment_net import FragmentModel

BATCH = 48
_RATE = 3e-3
_SIDES = (64, 80, 112, 128)
"""Half of the batches are scaled from 96 pixels to one of these."""

_GROUND_SHARE = 0.1
"""Of the ground's loss, which is ten times that of people: they are few pixels."""

_COLUMNS = ("step", "seconds", "loss", "held_out")


def fit_fragments(
    crops: list[Path], held_out: list[Path], out: Path, *, steps: int, seed: int = 1
) -> FragmentModel:
    """Train on crops; goes on where it was stopped.

    Args:
        crops: Files that `make_crops` wrote.
        held_out: The same of flights that only measure the loss.
        out: Folder for the state and the curve, `fragment_curve.csv`.
        steps: Batches in all.
        seed: Of first weights and of batches.

    Returns:
        The averaged weights.

    Raises:
        ValueError: If there are no crops.
    """
    if not crops:
        raise ValueError("expected crops of some flights, got none")
    out.mkdir(parents=True, exist_ok=True)
    flights, unseen = ([read_crops(path) for path in some] for some in (crops, held_out))
    torch.manual_seed(seed)
    net, mean, start = FragmentModel(), FragmentModel(), 0
    net = net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    mean.load_state_dict(net.state_dict())
    optimizer = torch.optim.AdamW(net.parameters(), lr=_RATE, weight_decay=1e-3)
    state_path = out / "fragment_state.pt"
    if state_path.exists():
        state = torch.load(state_path)
        net.load_state_dict(state["net"])
        mean.load_state_dict(state["mean"])
        optimizer.load_state_dict(state["optimizer"])
        start = int(state["step"])
    rng = np.random.default_rng([seed, start, 303])
    began, total, counted = time.monotonic(), 0.0, 0
    for step in range(start, steps):
        for group in optimizer.param_groups:
            group["lr"] = _RATE * schedule(step, steps, 100)
        net.train()
        loss = _loss(net, *_batch(flights, rng))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimizer.step()
        average(mean, net, min(0.998, (step + 1) / (step + 10)))
        total, counted = total + float(loss.detach()), counted + 1
        if (step + 1) % 100 == 0 or step + 1 == steps:
            row = {"step": step + 1, "seconds": round(time.monotonic() - began)}
            row["loss"] = round(total / counted, 5)  # type: ignore[assignment]
            total, counted = 0.0, 0
            if unseen and ((step + 1) % 500 == 0 or step + 1 == steps):
                row["held_out"] = round(loss_on(mean, unseen), 5)  # type: ignore[assignment]
            note(out / "fragment_curve.csv", row, _COLUMNS)
            state = {
                "net": net.state_dict(),
                "mean": mean.state_dict(),
                "optimizer": optimizer.state_dict(),
                "step": step + 1,
            }
            torch.save(state, state_path.with_suffix(".part"))
            state_path.with_suffix(".part").replace(state_path)
    return mean.eval()


def loss_on(net: FragmentModel, flights: list[FragmentCrops]) -> float:
    """Return the mean loss over crops as they are.

    Args:
        net: The network.
        flights: Their crops.
    """
    net.eval()
    sums, count = 0.0, 0
    with torch.no_grad():
        for crops in flights:
            for k in range(0, len(crops.inputs), BATCH):
                x = torch.from_numpy(as_input(crops.inputs[k : k + BATCH]))
                shown = torch.from_numpy(crops.shown[k : k + BATCH].astype(np.float32))
                sums += len(x) * float(_loss(net, x, shown))
                count += len(x)
    return sums / max(count, 1)


def _batch(flights: list[FragmentCrops], rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Draw crops: turned, scaled, brighter or darker, rarer or more common."""
    inputs, labels = [], []
    for _ in range(BATCH):
        crops = flights[rng.integers(len(flights))]
        k = rng.integers(len(crops.inputs))
        x, shown = crops.inputs[k], crops.shown[k]
        if rng.uniform() < 0.5:
            x, shown = x.transpose(0, 2, 1), shown.transpose(0, 2, 1)
        if rng.uniform() < 0.5:
            x, shown = x[:, ::-1], shown[:, ::-1]
        if rng.uniform() < 0.5:
            x, shown = x[:, :, ::-1], shown[:, :, ::-1]
        inputs.append(x)
        labels.append(shown)
    whole = as_input(np.stack(inputs))
    size = (BATCH, 1, 1, 1)
    light = 0.15 * rng.standard_normal(size) + 0.06 * rng.standard_normal((BATCH, 3, 1, 1))
    surprise = (
        np.exp(0.12 * rng.standard_normal(size)),
        0.15 * rng.standard_normal((BATCH, 2, 1, 1)),
    )
    x = torch.from_numpy(whole)
    wanted = torch.from_numpy(np.stack(labels).astype(np.float32))
    if rng.uniform() < 0.5:
        x, wanted = _scaled(x, wanted, int(rng.choice(_SIDES)))
    x[:, :3] += torch.from_numpy(light.astype(np.float32))
    x[:, 3:] *= torch.from_numpy(surprise[0].astype(np.float32))
    x[:, 3:] += torch.from_numpy(surprise[1].astype(np.float32))
    return x.to(memory_format=torch.channels_last), wanted


def _scaled(x: Tensor, wanted: Tensor, side: int) -> tuple[Tensor, Tensor]:
    assert side != SIDE_PX
    how = {"mode": "bilinear", "antialias": True, "align_corners": False}
    small = F.interpolate(x, (side, side), **how)  # type: ignore[arg-type]
    return small, F.interpolate(wanted, (side, side), **how)  # type: ignore[arg-type]


def _loss(net: FragmentModel, x: Tensor, wanted: Tensor) -> Tensor:
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=short_floats()):
        logits = net(x)
    losses = F.binary_cross_entropy_with_logits(logits.float(), wanted, reduction="none")
    person, ground = losses.mean(dim=(0, 2, 3))
    return person + _GROUND_SHARE * ground
