"""Leaf textures drawn by rule: alpha, brightness and share of wood, with levels of detail."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.kernels.raster import TILE_BYTES, TILE_LEVELS, TILE_SIZE

_DRAWN = 512
"""Side at which tiles are drawn before they are averaged down [px]."""

Canvas = NDArray[np.uint8]


class Tile(IntEnum):
    """The tiles of the atlas. A card's u runs across the twig (right), v along it (down)."""

    OVATE = 0
    LOBED = 1
    SMALL = 2
    NEEDLES = 3
    TWIGS = 4
    GRASS = 5
    FERN = 6
    FALLEN = 7


def _leaf_outline(length: float, width: float, kind: str, rng: np.random.Generator) -> NDArray:  # type: ignore[type-arg]
    t = np.linspace(0.0, 1.0, 24)
    if kind == "lobed":
        half = width * np.sin(np.pi * t**0.7) * (0.62 + 0.38 * np.cos(t * 6.5 * np.pi) ** 2)
    elif kind == "small":
        half = width * np.sin(np.pi * t**0.75)
    else:
        half = width * np.sin(np.pi * t**0.85) ** 0.9
    half = half * (1.0 + 0.06 * rng.standard_normal(t.size))
    x = np.concatenate([t, t[::-1]]) * length
    y = np.concatenate([half, -half[::-1]]) * 0.5
    return np.stack([x, y], axis=1)


def _put_leaf(
    canvas: Canvas,
    base: NDArray[np.float64],
    angle: float,
    outline: NDArray[np.float64],
    brightness: int,
) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = outline @ turn.T + base
    dark = max(brightness - 34, 0)
    tip = base + turn[:, 0] * outline[:, 0].max()
    half = len(points) // 2
    cv2.fillPoly(canvas, [np.rint(points).astype(np.int32)], (255, brightness, 0))
    # One half of the blade lies a little darker, with a pale midrib between.
    side = np.concatenate([points[:half], [tip], [base]])
    cv2.fillPoly(canvas, [np.rint(side).astype(np.int32)], (255, dark, 0))
    cv2.line(
        canvas,
        np.rint(base).astype(int).tolist(),
        np.rint(tip).astype(int).tolist(),
        (255, min(brightness + 40, 255), 0),
        2,
    )


def _branched(
    canvas: Canvas,
    rng: np.random.Generator,
    kind: str,
    leaves: int,
    length: tuple[float, float],
    width: float,
) -> None:
    """Draw a twig with side twigs, `leaves` on each, with gaps between the leaves."""
    middle = _DRAWN / 2
    shoots = [(np.array([middle, 4.0]), np.pi / 2 + rng.uniform(-0.08, 0.08), 0.80 * _DRAWN)]
    for k in range(5):
        t = 0.08 + 0.14 * k
        side = 1.0 if k % 2 else -1.0
        turn = np.pi / 2 + side * rng.uniform(0.75, 1.05)
        start = np.array([middle, _DRAWN * t])
        shoots.append((start, turn, _DRAWN * (0.46 - 0.28 * t)))
    for start, angle, reach in shoots:
        heading = np.array([np.cos(angle), np.sin(angle)])
        end = start + heading * reach
        cv2.line(canvas, start.astype(int).tolist(), end.astype(int).tolist(), (255, 120, 255), 5)
        for k in rng.permutation(leaves):
            t = (k + 0.8) / leaves
            side = 1.0 if k % 2 else -1.0
            turn = angle + side * rng.uniform(0.4, 1.2) * (1.0 - 0.5 * t)
            size = rng.uniform(*length) * _DRAWN
            _put_leaf(
                canvas,
                start + heading * reach * t,
                float(turn),
                _leaf_outline(size, size * width, kind, rng),
                int(rng.uniform(105, 205)),
            )


def _ovate(canvas: Canvas, rng: np.random.Generator) -> None:
    _branched(canvas, rng, "ovate", 9, (0.15, 0.21), 0.50)


def _lobed(canvas: Canvas, rng: np.random.Generator) -> None:
    _branched(canvas, rng, "lobed", 6, (0.18, 0.26), 0.85)


def _small(canvas: Canvas, rng: np.random.Generator) -> None:
    _branched(canvas, rng, "small", 12, (0.09, 0.13), 0.70)


def _needles(canvas: Canvas, rng: np.random.Generator) -> None:
    def comb(base: NDArray[np.float64], tip: NDArray[np.float64], reach: float) -> None:
        cv2.line(canvas, base.astype(int).tolist(), tip.astype(int).tolist(), (255, 110, 255), 7)
        along = tip - base
        angle = float(np.arctan2(along[1], along[0]))
        for t in np.linspace(0.05, 1.0, int(np.hypot(*along) / 5.0)):
            for side in (-1.0, 1.0):
                turn = angle + side * rng.uniform(0.5, 1.0)
                start = base + along * t
                end = start + reach * rng.uniform(0.7, 1.1) * np.array([np.cos(turn), np.sin(turn)])
                cv2.line(
                    canvas,
                    start.astype(int).tolist(),
                    end.astype(int).tolist(),
                    (255, int(rng.uniform(105, 200)), 0),
                    4,
                )

    root = np.array([_DRAWN / 2, 4.0])
    comb(root, np.array([_DRAWN / 2, _DRAWN * 0.93]), 34.0)
    for k in range(9):
        t = 0.06 + 0.085 * k
        start = np.array([_DRAWN / 2, _DRAWN * t])
        side = -1.0 if k % 2 else 1.0
        reach = _DRAWN * (0.46 - 0.30 * t)
        comb(start, start + reach * np.array([side * 0.86, 0.5]), 30.0)
        comb(start, start + reach * 0.9 * np.array([-side * 0.86, 0.5]), 30.0)


def _twigs(canvas: Canvas, rng: np.random.Generator) -> None:
    def branch(start: NDArray[np.float64], angle: float, length: float, level: int) -> None:
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        tone = int(rng.uniform(110, 190))
        cv2.line(
            canvas,
            start.astype(int).tolist(),
            end.astype(int).tolist(),
            (255, tone, 0),
            max(9 - 2 * level, 3),
        )
        if level == 3:
            return
        for k in range(4):
            t = 0.25 + 0.22 * k
            side = 1.0 if k % 2 else -1.0
            branch(
                start + (end - start) * t,
                angle + side * rng.uniform(0.4, 0.9),
                length * rng.uniform(0.4, 0.6),
                level + 1,
            )

    branch(np.array([_DRAWN / 2, 2.0]), np.pi / 2 + rng.uniform(-0.1, 0.1), _DRAWN * 0.85, 0)


def _grass(canvas: Canvas, rng: np.random.Generator) -> None:
    for _ in range(46):
        x = rng.uniform(0.25, 0.75) * _DRAWN
        lean = rng.uniform(-0.35, 0.35) * _DRAWN
        height = rng.uniform(0.5, 0.97) * _DRAWN
        t = np.linspace(0.0, 1.0, 12)
        middle = np.stack([x + lean * t**1.8, height * t], axis=1)
        half = np.stack([9.0 * (1.0 - t) + 1.5, np.zeros(12)], axis=1)
        blade = np.concatenate([middle - half, (middle + half)[::-1]])
        tone = int(rng.uniform(105, 200))
        cv2.fillPoly(canvas, [np.rint(blade).astype(np.int32)], (255, tone, 0))


def _fern(canvas: Canvas, rng: np.random.Generator) -> None:
    centre = _DRAWN / 2
    cv2.line(canvas, (int(centre), 2), (int(centre), int(_DRAWN * 0.97)), (255, 130, 60), 6)
    for k in range(30):
        t = 0.04 + 0.031 * k
        reach = _DRAWN * 0.44 * np.sin(np.pi * min(t * 0.85 + 0.16, 1.0)) ** 0.8
        for side in (-1.0, 1.0):
            outline = _leaf_outline(float(reach), 23.0, "ovate", rng)
            angle = np.pi / 2 - side * (np.pi / 2 - 0.35)
            base = np.array([centre, _DRAWN * t])
            _put_leaf(canvas, base, float(angle), outline, int(rng.uniform(125, 185)))


def _fallen(canvas: Canvas, rng: np.random.Generator) -> None:
    for _ in range(5):
        base = rng.uniform(0.2, 0.8, 2) * _DRAWN
        angle = float(rng.uniform(0.0, 2.0 * np.pi))
        outline = _leaf_outline(0.34 * _DRAWN, 0.24 * _DRAWN, "lobed", rng)
        _put_leaf(canvas, base, angle, outline, int(rng.uniform(110, 200)))


_DRAWERS: dict[Tile, Callable[[Canvas, np.random.Generator], None]] = {
    Tile.OVATE: _ovate,
    Tile.LOBED: _lobed,
    Tile.SMALL: _small,
    Tile.NEEDLES: _needles,
    Tile.TWIGS: _twigs,
    Tile.GRASS: _grass,
    Tile.FERN: _fern,
    Tile.FALLEN: _fallen,
}


def _levels(drawn: Canvas) -> NDArray[np.uint8]:
    """Return all levels of a tile, shape (TILE_BYTES, 3): alpha 0 or 255, brightness, wood."""
    alpha = drawn[..., 0].astype(np.float64) / 255.0
    covered = alpha.mean()
    levels = []
    for level in range(TILE_LEVELS):
        side = TILE_SIZE >> level
        size = (side, side)
        mean_alpha = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
        colour = cv2.resize(drawn[..., 1:] * alpha[..., None], size, interpolation=cv2.INTER_AREA)
        colour = colour / np.maximum(mean_alpha, 1e-3)[..., None]
        # Cutting at this quantile keeps the covered share, so far-away trees do not thin out.
        cut = np.quantile(mean_alpha, 1.0 - covered)
        texels = np.empty((side, side, 3), dtype=np.uint8)
        texels[..., 0] = np.where(mean_alpha > cut, 255, 0)
        texels[..., 1:] = np.clip(np.rint(colour), 0, 255)
        levels.append(texels.reshape(-1, 3))
    return np.concatenate(levels)


def draw_atlas(seed: int) -> NDArray[np.uint8]:
    """Draw every tile.

    Args:
        seed: Of the random leaf positions.

    Returns:
        Shape (tiles TILE_BYTES, 3), uint8: alpha, brightness (160 is neutral), wood.
    """
    atlas = np.empty((len(Tile), TILE_BYTES, 3), dtype=np.uint8)
    for tile in Tile:
        canvas = np.zeros((_DRAWN, _DRAWN, 3), dtype=np.uint8)
        _DRAWERS[tile](canvas, np.random.default_rng([seed, 11, int(tile)]))
        atlas[tile] = _levels(canvas)
    return atlas.reshape(-1, 3)
