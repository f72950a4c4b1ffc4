"""RGB to HSV on the CPU: the loop of `color.rgb_to_hsv` in vectors, a chunk at a time."""

from functools import lru_cache
from string import Template
from typing import Any

import warp as wp

from hsvaos.kernels.device import launch
from hsvaos.kernels.hue_chunks import CHUNK, in_blocks
from hsvaos.kernels.hue_text import hue_text

wp.set_module_options({"enable_backward": False})

_TO_HSV = Template("""{
    #pragma clang fp contract(fast)
    $blocks
    for (int block = 0; block < size; block += BLOCK) {
        $block
        float* to = (float*)hsv.data + (size_t)3 * (start + block);
        #pragma clang loop vectorize(enable) vectorize_width(16)
        for (int i = 0; i < some; ++i) {
            $hue
            to[3 * i] = hue;
            to[3 * i + 1] = chroma > 0.0f ? chroma / value : 0.0f;
            to[3 * i + 2] = value;
        }
    }
}""")


@lru_cache
def _to_hsv_kernel(pixel: Any) -> Any:
    @wp.func_native(in_blocks(_TO_HSV, pixel, hue=hue_text(pixel)))
    def to_hsv_chunk(
        chunk: int,
        count: int,
        scale: wp.vec3,
        rgb: wp.array(dtype=pixel),
        hsv: wp.array(dtype=wp.vec3),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def to_hsv_kernel(
        offset: int,
        band: int,
        count: int,
        scale: wp.vec3,
        rgb: wp.array(dtype=pixel),
        hsv: wp.array(dtype=wp.vec3),
    ):
        to_hsv_chunk(wp.tid() + offset, count, scale, rgb, hsv)

    return to_hsv_kernel


def convert_to_hsv(pixels: Any, white: float, hsv: Any) -> None:
    """Write hue [deg], saturation and value of an image.

    Args:
        pixels: Warp array (H * W) of RGB pixels, on the CPU.
        white: Value of full white.
        hsv: Warp array (H * W) of vec3, written.
    """
    inputs = [pixels.size, wp.vec3(1.0 / white), pixels, hsv]
    launch(_to_hsv_kernel(pixels.dtype), -(-pixels.size // CHUNK), inputs, pixels.device, 1)
