"""Hue cut, brightening and packing in one pass over the photos, on the CPU.

After the statistics (`hue_mask.measure_hue`) every pixel is read once: its mask and its packed
word, brightened and levelled, are written, and no copy of the photos lies between.
"""

import math
from functools import lru_cache
from string import Template
from typing import Any

import warp as wp

from hsvaos.hue_statistics import HueStatistics
from hsvaos.kernels.arrays import (
    Stack,
    check_gains,
    device_of,
    output_array,
    pixel_view,
    valid_array,
)
from hsvaos.kernels.color import check_brightening
from hsvaos.kernels.device import ROW_GRAIN, in_vectors, launch
from hsvaos.kernels.hue_text import SPREAD, cut_text
from hsvaos.kernels.packing import Packed, PackJob, empty_packed, is_mask

wp.set_module_options({"enable_backward": False})

# (value / target)^power by the exponent and two polynomials: within 3e-6 of its value
_POWER = """
            const float part = value * job.over_target;
            const unsigned bits = __builtin_bit_cast(unsigned, part);
            const float t = __builtin_bit_cast(float, (bits & 0x7fffffu) | 0x3f800000u) - 1.0f;
            const float log = (float)((int)(bits >> 23) - 127) + t * (1.4426933f
                + t * (-0.7211628f + t * (0.4777064f + t * (-0.33924912f + t * (0.21559035f
                + t * (-0.096067372f + t * 0.020490588f))))));
            const float wanted = log * job.power;
            const float power = wanted < job.most ? wanted : job.most;
            const int whole = (int)power;
            const float s = power - (float)whole;
            float gain = __builtin_bit_cast(float, (whole + 127) << 23) * (1.0f + s * (0.69314758f
                + s * (0.24020688f + s * (0.055658655f + s * (0.0091968073f
                + s * 0.0017896657f)))));
            gain = ((value > 0.0f) & (part < 1.0f)) ? gain * 255.0f : 255.0f;
            const float top = 255.5f;
            const float r = red * gain + 0.5f, g = green * gain + 0.5f, b = blue * gain + 0.5f;
            const unsigned word = (unsigned)(int)(r < top ? r : top)
                | (unsigned)(int)(g < top ? g : top) << 8
                | (unsigned)(int)(b < top ? b : top) << 16 | 255u << 24;
"""

_AS_IT_IS = """
            const unsigned word = words[i] | 255u << 24;
"""

_ROW = Template("""{
    #pragma clang fp contract(fast)
    const int width = job.pack.width, height = job.pack.height;
    const int y = line == 0 ? 0 : (line > height ? height - 1 : line - 1);
    const unsigned char* from = (const unsigned char*)rgb.data + (size_t)3 * y * width;
    const unsigned char* use = valid.data + (size_t)y * job.valid_step;
    unsigned char* to = mask.data + (size_t)y * width;
    unsigned* words = job.pack.words.data + (size_t)frame * job.pack.frame_stride
        + (size_t)line * job.pack.row_stride + 1;
    const wp::vec3 scale = job.scale;
    const float mean = job.mean, half_width = job.half_width;
    const int circular = job.circular;
    $spread
    spread(from, words, width);
    #pragma clang loop vectorize(enable) vectorize_width(16)
    for (int i = 0; i < width; ++i) {
        $cut
        $word
        const unsigned keep = (good & !cut) ? use[i] : 0;
        to[i] = (unsigned char)keep;
        words[i] = keep != 0 ? word : 0u;
    }
    words[-1] = words[0];
    words[width] = words[width - 1];
}""")


@wp.struct
class CutJob:
    """What all rows of a photo share."""

    pack: PackJob
    scale: wp.vec3
    circular: int
    mean: float
    half_width: float
    valid_step: int
    over_target: float
    power: float
    most: float


@lru_cache
def _cut_and_pack_kernel(brightened: bool) -> Any:
    word = _POWER if brightened else _AS_IT_IS

    @wp.func_native(_ROW.substitute(spread=SPREAD, cut=cut_text(wp.vec3ub), word=word))
    def cut_and_pack_row(
        line: int,
        frame: int,
        job: CutJob,
        rgb: wp.array(dtype=wp.vec3ub),
        valid: wp.array(dtype=wp.uint8),
        mask: wp.array(dtype=wp.uint8),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def cut_and_pack_kernel(
        offset: int,
        band: int,
        frame: int,
        job: CutJob,
        rgb: wp.array(dtype=wp.vec3ub),
        valid: wp.array(dtype=wp.uint8),
        mask: wp.array(dtype=wp.uint8),
    ):
        cut_and_pack_row(wp.tid() + offset, frame, job, rgb, valid, mask)

    return cut_and_pack_kernel


def cut_and_pack(
    images: Any,
    stats: list[HueStatistics],
    *,
    valid: Any = None,
    gains: Any = None,
    brightening: dict[str, float] | None = None,
    out: Any = None,
    photos: Packed | None = None,
) -> tuple[Any, Packed] | None:
    """Make the masks of a hue cut and the packed photos that an `Integrator` takes, in one pass.

    Args:
        images: Shape (N, H, W, 3), uint8 RGB, on the CPU.
        stats: N statistics, one an image, from `measure_hue`.
        valid: User masks that multiply in.
        gains: Shape (N, 3), factors on R, G and B of each image, as when measured.
        brightening: target_value, gamma and max_gain of `color.brighten`: kept dark pixels are
            packed brightened and levelled by the gains. None to pack photos as they are.
        out: Shape (N, H, W), uint8, masks written in place; new if None.
        photos: Packed photos to write over, from an earlier call; new if None.

    Returns:
        masks, Warp array (N, H, W), uint8, and the packed photos. None where this pass does not
        apply: photos of another type or place, and user masks with values between.

    Raises:
        ValueError: If a parameter is out of range, or shapes do not fit.
    """
    stack = Stack(images, device_of(images))
    if not in_vectors(stack.device) or stack.scalar is not wp.uint8:
        return None
    stack.require_colour()
    if valid is None:  # one row of full weights serves all
        masks = wp.full((1, stack.width), 255, dtype=wp.uint8, device=stack.device)
    else:
        masks = valid_array(valid, stack)
        if not is_mask(masks):
            return None
    shape = (stack.count, stack.height, stack.width)
    result = output_array(out, shape, wp.uint8, stack.device, "out")
    target = pixel_view(result, wp.uint8, (stack.count, stack.size))
    levels = check_gains(gains, stack)
    packed, pack_job = empty_packed(stack, "rgb8", photos)
    job = cut_job(pack_job, 0 if valid is None else stack.width, brightening)
    for i, s in enumerate(stats):
        scale = wp.vec3(*(levels[i] / stack.white))
        cut_and_pack_photo(job, i, stack.pixels[i], masks[i % masks.shape[0]], scale, s, target[i])
    return result, packed


def cut_job(pack: PackJob, valid_step: int, brightening: dict[str, float] | None) -> CutJob:
    """Return what all photos of a cut share.

    Args:
        pack: Where to pack to.
        valid_step: Pixels from one row of the user mask to the next; 0 where one row serves all.
        brightening: See `cut_and_pack`.

    Raises:
        ValueError: If the brightening makes no sense.
    """
    job = CutJob()
    job.pack = pack
    job.valid_step = valid_step
    if brightening is not None:
        check_brightening(**brightening)
        job.over_target = 1.0 / brightening["target_value"]
        job.power = brightening["gamma"] - 1.0
        job.most = math.log2(brightening["max_gain"])
    return job


def cut_and_pack_photo(
    job: CutJob, frame: int, pixels: Any, valid: Any, scale: Any, stats: HueStatistics, mask: Any
) -> None:
    """Cut, brighten and pack one photo.

    Args:
        job: From `cut_job`.
        frame: Its place among the packed photos.
        pixels: Warp array (H * W) of vec3ub, on the CPU.
        valid: Warp array (H * W or W), uint8, user mask of 0 and 255.
        scale: Vector that brings pixels to 0..1, see `arrays.pixel_scales`.
        stats: What to cut.
        mask: Warp array (H * W), uint8, written.
    """
    job.scale = scale
    job.circular = int(stats.statistics == "circular")
    job.mean = stats.mean_deg
    job.half_width = stats.half_width_deg if stats.informative else -1.0
    kernel = _cut_and_pack_kernel(job.over_target > 0.0)
    inputs = [frame, job, pixels, valid, mask]
    launch(kernel, job.pack.height + 2, inputs, pixels.device, ROW_GRAIN)
