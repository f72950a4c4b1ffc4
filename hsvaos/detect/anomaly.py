"""Finds without trained weights: person-sized peaks of the rarity map."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hsvaos.detect.detections import Detections
from hsvaos.settings import DetectSettings

_BLUR = 1.0 / 6.0
"""Sigma of the blur in lengths of a person: 30 cm for 1.8 m, half as wide as its shoulders."""

_SURROUND = 10.0 / 3.0
"""Side of the surround in lengths of a person: 6 m for 1.8 m."""

_CLIP = 3.0
"""Deviations beyond which a value counts no more in its own surround."""

_CLIPPINGS = 3
"""Times that is done: in the corner of a view a person is a good part of what surrounds it."""

_HALF = 0.5
"""A find reaches as far as its z stays above this share of its peak."""

_MIN_VALID = 0.25
"""Share of the surround that must be seen for its mean and deviation to count."""


def local_z(
    values: ArrayLike, rays: ArrayLike, gsd_m: float, person_m: float = 1.8, min_rays: float = 2.0
) -> NDArray[np.float32]:
    """Return by how many deviations of its surround each pixel of a map stands out.

    The map is blurred by a Gaussian of 30 cm; from it the mean over a box of 6 m is taken and the
    rest divided by the deviation in that box (lengths for a person of 1.8 m). Mean and deviation
    are those of the values clipped at 3 deviations, three times over. Pixels without rays count in
    neither. Where the blur reaches beyond what is seen, z is lowered by the root of its share.

    Args:
        values: Shape (H, W), the rarity map.
        rays: Shape (H, W), rays of each pixel.
        gsd_m: Ground sampling distance [m/px].
        person_m: Length of a person [m].
        min_rays: Rays from which a pixel counts.

    Returns:
        Shape (H, W), float32; 0 where too few rays or surroundings are known.
    """
    seen = (np.asarray(rays) >= max(min_rays, 1e-6)).astype(np.float32)
    image = np.asarray(values, dtype=np.float32) * seen
    sigma = max(_BLUR * person_m / gsd_m, 0.8)
    box = max(3, 2 * round(_SURROUND * person_m / gsd_m / 2.0) + 1)
    box = min(box, 2 * max(image.shape) + 1)

    def blurred(part: Any) -> Any:
        return cv2.GaussianBlur(part, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)

    def mean(part: Any) -> Any:
        return cv2.boxFilter(part, cv2.CV_64F, (box, box), borderType=cv2.BORDER_CONSTANT)

    known_part = blurred(seen)  # at a border fewer pixels are averaged, which is noisier
    smooth = blurred(image) / np.maximum(known_part, 1e-3) * seen
    # shares are of the whole box, so that half-known surroundings at a border are told apart
    weight = mean(seen)
    safe = np.maximum(weight, 1e-6)

    def moments(part: Any) -> tuple[Any, Any]:
        centre = mean(part) / safe
        return centre, np.sqrt(np.maximum(mean(part * part) / safe - centre**2, 0.0))

    # a strong target would raise the deviation of its own surround: it is clipped for that
    wide = smooth.astype(np.float64)
    centre, deviation = moments(wide)
    for _ in range(_CLIPPINGS):
        centre, deviation = moments(np.minimum(wide, centre + _CLIP * deviation) * seen)
    known = (seen > 0.0) & (weight > _MIN_VALID) & (deviation > 1e-7)
    z = np.sqrt(known_part) * (smooth - centre) / np.where(known, deviation, 1.0)
    return np.where(known, z, 0.0).astype(np.float32)


def find_persons(
    values: NDArray[np.float32], rays: NDArray[np.float32], gsd_m: float, settings: DetectSettings
) -> Detections:
    """Return the person-sized peaks of a rarity map, strongest first; scores are local z.

    Views finer than a 45th of a person are halved, thirded, ... first: the blur takes that anyway.

    Args:
        values: Shape (H, W), float32, the rarity map.
        rays: Shape (H, W), float32, rays of each pixel.
        gsd_m: Ground sampling distance [m/px].
        settings: Threshold, size and number.
    """
    step = max(1, int(settings.person_m / 45.0 / gsd_m))
    height, width = values.shape
    size = (max(1, width // step), max(1, height // step))
    if step > 1:
        cover = cv2.resize(rays, size, interpolation=cv2.INTER_AREA)
        total = cv2.resize(values * rays, size, interpolation=cv2.INTER_AREA)
        values = (total / np.maximum(cover, 1e-6)).astype(np.float32)
        rays = cover.astype(np.float32)
    coarse = gsd_m * step
    z = local_z(values, rays, coarse, settings.person_m, settings.min_rays)
    found = find_peaks(z, coarse, settings)
    scale = np.array([width / size[0], height / size[1]] * 2)
    boxes = (found.boxes_xyxy + 0.5) * scale - 0.5  # pixel centres lie at integers
    return Detections(boxes.astype(np.float32), found.scores, found.class_ids)


def find_peaks(z: NDArray[np.float32], gsd_m: float, settings: DetectSettings) -> Detections:
    """Return the person-sized peaks of a map of local z, strongest first.

    A peak is the greatest value within half a person's length; its box holds the connected pixels
    above half the peak, within one person's length of it.

    Args:
        z: Shape (H, W), float32, from `local_z`.
        gsd_m: Ground sampling distance [m/px].
        settings: Threshold, size and number.
    """
    reach = max(1, round(settings.person_m / gsd_m / 2.0))
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    top = (z >= cv2.dilate(z, window)) & (z >= settings.min_z)
    rows, columns = np.nonzero(top)
    order = np.argsort(-z[rows, columns], kind="stable")
    boxes: list[tuple[float, float, float, float]] = []
    scores: list[float] = []
    taken = np.zeros(z.shape, bool)
    for i in order:
        row, column = int(rows[i]), int(columns[i])
        if taken[row, column]:  # a plateau has many tops, one find is enough
            continue
        r0, c0 = max(0, row - 2 * reach), max(0, column - 2 * reach)
        part = z[r0 : row + 2 * reach + 1, c0 : column + 2 * reach + 1]
        above = (part >= _HALF * z[row, column]).astype(np.uint8)
        _, labels = cv2.connectedComponents(above, connectivity=8)
        own = labels == labels[row - r0, column - c0]
        taken[r0 : row + 2 * reach + 1, c0 : column + 2 * reach + 1] |= own
        ys, xs = np.nonzero(own)
        boxes.append(
            (
                float(c0 + xs.min()) - 0.5,
                float(r0 + ys.min()) - 0.5,
                float(c0 + xs.max()) + 0.5,
                float(r0 + ys.max()) + 0.5,
            )
        )
        scores.append(float(z[row, column]))
        if len(scores) == settings.max_finds:
            break
    return Detections(
        np.array(boxes, dtype=np.float32).reshape(-1, 4),
        np.array(scores, dtype=np.float32),
        np.zeros(len(scores), dtype=np.int64),
    )
