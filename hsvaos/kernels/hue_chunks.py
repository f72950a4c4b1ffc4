"""Hue histogram and hue cut on the CPU: the loops of `hue_mask` in vectors, a chunk at a time."""

from functools import lru_cache
from string import Template
from typing import Any

import warp as wp

from hsvaos.hue_statistics import BINS
from hsvaos.kernels.device import bands, launch
from hsvaos.kernels.hue_text import PIXELS, SPREAD, cut_text, hue_text

wp.set_module_options({"enable_backward": False})

CHUNK = 32768
"""Pixels of a chunk: a multiple of the loops' blocks, few enough to share out to threads."""

_BLOCKS = """
    enum { BLOCK = 1024 };
    const int start = chunk * $chunk;
    const int size = count - start < $chunk ? count - start : $chunk;
    alignas(64) unsigned words[BLOCK];
"""

_BLOCK = """
        const int some = size - block < BLOCK ? size - block : BLOCK;
        const $source* from = (const $source*)rgb.data + (size_t)3 * (start + block);
        $prepare
"""
"""Where the pixels of a block are."""

_CUT = Template("""{
    #pragma clang fp contract(fast)
    $blocks
    for (int block = 0; block < size; block += BLOCK) {
        $block
        const unsigned char* use = valid.data + start + block;
        unsigned char* to = mask.data + start + block;
        #pragma clang loop vectorize(enable) vectorize_width(16)
        for (int i = 0; i < some; ++i) {
            $cut
            to[i] = (good & !cut) ? use[i] : 0;
        }
    }
}""")

_COUNT = Template("""{
    #pragma clang fp contract(fast)
    enum { BINS = $bins };
    $blocks
    // two histograms take turns: a pixel need not wait for its neighbour of the same hue
    long long counts[2 * BINS] = {}, total = 0, seen = 0;
    for (int block = 0; block < size; block += BLOCK) {
        $block
        const unsigned char* use = valid.data + start + block;
        alignas(64) int bins[BLOCK + 1], amounts[BLOCK + 1];
        int chromas = 0, valids = 0;
        #pragma clang loop vectorize(enable) vectorize_width(16)
        for (int i = 0; i < some; ++i) {
            $hue
            const bool counts_in = good & (use[i] != 0);
            const float place = hue * (float)(BINS / 360.0);
            const float amount = chroma * 65535.0f + 0.5f;
            bins[i] = counts_in ? (place < BINS - 1.0f ? (int)place : BINS - 1) : 0;
            amounts[i] = counts_in ? (int)(amount < 1e6f ? amount : 1e6f) : 0;
            chromas += amounts[i];
            valids += counts_in ? 1 : 0;
            amounts[i] = circular != 0 ? amounts[i] : (counts_in ? 1 : 0);
        }
        bins[some] = amounts[some] = 0;
        for (int i = 0; i < some; i += 2) {
            counts[bins[i]] += amounts[i];
            counts[BINS + bins[i + 1]] += amounts[i + 1];
        }
        total += chromas;
        seen += valids;
    }
    long long* to = (long long*)sums.data + (size_t)band * (BINS + 2);
    for (int i = 0; i < BINS; ++i) to[i] += counts[i] + counts[BINS + i];
    to[BINS] += total;
    to[BINS + 1] += seen;
}""")


def in_blocks(template: Template, pixel: Any, **parts: Any) -> str:
    """Fill in what all loops over the blocks of a chunk share.

    Args:
        template: C with `$blocks` before the loop over blocks and `$block` at its start, where
            `chunk`, `count` and `rgb` are known; a block has `some` pixels from `start + block` on.
        pixel: Warp type of the pixels.
        parts: Whatever else the template asks for.
    """
    text = PIXELS[pixel]
    block = Template(_BLOCK).substitute(
        source=text.source, prepare="spread(from, words, some);" if text.words else ""
    )
    blocks = (SPREAD if text.words else "") + Template(_BLOCKS).substitute(chunk=CHUNK)
    return template.substitute(blocks=blocks, block=block, **parts)


@lru_cache
def _cut_kernel(pixel: Any) -> Any:
    @wp.func_native(in_blocks(_CUT, pixel, cut=cut_text(pixel)))
    def cut_chunk(
        chunk: int,
        count: int,
        scale: wp.vec3,
        circular: int,
        mean: float,
        half_width: float,
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        mask: wp.array(dtype=wp.uint8),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def cut_kernel(
        offset: int,
        band: int,
        count: int,
        scale: wp.vec3,
        circular: int,
        mean: float,
        half_width: float,
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        mask: wp.array(dtype=wp.uint8),
    ):
        cut_chunk(wp.tid() + offset, count, scale, circular, mean, half_width, rgb, valid, mask)

    return cut_kernel


@lru_cache
def _count_kernel(pixel: Any) -> Any:
    @wp.func_native(in_blocks(_COUNT, pixel, hue=hue_text(pixel), bins=BINS))
    def count_chunk(
        chunk: int,
        band: int,
        count: int,
        scale: wp.vec3,
        circular: int,
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        sums: wp.array2d(dtype=wp.int64),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def count_kernel(
        offset: int,
        band: int,
        count: int,
        scale: wp.vec3,
        circular: int,
        rgb: wp.array(dtype=pixel),
        valid: wp.array(dtype=wp.uint8),
        sums: wp.array2d(dtype=wp.int64),
    ):
        count_chunk(wp.tid() + offset, band, count, scale, circular, rgb, valid, sums)

    return count_kernel


def count_bands(size: int, device: Any) -> int:
    """Return how many accumulators `count_hues` needs for images of a size [px]."""
    return len(bands(-(-size // CHUNK), device, 1))


def count_hues(rgb: Any, size: int, inputs: list[Any], device: Any) -> None:
    """Add the hues of an image to accumulators, one a band of chunks.

    Args:
        rgb: Warp array (H * W) of pixels.
        size: H * W.
        inputs: scale, circular, rgb, valid and sums, as `hue_mask._histogram_kernel` takes them.
        device: The CPU.
    """
    launch(_count_kernel(rgb.dtype), -(-size // CHUNK), [size, *inputs], device, 1)


def cut_hues(rgb: Any, size: int, inputs: list[Any], device: Any) -> None:
    """Write the mask of an image.

    Args:
        rgb: Warp array (H * W) of pixels.
        size: H * W.
        inputs: scale, circular, mean, half width, rgb, valid and mask, as `hue_mask._mask_kernel`.
        device: The CPU.
    """
    launch(_cut_kernel(rgb.dtype), -(-size // CHUNK), [size, *inputs], device, 1)
