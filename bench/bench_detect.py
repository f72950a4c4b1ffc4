"""The person network on one view and on the 117 views of a flight; OpenCV runs the same network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import warp as wp

from bench.harness import SMOKE, Contenders, size
from hsvaos import Detector
from hsvaos.benchmark.scenes import photos
from hsvaos.detect.anomaly import find_persons
from hsvaos.detect.fragments import FragmentNet
from hsvaos.detect.layouts import own_channels
from hsvaos.detect.network import Network
from hsvaos.detect.network_input import CHANNELS, network_input
from hsvaos.detect.second_look import (
    PACKAGED_SECOND_LOOK,
    SECOND_CHANNELS,
    SecondLook,
    facts_of,
    patch,
)
from hsvaos.detect.yolo import PACKAGED
from hsvaos.fragment_input import FragmentInput
from hsvaos.kernels.rarity import rarity_model
from hsvaos.settings import DetectSettings

VIEWS = 2 if SMOKE else 117
LOOKS = 4 if SMOKE else 100


def layers(count: int, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Integral images, rays and rarity maps of a forest without people."""
    images = photos(count, side).astype(np.float32)
    rng = np.random.default_rng(2)
    rays = rng.integers(20, 60, images.shape[:3]).astype(np.float32)
    return images, rays, rng.exponential(0.05, images.shape[:3]).astype(np.float32)


def one_view(side: int) -> Callable[[], Contenders]:
    def contenders() -> Contenders:
        images, rays, rarity = (part[0] for part in layers(1, size(side)))
        detector = Detector(provider="cpu")
        alone = Network(PACKAGED, "cpu")
        planes = network_input(images, rays, rarity)[
            None, [CHANNELS.index(n) for n in own_channels(alone)]
        ]
        network = cv2.dnn.readNetFromONNX(str(PACKAGED))

        def opencv() -> None:
            network.setInput(planes, alone.picture.name)
            network.forward(network.getUnconnectedOutLayersNames())

        return {
            "hsvaos Detector": lambda: detector.detect(images, footprint=rays, rarity=rarity),
            "  of it preparing the input": lambda: network_input(images, rays, rarity),
            "  of it the network": lambda: alone.run({alone.picture.name: planes}),
            "OpenCV dnn, the network alone": opencv,
            "rarity peaks, no network": lambda: find_persons(rarity, rays, 0.05, DetectSettings()),
        }

    return contenders


def many_views() -> Contenders:
    images, rays, rarity = layers(VIEWS, size(512))
    detector = Detector(provider="cpu")
    return {
        "hsvaos detect_batch": lambda: detector.detect_batch(
            images, footprints=list(rays), rarities=list(rarity)
        ),
        "one view after the other": lambda: [
            detector.detect(image, footprint=cover, rarity=rare)
            for image, cover, rare in zip(images, rays, rarity, strict=True)
        ],
    }


def pieces() -> Contenders:
    held: Any = wp.array(photos(2, size(1024)), dtype=wp.uint8, device="cpu")
    inputs = FragmentInput(held, rarity_model(held))
    net, planes = FragmentNet(provider="cpu"), inputs(0)
    return {
        "hsvaos FragmentNet": lambda: net.of_planes(inputs(0)),
        "  of it preparing the input": lambda: inputs(0),
        "  of it the network": lambda: net.of_planes(planes),
    }


def second_looks() -> Contenders:
    rng = np.random.default_rng(3)
    planes = rng.normal(size=(len(SECOND_CHANNELS), size(1024), size(1024))).astype(np.float32)
    corners = rng.uniform(0, size(1024) - 40, (LOOKS, 2))
    boxes = np.concatenate([corners, corners + rng.uniform(15, 40, (LOOKS, 2))], axis=1)
    boxes, scores = boxes.astype(np.float32), np.full(LOOKS, 0.5, np.float32)
    second, alone = SecondLook(provider="cpu"), Network(PACKAGED_SECOND_LOOK, "cpu")
    views = np.stack([patch((planes,), box) for box in boxes])
    feeds = {alone.picture.name: views, "facts": facts_of(boxes, scores)}
    network = cv2.dnn.readNetFromONNX(str(PACKAGED_SECOND_LOOK))

    def opencv() -> None:
        for name, values in feeds.items():
            network.setInput(values, name)
        network.forward(network.getUnconnectedOutLayersNames())

    return {
        "hsvaos SecondLook": lambda: second((planes,), boxes, scores),
        "  of it the network": lambda: alone.run(feeds),
        "OpenCV dnn, the network alone": opencv,
    }


RACES: dict[str, Callable[[], Contenders]] = {
    "people in a view of 512 px": one_view(512),
    "people in a view of 1024 px": one_view(1024),
    f"people in {VIEWS} views of 512 px": many_views,
    "pieces of people in a photo of 1024 px": pieces,
    f"a second look at {LOOKS} boxes": second_looks,
}


def test_race(benchmark: Any, contender: tuple[str, str]) -> None:
    benchmark.group = contender[0]
    benchmark(RACES[contender[0]]()[contender[1]])
