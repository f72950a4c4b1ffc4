"""Rarity bins of 8-bit RGB on the CPU: the loops of `rarity_bins` in vectors, a block at a time."""

from functools import lru_cache
from string import Template
from typing import Any

import warp as wp

from hsvaos.kernels.device import launch
from hsvaos.kernels.hue_chunks import CHUNK, in_blocks
from hsvaos.kernels.lab import CURVE
from hsvaos.rarity_model import CHROMA_BINS, CHROMA_RANGE, LIGHTNESS_BINS, LIGHTNESS_FLOOR

wp.set_module_options({"enable_backward": False})

# what rarity_bins.colour_bin makes of lab.lab_of_light, without branches; uncontracted, so that
# every colour has the very bin that it has there
_BINS = Template("""{
    #pragma clang fp contract(off)
    $blocks
    alignas(64) int bins[BLOCK];
    const float* lights = light.data;
    const float* curves = curve.data;
    const auto cube_root = [=](float t) {
        t = t > 0.0f ? t : 0.0f;
        const float place = (t < 1.0f ? t : 1.0f) * $last.0f;
        const int found = (int)place, left = found < $last - 1 ? found : $last - 1;
        const float part = place - (float)left;
        return curves[left] * (1.0f - part) + curves[left + 1] * part;
    };
    const auto clamped = [](float place, int most) {
        const int whole = (int)place;
        const int low = whole > 0 ? whole : 0;
        return low < most ? low : most;
    };
    for (int block = 0; block < size; block += BLOCK) {
        $block
        #pragma clang loop vectorize(enable) vectorize_width(16)
        for (int i = 0; i < some; ++i) {
            const float r = lights[words[i] & 255u];
            const float g = lights[256 + (words[i] >> 8 & 255u)];
            const float b = lights[512 + (words[i] >> 16 & 255u)];
            const float x = cube_root((0.412453f * r + 0.357580f * g + 0.180423f * b) / 0.950456f);
            const float y = cube_root(0.212671f * r + 0.715160f * g + 0.072169f * b);
            const float z = cube_root((0.019334f * r + 0.119193f * g + 0.950227f * b) / 1.088754f);
            const float lightness = 116.0f * y - 16.0f;
            const float scale = 40.0f / (lightness > $floor ? lightness : $floor);
            const int level = clamped(lightness * ($levels / 100.0f), $levels - 1);
            const int a = clamped((500.0f * (x - y) * scale + $range) * $per_bin, $bins - 1);
            const int d = clamped((200.0f * (y - z) * scale + $range) * $per_bin, $bins - 1);
            bins[i] = (level * $bins + a) * $bins + d;
        }
        $use
    }
}""")

_COUNT = """
        const unsigned char* use = valid.data + start + block;
        long long* to = (long long*)counts.data + (size_t)band * counts.shape[1];
        float* keep = kept.data ? kept.data + start + block : nullptr;
        for (int i = 0; i < some; ++i) {
            if (use[i] != 0) ++to[bins[i]];
        }
        for (int i = 0; keep && i < some; ++i) keep[i] = use[i] != 0 ? (float)bins[i] : -1.0f;
"""

_WEIGH = Template("""
        const unsigned char* use = valid.data + start + block;
        $scalar* to = weights.data + start + block;
        for (int i = 0; i < some; ++i) {
            const $scalar weight = table.data[bins[i]];
            to[i] = use[i] == 255 ? weight : ($scalar)((float)weight * (float)use[i] / 255.0f);
        }
""")


def _text(use: str) -> str:
    return in_blocks(
        _BINS,
        wp.vec3ub,
        last=CURVE - 1,
        floor=f"{LIGHTNESS_FLOOR}f",
        levels=LIGHTNESS_BINS,
        range=f"{CHROMA_RANGE}f",
        per_bin=f"{CHROMA_BINS / (2.0 * CHROMA_RANGE)}f",
        bins=CHROMA_BINS,
        use=use,
    )


@wp.func_native(_text(_COUNT))
def _count_chunk(
    chunk: int,
    band: int,
    count: int,
    light: wp.array(dtype=float),
    curve: wp.array(dtype=float),
    rgb: wp.array(dtype=wp.vec3ub),
    valid: wp.array(dtype=wp.uint8),
    counts: wp.array2d(dtype=wp.int64),
    kept: wp.array(dtype=float),
): ...


@wp.kernel(module="unique", enable_backward=False)
def _count_kernel(
    offset: int,
    band: int,
    count: int,
    light: wp.array(dtype=float),
    curve: wp.array(dtype=float),
    rgb: wp.array(dtype=wp.vec3ub),
    valid: wp.array(dtype=wp.uint8),
    counts: wp.array2d(dtype=wp.int64),
    kept: wp.array(dtype=float),
):
    _count_chunk(wp.tid() + offset, band, count, light, curve, rgb, valid, counts, kept)


@lru_cache
def _weigh_kernel(scalar: Any) -> Any:
    names = {wp.uint8: "unsigned char", wp.float32: "float"}

    @wp.func_native(_text(_WEIGH.substitute(scalar=names[scalar])))
    def weigh_chunk(
        chunk: int,
        count: int,
        light: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        rgb: wp.array(dtype=wp.vec3ub),
        valid: wp.array(dtype=wp.uint8),
        table: wp.array(dtype=scalar),
        weights: wp.array(dtype=scalar),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def weigh_kernel(
        offset: int,
        band: int,
        count: int,
        light: wp.array(dtype=float),
        curve: wp.array(dtype=float),
        rgb: wp.array(dtype=wp.vec3ub),
        valid: wp.array(dtype=wp.uint8),
        table: wp.array(dtype=scalar),
        weights: wp.array(dtype=scalar),
    ):
        weigh_chunk(wp.tid() + offset, count, light, curve, rgb, valid, table, weights)

    return weigh_kernel


def count_bytes(pixels: Any, inputs: list[Any]) -> None:
    """Add the colours of an 8-bit RGB image to a histogram.

    Args:
        pixels: Warp array (H * W) of vec3ub, on the CPU.
        inputs: light, curve, rgb, valid, counts and kept, as `rarity_bins._count_kernel`.
    """
    _launch(_count_kernel, pixels, inputs)


def weigh_bytes(pixels: Any, table: Any, inputs: list[Any]) -> None:
    """Write the weight of every pixel of an 8-bit RGB image.

    Args:
        pixels: Warp array (H * W) of vec3ub, on the CPU.
        table: Warp array of the weight of each bin, uint8 or float32.
        inputs: light, curve, rgb, valid, table and weights, as `rarity._weight_kernel`.
    """
    _launch(_weigh_kernel(table.dtype), pixels, inputs)


def _launch(kernel: Any, pixels: Any, inputs: list[Any]) -> None:
    launch(kernel, -(-pixels.size // CHUNK), [pixels.size, *inputs], pixels.device, 1)
