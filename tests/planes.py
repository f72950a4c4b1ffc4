"""A small flight made in a second: someone lies on the ground under three layers of leaves.

Everything is a textured horizontal plane: the ground, the person on it, and leaf layers with holes
above. Each photo is the planes seen through a pinhole camera, the lower painted over by the higher.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hsvaos.camera import Camera
from hsvaos.flight import Flight, Frame, Origin

Texture = NDArray[np.float32]

PHOTOS_NORTH, PHOTOS_EAST = 6, 5
HEIGHT_M = 20.0
SIDE_M = 40.0
"""Side of every plane, centred on the origin [m]."""

TEXTURE_PX = 2000
PERSON_AT = (0.6, -0.4)
"""North and east of the hidden person's middle [m]."""

LAYERS_M = (4.0, 6.5, 9.0)
"""Heights of the leaf layers above the ground [m]."""

COVER = 0.58
"""Share of a layer that leaves cover: of three layers about one ray in fourteen gets through."""


@dataclass(frozen=True, eq=False)
class Layer:
    """A textured plane.

    Args:
        down_m: Its place, world NED [m].
        colour: Shape (T, T, 3), float32 RGB 0..1; row 0 is north, column 0 is west.
        alpha: Shape (T, T), float32, 1 where it is opaque.
    """

    down_m: float
    colour: Texture
    alpha: Texture


def planes_flight(seed: int = 1) -> tuple[Flight, Iterator[NDArray[np.uint8]], dict[str, Any]]:
    """Return the flight, its photos one by one, and the truth.

    Args:
        seed: Of everything random.
    """
    rng = np.random.default_rng(seed)
    camera = Camera.from_fov(512, 512, 70.0)
    poses = [
        _pose(north, east, rng)
        for north in np.linspace(-5.0, 5.0, PHOTOS_NORTH)
        for east in np.linspace(-4.0, 4.0, PHOTOS_EAST)
    ]
    frames = tuple(
        Frame(f"demo_{i:03d}.jpg", Path(f"demo_{i:03d}.jpg"), pose, t_s=2.0 * i)
        for i, pose in enumerate(poses)
    )
    flight = Flight("planes", camera, frames, Origin(48.3369, 14.3191, 300.0), ground_down_m=0.0)
    layers = make_layers(rng)
    photos = (_photo(camera, pose, layers, rng) for pose in poses)
    north, east = PERSON_AT
    person = {"id": 0, "north_m": north, "east_m": east, "down_m": 0.0, "occlusion": "full"}
    return flight, photos, {"people": [person]}


def make_layers(rng: np.random.Generator) -> list[Layer]:
    """Return the planes from the ground up.

    Args:
        rng: Source of everything random.
    """
    opaque = np.ones((TEXTURE_PX, TEXTURE_PX), np.float32)
    layers = [Layer(0.0, _ground(rng), opaque)]
    colour, alpha = _person()
    layers.append(Layer(0.0, colour, alpha))
    layers += [_leaves(-height, rng) for height in LAYERS_M]
    return layers


def _pose(north: float, east: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """A camera looking down with the top of the photo to the north, a little off, as drones are."""
    angles = np.radians(rng.normal(0.0, 2.0, 3))
    wobble, _ = cv2.Rodrigues(angles)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ wobble
    pose[:3, 3] = [north + rng.normal(0, 0.2), east + rng.normal(0, 0.2), -HEIGHT_M]
    return pose


def _noise(rng: np.random.Generator, cell_px: int) -> Texture:
    """Smooth noise of mean 0 and deviation 1 with features of about `cell_px`."""
    small = rng.normal(size=(TEXTURE_PX // cell_px + 3,) * 2).astype(np.float32)
    big = cv2.resize(small, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC)
    return np.asarray((big - big.mean()) / big.std(), dtype=np.float32)


def _rgb(hue: Any, saturation: Any, value: Any) -> Texture:
    hsv = np.stack(np.broadcast_arrays(hue % 360.0, saturation, value), axis=-1)
    hsv[..., 1:] = hsv[..., 1:].clip(0.0, 1.0)
    return np.asarray(cv2.cvtColor(hsv.astype(np.float32), cv2.COLOR_HSV2RGB))


def _ground(rng: np.random.Generator) -> Texture:
    """Brown forest floor in shade."""
    hue = 38.0 + 6.0 * _noise(rng, 40) + 4.0 * _noise(rng, 6)
    value = 0.20 + 0.035 * _noise(rng, 60) + 0.03 * _noise(rng, 4)
    return _rgb(hue, 0.40 + 0.06 * _noise(rng, 12), value)


def _person() -> tuple[Texture, Texture]:
    """A lying figure 1.75 m long: red jacket, blue trousers, head and hands."""
    picture = np.zeros((TEXTURE_PX, TEXTURE_PX, 3), np.float32)
    alpha = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
    red, blue, skin = (0.62, 0.09, 0.11), (0.12, 0.17, 0.48), (0.66, 0.47, 0.38)
    limbs = [  # from and to along and across the body [m], thickness [m], colour
        ((0.10, 0.00), (0.52, 0.00), 0.40, red),
        ((0.48, 0.22), (0.12, 0.42), 0.13, red),
        ((0.48, -0.22), (0.40, -0.60), 0.13, red),
        ((0.02, 0.10), (-0.80, 0.20), 0.17, blue),
        ((0.02, -0.10), (-0.74, -0.26), 0.17, blue),
        ((0.78, 0.02), (0.80, 0.02), 0.22, skin),
        ((0.06, 0.45), (0.06, 0.45), 0.10, skin),
        ((0.38, -0.66), (0.38, -0.66), 0.10, skin),
    ]
    turn = np.radians(35.0)
    scale = TEXTURE_PX / SIDE_M
    for start, stop, thick, colour in limbs:
        ends = []
        for along, across in (start, stop):
            north = PERSON_AT[0] + along * np.cos(turn) - across * np.sin(turn)
            east = PERSON_AT[1] + along * np.sin(turn) + across * np.cos(turn)
            ends.append((round((east + SIDE_M / 2) * scale), round((SIDE_M / 2 - north) * scale)))
        width = max(1, round(thick * scale))
        cv2.line(picture, ends[0], ends[1], colour, width, cv2.LINE_AA)
        cv2.line(alpha, ends[0], ends[1], 1.0, width, cv2.LINE_AA)
    return picture, alpha


def _leaves(down_m: float, rng: np.random.Generator) -> Layer:
    """Clumps of leaves, each leaf of its own green, with holes of all sizes between."""
    field = 0.7 * _noise(rng, 55) + 0.7 * _noise(rng, 18) + 0.5 * _noise(rng, 7)
    alpha = (field > np.quantile(field, 1.0 - COVER)).astype(np.float32)
    hue = 105.0 + 5.0 * _noise(rng, 70) + 5.0 * _noise(rng, 9)
    value = 0.42 + 0.08 * _noise(rng, 20) + 0.08 * _noise(rng, 5)
    return Layer(down_m, _rgb(hue, 0.55 + 0.06 * _noise(rng, 9), value), alpha)


def _photo(
    camera: Camera, pose: NDArray[np.float64], layers: list[Layer], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """What the camera sees, with sensor noise; shape (H, W, 3), uint8 RGB."""
    size = (camera.width, camera.height)
    picture = np.zeros((camera.height, camera.width, 3), np.float32)
    world_from_texture = np.array(
        [
            [0.0, -SIDE_M / TEXTURE_PX, SIDE_M / 2],
            [SIDE_M / TEXTURE_PX, 0.0, -SIDE_M / 2],
            [0, 0, 1],
        ]
    )
    rotation, centre = pose[:3, :3].T, pose[:3, 3]
    for layer in layers:
        offset = np.array([0.0, 0.0, layer.down_m]) - centre
        plane = np.column_stack([rotation[:, 0], rotation[:, 1], rotation @ offset])
        homography = camera.matrix() @ plane @ world_from_texture
        colour = cv2.warpPerspective(layer.colour, homography, size, flags=cv2.INTER_AREA)
        alpha = cv2.warpPerspective(layer.alpha, homography, size, flags=cv2.INTER_AREA)
        picture += alpha[..., None] * (colour - picture)
    picture += rng.normal(0.0, 0.008, picture.shape).astype(np.float32)
    return np.rint(255.0 * picture.clip(0.0, 1.0)).astype(np.uint8)
