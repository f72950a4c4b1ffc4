"""Real thermal integral pictures as JKU published them: an open field with one person.

Pictures 29 to 78 of `AOS for Own Projects/data/open_field/results` in JKU's repository
(https://github.com/JKU-ICG/AOS), 512 x 512, 8 bit, of 30 photos each. The person comes into view in
picture 57; before there is nobody. The boxes are those of what is brighter than .45 of the person's
peak, background taken off. Beside the person lies a smaller warm spot of which nobody knows what it
is: it need not be found, and may be.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

FIRST, LAST = 29, 78

# fmt: off
PERSON_PX = {
    57: (256, 473, 288, 506), 58: (257, 451, 290, 485), 59: (258, 426, 291, 461),
    60: (260, 401, 292, 436), 61: (261, 380, 293, 415), 62: (262, 364, 293, 400),
    63: (264, 342, 295, 378), 64: (266, 325, 297, 361), 65: (268, 305, 299, 342),
    66: (271, 286, 301, 322), 67: (275, 257, 306, 294), 68: (279, 234, 310, 271),
    69: (283, 211, 313, 247), 70: (286, 190, 316, 227), 71: (288, 170, 319, 206),
    72: (289, 149, 321, 186), 73: (291, 129, 321, 167), 74: (293, 107, 322, 144),
    75: (294, 85, 324, 122), 76: (295, 62, 326, 101), 77: (298, 46, 328, 85),
    78: (301, 20, 331, 57),
}
# fmt: on
"""Box of the person by picture."""

SPOT_FROM_PERSON_PX = (-166.0, 27.0)
_SPOT_HALF_PX = 14.0


def field_pictures(
    folder: Path,
) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.bool_]]]:
    """Yield pictures (512, 512), boxes (K, 4) [px], and which of them need not be found (K,).

    Args:
        folder: With the pictures 0_29.png to 0_78.png.

    Raises:
        FileNotFoundError: If one is missing.
    """
    for number in range(FIRST, LAST + 1):
        path = folder / f"0_{number}.png"
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise FileNotFoundError(f"{path}: expected a picture of JKU's open field")
        boxes = np.zeros((0, 4))
        if number in PERSON_PX:
            person = np.array(PERSON_PX[number], dtype=np.float64)
            spot = 0.5 * (person[:2] + person[2:]) + SPOT_FROM_PERSON_PX
            boxes = np.stack([person, np.tile(spot, 2) + _SPOT_HALF_PX * np.array([-1, -1, 1, 1])])
        yield np.asarray(picture), boxes, np.arange(len(boxes)) == 1
