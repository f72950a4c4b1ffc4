"""Fit the network of the second look to candidates of the first."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F
from torch.utils.data import DataLoader

from hsvaos.detect.levels import LEVEL_CHANNELS
from hsvaos.detect.network_input import CHANNELS
from hsvaos.detect.second_look import LOOK_PX, SECOND_CHANNELS, corner_of, facts_of, patch
from train.classes import ByClass
from train.fit import average, note, overlap, schedule, short_floats
from train.look_batches import LookBatches, nobodies
from train.looks import Look
from train.second_net import SecondNet

BATCH = 96

_LEVELS = slice(len(CHANNELS), len(SECOND_CHANNELS))
_RECOLOURED = (0.12, 0.1, 0.12)
"""Standard deviations of shifts of lightness and of both ratios of colours."""

_TRUST = 0.3
"""Share of a score's aim that is the teacher's, where there is one; the rest is the truth."""

_PEOPLE = 0.4
"""Share of candidates in a batch that are people."""


class Candidates(LookBatches):
    """Endless batches of candidates; people drawn by occlusion class."""

    def batches(self, looks: Sequence[Look], rng: np.random.Generator) -> Iterator[Any]:
        """Yield batches as `collate` makes them, without end."""
        right = ByClass(
            (k, i, str(one.classes[one.whose[i]]))
            for k, one in enumerate(looks)
            for i in np.flatnonzero(one.whose >= 0).tolist()
        )
        wrong = nobodies(looks)
        # what nearly passes for a person teaches most
        weight = np.sqrt([looks[k].scores[i] for k, i in wrong])
        weight /= weight.sum()
        while True:
            people = int(rng.binomial(BATCH, _PEOPLE))
            chosen = right.drawn(people, rng)
            chosen += [wrong[i] for i in rng.choice(len(wrong), BATCH - people, p=weight)]
            yield collate([drawn(looks[k], i, rng) for k, i in chosen])


def drawn(look: Look, index: int, rng: np.random.Generator) -> tuple[Any, ...]:
    """Return one candidate, varied.

    Args:
        look: Of which map.
        index: Which candidate.
        rng: Draws the variations.

    Returns:
        Patch, facts, box, person's box (or zeros), whether it is one, and the teacher's score (or
        -1).
    """
    box = look.boxes[index].astype(np.float32)
    sides = box[2:] - box[:2]
    box = box + np.tile(rng.normal(0.0, 0.06, 2) * sides, 2).astype(np.float32)
    grown = 0.5 * sides * rng.normal(0.0, 0.06, 2)
    box = box + np.concatenate([-grown, grown]).astype(np.float32)
    who = int(look.whose[index])
    person = look.people[who] if who >= 0 else np.zeros(4, np.float32)
    side, zoom = LOOK_PX, 1.0
    if rng.uniform() < 0.5:
        side = int(rng.integers(72, 90))
        zoom = LOOK_PX / side
    view = np.moveaxis(patch((np.moveaxis(look.layers, 2, 0),), box, side), 0, 2)
    origin = np.tile(corner_of(box, side), 2)
    box, person = box - origin, person - origin
    if side != LOOK_PX:
        view = cv2.resize(view, (LOOK_PX, LOOK_PX), interpolation=cv2.INTER_LINEAR)
        box, person = ((one + 0.5) * zoom - 0.5 for one in (box, person))
    if rng.uniform() < 0.5:
        view = view.transpose(1, 0, 2)
        box, person = box[[1, 0, 3, 2]], person[[1, 0, 3, 2]]
    if rng.uniform() < 0.5:
        view = view[:, ::-1]
        box, person = (_mirrored(one, 0) for one in (box, person))
    if rng.uniform() < 0.5:
        view = view[::-1]
        box, person = (_mirrored(one, 1) for one in (box, person))
    view = np.ascontiguousarray(view)
    if rng.uniform() < 0.5:
        factors = np.exp(rng.normal(0.0, 0.12, view.shape[2])).astype(np.float32)
        factors[_LEVELS] = 1.0
        factors[[CHANNELS.index("rays"), CHANNELS.index("ground rays"), -1]] = 1.0
        view *= factors
    _recolour(view[..., _LEVELS], rng)
    score = look.scores[index : index + 1]
    taught = -1.0 if look.taught is None else look.taught[index]
    return view, facts_of(box[None], score)[0], box, person, who >= 0, taught


def _recolour(levels: NDArray[np.float32], rng: np.random.Generator) -> None:
    """Change exposure, white balance and saturation, as other cameras would; in place."""
    shown = levels != 0.0
    light, *balance = rng.normal(0.0, _RECOLOURED)
    shift = np.array([light, *balance], dtype=np.float32)
    saturation = np.float32(np.exp(rng.normal(0.0, 0.15)))
    factors = np.array([1.0, saturation, saturation], dtype=np.float32)
    pictures = len(LEVEL_CHANNELS) // len(shift)
    levels *= np.tile(factors, pictures)
    levels += np.tile(shift, pictures) * shown


def _mirrored(box: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    out = box.copy()
    out[axis], out[axis + 2] = LOOK_PX - 1 - box[axis + 2], LOOK_PX - 1 - box[axis]
    return out


def collate(parts: Sequence[tuple[Any, ...]]) -> tuple[Tensor, ...]:
    """Return what several candidates are, as tensors.

    Args:
        parts: From `drawn`.

    Returns:
        Patches (B, C, side, side), facts, boxes, people's boxes, whether there is one, and the
        teacher's scores.
    """
    views, *others = (np.stack(column) for column in zip(*parts, strict=True))
    return torch.from_numpy(views).permute(0, 3, 1, 2), *(
        torch.from_numpy(np.asarray(one, dtype=np.float32)) for one in others
    )


def loss_of(net: SecondNet, batch: tuple[Tensor, ...]) -> dict[str, Tensor]:
    """Return the parts of the loss; a person's score shall be the overlap that its box reaches.

    Args:
        net: The network.
        batch: From `collate`.
    """
    views, facts, boxes, people, is_person, taught = batch
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=short_floats()):
        logits, shifts = net(views, facts)
    logits, shifts = logits.float(), shifts.float()
    own = is_person > 0.0
    iou, giou = overlap(shifted(boxes[own], shifts[own]), people[own])
    target = torch.zeros_like(logits)
    target[own] = 0.5 + 0.5 * iou.detach().clamp(0.0, 1.0)
    target = torch.where(taught >= 0.0, torch.lerp(target, taught, _TRUST), target)
    score = F.binary_cross_entropy_with_logits(logits, target)
    return {"score": score, "box": (1.0 - giou).mean()}


def shifted(boxes: Tensor, shifts: Tensor) -> Tensor:
    """Return boxes as `hsvaos.detect.second_look.moved` does, with gradients."""
    sides = boxes[:, 2:] - boxes[:, :2]
    middle = 0.5 * (boxes[:, :2] + boxes[:, 2:]) + shifts[:, :2] * sides
    half = 0.5 * sides * torch.exp(shifts[:, 2:].clamp(-1.5, 1.5))
    return torch.cat([middle - half, middle + half], dim=1)


def fit_second(
    paths: Sequence[Path],
    out: Path,
    *,
    steps: int,
    seed: int = 1,
    workers: int = 1,
    rate: float = 2e-3,
    tune: Any = None,
    tune_every: int = 500,
    start: SecondNet | None = None,
) -> SecondNet:
    """Train on candidates; goes on where it was stopped.

    Args:
        paths: Of looks.
        out: Folder for the state and the curve.
        steps: Batches.
        seed: Of weights and of what is drawn.
        workers: Processes that draw candidates.
        rate: Highest learning rate.
        tune: Called with the averaged network; returns figures for the curve.
        tune_every: Steps between such calls.
        start: A network whose training goes on, changed; by default a new one.
    """
    torch.manual_seed(seed)
    out.mkdir(parents=True, exist_ok=True)
    net = (start or SecondNet()).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    mean = deepcopy(net)
    optimizer = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=1e-2)
    state_path, start = out / "second_state.pt", 0
    if state_path.exists():
        state = torch.load(state_path)
        for name, part in (("net", net), ("mean", mean), ("optimizer", optimizer)):
            part.load_state_dict(state[name])
        start = int(state["step"])
    loader = DataLoader(
        Candidates(paths, seed + 1000 * start),
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
        loss = parts["score"] + 0.6 * parts["box"]
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(net.parameters(), 10.0)
        optimizer.step()
        average(mean, net, min(0.998, (step + 1) / (step + 10)))
        for name, value in parts.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        last = step + 1 == steps
        if (step + 1) % 100 == 0 or last:
            row: dict[str, Any] = {"step": step + 1, "seconds": round(time.monotonic() - began)}
            row |= {k: round(v / (step % 100 + 1), 4) for k, v in sums.items()}
            sums = {}
            if tune is not None and ((step + 1) % tune_every == 0 or last):
                row |= tune(mean.eval())
            note(out / "second_curve.csv", row)
            part_path = state_path.with_suffix(".part")
            parts_of = {"net": net, "mean": mean, "optimizer": optimizer}
            kept = {name: part.state_dict() for name, part in parts_of.items()}
            torch.save({**kept, "step": step + 1}, part_path)
            part_path.replace(state_path)
    return mean.eval()
