"""Make the pictures of the README from the demo flight.

hsvaos demo -o hsvaos-demo && python docs/make_pictures.py hsvaos-demo
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

import hsvaos
from hsvaos.demo import demo_flight
from hsvaos.report.figures import (
    colour_map,
    encode,
    of_ground,
    photo_picture,
    shining_limits,
    stretch,
)

SIDE = 360
HERE = Path(__file__).parent


def fitted(picture: np.ndarray) -> np.ndarray:
    """RGB on white, SIDE pixels wide."""
    shown = cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(np.float32)
    alpha = shown[..., 3:] / 255.0
    return shown[..., :3] * alpha + 255.0 * (1.0 - alpha)


def main() -> None:
    """Write docs/before_after.jpg."""
    result = hsvaos.run(demo_flight())
    view = result.main
    seen = view.rays > 0
    low, high = shining_limits(view.rarity_map, seen)
    ground, of_it = view.extra["ground"]
    pictures = [
        photo_picture(result.photo),
        stretch(view.integral, view.footprint),
        stretch(ground, of_ground(of_it)),
        colour_map(view.rarity_map, seen, low, high, "inferno"),
    ]
    margin = ((0, 0), (4, 4), (0, 0))
    row = np.hstack([np.pad(fitted(p), margin, constant_values=255) for p in pictures])
    opaque = np.dstack([row, np.full(row.shape[:2], 255.0)]).round().astype(np.uint8)
    (HERE / "before_after.jpg").write_bytes(encode(opaque, ".jpg", 80))


if __name__ == "__main__":
    main()
