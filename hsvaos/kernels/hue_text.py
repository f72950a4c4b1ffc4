"""Hue of a pixel, and whether a hue cut takes it, as C for loops in vectors on the CPU.

Compilers take RGB of three bytes apart badly. Such pixels are first spread to words by shuffles;
the loop behind it reads `words`, other pixels at `from`.
"""

from dataclasses import dataclass
from string import Template
from typing import Any

import warp as wp


@dataclass(frozen=True)
class PixelText:
    """C of one type of pixels.

    Args:
        source: Type of a channel at `from`.
        channels: Red, green and blue of pixel i, as stored.
        good: Whether a colour is finite; whole numbers always are.
        words: Whether the loop reads spread pixels, at `words`.
    """

    source: str
    channels: tuple[str, str, str]
    good: str = "true"
    words: bool = False


_AS_STORED = ("from[3 * i]", "from[3 * i + 1]", "from[3 * i + 2]")

PIXELS = {
    wp.vec3ub: PixelText(
        "unsigned char", tuple(f"(int)(words[i] >> {8 * k} & 255u)" for k in range(3)), words=True
    ),
    wp.vec3us: PixelText("unsigned short", _AS_STORED),
    wp.vec3: PixelText(
        *("float", _AS_STORED),
        "(red - red == 0.0f) & (green - green == 0.0f) & (blue - blue == 0.0f)",
    ),
}
"""By the type of the Warp array."""

SPREAD = """
    const auto spread = [](const unsigned char* rgb, unsigned* words, int count) {
        typedef unsigned char u8x16 __attribute__((vector_size(16)));
        int i = 0;
        for (; i + 6 <= count; i += 4) {  // four pixels lie in 12 of the 16 bytes that are read
            u8x16 bytes;
            __builtin_memcpy(&bytes, rgb + 3 * i, 16);
            bytes = __builtin_shufflevector(
                bytes, bytes, 0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
            __builtin_memcpy(words + i, &bytes, 16);
        }
        for (; i < count; ++i) {
            words[i] = (unsigned)rgb[3 * i] | (unsigned)rgb[3 * i + 1] << 8
                | (unsigned)rgb[3 * i + 2] << 16;
        }
    };
"""
"""C of `spread`: RGB of bytes to words, the fourth byte undefined."""

# the hexcone of kernels.color.rgb_to_hsv_pixel without branches
_CHROMA = Template("""
            const float red = (float)$red * scale[0];
            const float green = (float)$green * scale[1];
            const float blue = (float)$blue * scale[2];
            const float most = red > green ? red : green, fewer = red > green ? green : red;
            const float value = most > blue ? most : blue;
            const float chroma = value - (fewer < blue ? fewer : blue);
            const bool good = $good;
""")

_HUE = """
            const float turn = chroma > 0.0f ? 60.0f / chroma : 0.0f;
            float hue = (red - green) * turn + 240.0f;
            hue = value == green ? (blue - red) * turn + 120.0f : hue;
            hue = value == red ? (green - blue) * turn : hue;
            hue += hue < 0.0f ? 360.0f : 0.0f;
            hue -= hue >= 360.0f ? 360.0f : 0.0f;
"""

# distances of hues times chroma, so that nothing is divided
_CUT = """
            const float from_blue = 60.0f * (red - green) + (240.0f - mean) * chroma;
            const float from_green = 60.0f * (blue - red) + (120.0f - mean) * chroma;
            const float apart = green - blue;
            const float from_red = 60.0f * apart + (apart < 0.0f ? 360.0f - mean : -mean) * chroma;
            float away = value == green ? from_green : from_blue;
            away = value == red ? from_red : away;
            away = away < 0.0f ? -away : away;
            const float other = 360.0f * chroma - away;
            away = ((circular != 0) & (other < away)) ? other : away;
            const bool grey_cut = (circular == 0) & (mean <= half_width);
            const bool cut = chroma > 0.0f ? away <= half_width * chroma : grey_cut;
"""


def _chroma_text(pixel: Any) -> str:
    red, green, blue = PIXELS[pixel].channels
    return _CHROMA.substitute(red=red, green=green, blue=blue, good=PIXELS[pixel].good)


def hue_text(pixel: Any) -> str:
    """Return C that takes pixel i to its `value`, `chroma`, `hue` [deg] and whether it is `good`.

    It uses `scale`, three factors on the channels.
    """
    return _chroma_text(pixel) + _HUE


def cut_text(pixel: Any) -> str:
    """Return C that takes pixel i to its `value`, whether it is `good` and whether it is `cut`.

    It uses `scale`, as `hue_text` does, and `circular`, `mean` and `half_width` of the cut [deg].
    """
    return _chroma_text(pixel) + _CUT
