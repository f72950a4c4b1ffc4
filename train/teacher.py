"""What an earlier second look says of candidates it never saw, to be learnt from beside the truth.

The truth is 0 or 1 whether a person shows well or not at all; a network that was trained on other
flights says how well, and a new one learns fewer candidates by heart. Hinton 2015, "Distilling the
knowledge in a neural network".
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hsvaos.detect.network import Network
from hsvaos.detect.second_look import SECOND_CHANNELS
from train.looks import Look, patches_of, read_look, taught_path


def teach(path: Path, teacher: Path) -> str:
    """Write a teacher's scores beside a look, if that was not done; return the look's name.

    Args:
        path: Of a look.
        teacher: An exported second look, with channels of today's or fewer.
    """
    target = taught_path(path)
    if not target.exists():
        part = target.with_suffix(".part.npy")
        np.save(part, opinions(Network(teacher, threads=1), read_look(path)))
        part.replace(target)
    return path.stem


def opinions(teacher: Network, look: Look) -> NDArray[np.float32]:
    """Return scores (N,) of a look's candidates, as the teacher was trained: without its shift.

    Args:
        teacher: An exported second look.
        look: The look.

    Raises:
        ValueError: If the teacher's metadata names other channels.
    """
    named = teacher.metadata.get("channels", "").split(",")
    unknown = sorted(set(named) - set(SECOND_CHANNELS))
    if unknown:
        raise ValueError(f"{teacher.name}: expected channels of a second look, got {unknown[0]!r}")
    shift = float(json.loads(teacher.metadata.get("training", "{}")).get("shift", 0.0))
    channels = [SECOND_CHANNELS.index(name) for name in named]
    found = [np.zeros(0, np.float32)]
    for views, facts in patches_of(look, channels):
        found.append(teacher.run({teacher.picture.name: views, "facts": facts})["scores"])
    scores = np.concatenate(found).clip(1e-6, 1.0 - 1e-6)
    logits = np.log(scores / (1.0 - scores)) - shift
    return (1.0 / (1.0 + np.exp(-logits))).astype(np.float32)
