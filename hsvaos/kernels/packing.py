"""Photos packed for fast gathering on the CPU: colour and weight of a pixel in one word."""

from dataclasses import dataclass, replace
from functools import lru_cache
from string import Template
from typing import Any

import numpy as np
import warp as wp

from hsvaos.kernels.arrays import Stack, pixel_view
from hsvaos.kernels.device import ROW_GRAIN, launch

wp.set_module_options({"enable_backward": False})

LINE = 64
"""Bytes of a cache line."""

_LEAST_WEIGHT = 2.0**-25
"""Least weight, as a share of the greatest, that 16 bits hold well."""


@dataclass(frozen=True, eq=False)
class Packed:
    """Photos in one buffer, each with a border of one repeated pixel.

    Args:
        words: Warp array, shape (N, words of a frame), uint32.
        form: What a pixel is; each part has 8, 16 or 32 bits:
            "rgb8" one word, R, G, B and weight, which is 0 or 255;
            "rgb8 pairs" two words, a pixel of "rgb8" and the one below it;
            "rgb16" two words, R, G, B times weight, and weight, as half floats;
            "grey16" one word, grey and weight;
            "grey32" one word, a float;
            "grey32 weighted" two words, a float and a float for its weight.
            The weight of "grey16" is a small float: 5 bits of exponent, 11 of mantissa.
        row: Pixels from one row to the next.
        frame: Pixels from one frame to the next.
        weight_unit: What one step of the decoded weights counts.
        white: What a decoded colour over its weight is to be multiplied by.
    """

    words: Any
    form: str
    row: int
    frame: int
    weight_unit: float
    white: float = 1.0

    @property
    def nbytes(self) -> int:
        """Memory that the packed photos take [bytes]."""
        return 4 * int(self.words.size)


@wp.struct
class PackJob:
    """What all rows of a packing share."""

    width: int
    height: int
    row_stride: int
    frame_stride: int
    weight_scale: float
    weight_step: int
    words: wp.array2d(dtype=wp.uint32)


_WORDS = {"rgb8": 1, "rgb8 pairs": 2, "rgb16": 2, "grey16": 1, "grey32": 1, "grey32 weighted": 2}

_ROW = Template("""
    const int width = job.width, height = job.height;
    const int line = row % (height + 2);
    const int frame = row / (height + 2);
    const int y = line == 0 ? 0 : (line > height ? height - 1 : line - 1);
    const $source* from = images.data + ((size_t)frame * height + y) * width * $channels;
    const $weight* weigh = weights.data + ((size_t)(frame * job.weight_step) * height + y) * width;
    const size_t start = (size_t)frame * job.frame_stride + (size_t)line * job.row_stride;
    unsigned* to = job.words.data + start * $words;
    #pragma clang loop vectorize(enable)
    for (int x = 0; x < width; ++x) {
        $pack
    }
    for (int i = 0; i < $words; ++i) {
        to[i] = to[$words + i];
        to[(width + 1) * $words + i] = to[width * $words + i];
    }
""")

_WEIGHT_16 = """
        float share = $share * job.weight_scale;
        share = share < 0x1p-30f ? 0.0f : share;
        const unsigned weight = (__builtin_bit_cast(unsigned, share * 0x1p-96f) + 2048u) >> 12;
"""

_PACK = {
    "rgb8": """
        const unsigned seen = $share > 0.0f ? ~0u : 0u;
        to[x + 1] = seen & ((unsigned)from[3 * x] | (unsigned)from[3 * x + 1] << 8
            | (unsigned)from[3 * x + 2] << 16 | 255u << 24);
""",
    "rgb16": """
        const float share = $share * job.weight_scale;
        const float dim = share * (sizeof(*from) == 1 ? 128.0f : 0.5f);
        const _Float16 red = (_Float16)(dim * (float)from[3 * x]);
        const _Float16 green = (_Float16)(dim * (float)from[3 * x + 1]);
        const _Float16 blue = (_Float16)(dim * (float)from[3 * x + 2]);
        const _Float16 weight = (_Float16)(share * 32768.0f);
        to[2 * x + 2] = (unsigned)__builtin_bit_cast(unsigned short, red)
            | (unsigned)__builtin_bit_cast(unsigned short, green) << 16;
        to[2 * x + 3] = (unsigned)__builtin_bit_cast(unsigned short, blue)
            | (unsigned)__builtin_bit_cast(unsigned short, weight) << 16;
""",
    "grey16": _WEIGHT_16 + "        to[x + 1] = (unsigned)from[x] | weight << 16;\n",
    "grey32": "to[x + 1] = __builtin_bit_cast(unsigned, from[x]);",
    "grey32 weighted": """
        to[2 * x + 2] = __builtin_bit_cast(unsigned, from[x]);
        to[2 * x + 3] = __builtin_bit_cast(unsigned, $share * job.weight_scale);
""",
}

_C_TYPE = {wp.uint8: "unsigned char", wp.uint16: "unsigned short", wp.float32: "float"}


@lru_cache
def _pack_kernel(form: str, scalar: Any, weight: Any) -> Any:
    """Kernel that packs one row of a frame; `weight` None gives every pixel the weight 1."""
    share = "1.0f" if weight is None else "(float)weigh[x]"
    stored = wp.uint8 if weight is None else weight
    snippet = _ROW.substitute(
        source=_C_TYPE[scalar],
        weight=_C_TYPE[stored],
        channels=3 if form.startswith("rgb") else 1,
        words=_WORDS[form],
        pack=Template(_PACK[form]).substitute(share=share),
    )

    @wp.func_native(snippet)
    def pack_row(
        row: int, job: PackJob, images: wp.array2d(dtype=scalar), weights: wp.array2d(dtype=stored)
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def pack_kernel(
        offset: int,
        band: int,
        job: PackJob,
        images: wp.array2d(dtype=scalar),
        weights: wp.array2d(dtype=stored),
    ):
        pack_row(wp.tid() + offset, job, images, weights)

    return pack_kernel


def pack(stack: Stack, weights: Any, weight_unit: float) -> Packed | None:
    """Pack photos and their weights; see `Packed`.

    Nothing is rounded but weights that are more than a mask, of photos of whole numbers: they, or
    for RGB their product with the colour, keep 11 or 12 significant bits.

    Args:
        stack: The photos, on the CPU.
        weights: Warp array (N or 1, H * W), uint8, uint16 or float32.
        weight_unit: Weight of 1 in that array; 0 if all pixels have the weight 1.

    Returns:
        The packed photos; None where there is no form for them: float RGB photos, and float
        weights that span more than seven decades.
    """
    weighted = weight_unit > 0.0
    weight = weights.dtype if weighted else None
    form = _form(stack, weights if weighted else None)
    share = _weight_scale(form, weights, weight_unit) if form else None
    if form is None or share is None:
        return None
    packed, job = empty_packed(stack, form, weight_unit=share[1])
    job.weight_scale = share[0]
    job.weight_step = int(weighted and weights.shape[0] > 1)
    _fill(stack, weights, weight, form, job)
    return packed


def _fill(stack: Stack, weights: Any, weight: Any, form: str, job: PackJob) -> None:
    inputs = [
        job,
        pixel_view(stack.array, stack.scalar, (stack.count, stack.size * stack.channels)),
        weights,
    ]
    kernel = _pack_kernel(form, stack.scalar, weight)
    launch(kernel, stack.count * (stack.height + 2), inputs, stack.device, ROW_GRAIN)


def pack_over(stack: Stack, weights: Any, photos: Packed) -> None:
    """Pack photos with weights of one byte a pixel into the memory of others.

    Args:
        stack: The photos, on the CPU.
        weights: Warp array (N or 1, H * W), uint8, 255 = weight 1; for "rgb8" 0 or 255.
        photos: Memory from `new_packed`, of as many photos.

    Raises:
        ValueError: If it is not of the photos' number and size.
    """
    _, job = empty_packed(stack, photos.form, photos)
    job.weight_scale = _byte_scale(photos.form, 1.0)[0]
    job.weight_step = int(weights.shape[0] > 1)
    _fill(stack, weights, wp.uint8, photos.form, job)


def new_packed(count: int, size: tuple[int, int], scalar: Any, form: str) -> Packed:
    """Return memory for photos that will be packed with weights of one byte a pixel.

    Args:
        count: Number of photos.
        size: (width, height) of the photos [px].
        scalar: Warp type of a channel, uint8 or uint16.
        form: See `Packed`.
    """
    return _memory(count, size, scalar, form, _byte_scale(form, 1.0 / 255.0)[1])


def _memory(
    count: int, size: tuple[int, int], scalar: Any, form: str, weight_unit: float
) -> Packed:
    row, frame = _strides(size, form)
    # the operating system gives NumPy's large arrays large pages: fewer misses of the TLB
    buffer = np.empty((count, frame * _WORDS[form]), dtype=np.uint32)
    words = wp.array(buffer, dtype=wp.uint32, device="cpu", copy=False)
    white = {"rgb8": 255.0, "rgb16": 256.0 if scalar is wp.uint8 else 65536.0}
    return Packed(words, form, row, frame, weight_unit, white.get(form, 1.0))


def _strides(size: tuple[int, int], form: str) -> tuple[int, int]:
    """Pixels from row to row and from frame to frame."""
    pixel = 4 * _WORDS[form]
    row = _row_stride(size[0], pixel)
    return row, row * (size[1] + 2) + 5 * LINE // pixel


@wp.func_native("""
    const int width = job.width;
    const int line = row % (job.height + 1), frame = row / (job.height + 1);
    const unsigned* from = words.data + (size_t)frame * frame_stride + (size_t)line * row_stride;
    unsigned long long* to = (unsigned long long*)job.words.data
        + (size_t)frame * job.frame_stride + (size_t)line * job.row_stride;
    #pragma clang loop vectorize(enable)
    for (int x = 0; x < width + 2; ++x) {
        to[x] = from[x] | (unsigned long long)from[row_stride + x] << 32;
    }
""")
def _pair_row(
    row: int, job: PackJob, words: wp.array2d(dtype=wp.uint32), row_stride: int, frame_stride: int
): ...


@wp.kernel(module="unique", enable_backward=False)
def _pair_kernel(
    offset: int,
    band: int,
    job: PackJob,
    words: wp.array2d(dtype=wp.uint32),
    row_stride: int,
    frame_stride: int,
):
    _pair_row(wp.tid() + offset, job, words, row_stride, frame_stride)


def pair_rows(stack: Stack, packed: Packed) -> Packed | None:
    """Return photos of the form "rgb8" as "rgb8 pairs": faster to gather, twice as large.

    Args:
        stack: The photos that were packed.
        packed: The packed photos.

    Returns:
        The pairs; None for other forms.
    """
    if packed.form != "rgb8":
        return None
    pairs, job = empty_packed(stack, "rgb8 pairs", weight_unit=packed.weight_unit)
    inputs = [job, packed.words, packed.row, packed.frame]
    launch(_pair_kernel, stack.count * (stack.height + 1), inputs, stack.device, ROW_GRAIN)
    return replace(pairs, white=packed.white)


def empty_packed(
    stack: Stack, form: str, like: Packed | None = None, weight_unit: float = 1.0 / 255.0
) -> tuple[Packed, PackJob]:
    """Return memory for packed photos, and the job of the kernel that fills it.

    Args:
        stack: The photos.
        form: See `Packed`.
        like: Packed photos to write over; None for new memory.
        weight_unit: See `Packed`.

    Raises:
        ValueError: If `like` is not of the photos' number, size and form.
    """
    row, frame = _strides((stack.width, stack.height), form)
    shape = (stack.count, frame * _WORDS[form])
    if like is None:
        like = _memory(stack.count, (stack.width, stack.height), stack.scalar, form, weight_unit)
    elif (tuple(like.words.shape), like.form, like.row) != (shape, form, row):
        raise ValueError(f"photos must hold {shape} words of form {form}, got {like.words.shape}")
    job = PackJob()
    job.width, job.height = stack.width, stack.height
    job.row_stride, job.frame_stride = row, frame
    job.words = like.words
    return like, job


def _form(stack: Stack, weights: Any) -> str | None:
    """Form for photos with these weights; None where all weights are 1."""
    if stack.channels == 1:
        if stack.scalar is wp.float32:
            return "grey32" if weights is None else "grey32 weighted"
        return "grey16"
    if stack.scalar is wp.float32:
        return None
    masked = weights is None or (weights.dtype is wp.uint8 and is_mask(weights))
    return "rgb8" if stack.scalar is wp.uint8 and masked else "rgb16"


def is_mask(weights: Any) -> bool:
    """Whether bytes are only 0 and one other value, 1 or 255."""
    rows = (weights[i].numpy() for i in range(weights.shape[0]))
    return all(((row + np.uint8(1)) <= 2).all() for row in rows)


def _row_stride(width: int, pixel: int) -> int:
    """Pixels of a padded row of `pixel` bytes each: rows of a tile shall not share cache sets."""
    lines = -(-(width + 2) * pixel // LINE)
    sets = 4096 // LINE
    while lines % 2 == 0 or not 3 <= lines % sets <= sets - 3:
        lines += 1
    return lines * LINE // pixel


def _byte_scale(form: str, unit: float) -> tuple[float, float]:
    """`_weight_scale` of weights of one byte: whole numbers of 8 bits are exact as small floats."""
    if form == "rgb8":
        return 1.0, 1.0 / 255.0
    if form == "grey32 weighted":
        return 1.0, unit
    return 1.0 / 256.0, 256.0 * unit * _stored(form)


def _stored(form: str) -> float:
    """Weight that a decoded 1 stands for."""
    return 1.0 / 32768.0 if form == "rgb16" else 1.0


def _weight_scale(form: str, weights: Any, unit: float) -> tuple[float, float] | None:
    """Factor on stored weights as they are packed, and the unit of the result."""
    if form in ("rgb8", "grey32 weighted") or (unit > 0.0 and weights.dtype is wp.uint8):
        return _byte_scale(form, unit)
    stored = _stored(form)
    if unit == 0.0:
        return 1.0, stored
    rows = [weights[i].numpy() for i in range(weights.shape[0])]
    top = max(row.max() for row in rows)
    least = float(min(np.min(row, initial=top, where=row != 0.0) for row in rows))
    top = float(top)
    if top == 0.0:
        return 1.0, stored
    if not (np.isfinite(top) and least >= _LEAST_WEIGHT * top):
        return None
    return 1.0 / top, top * unit * stored
