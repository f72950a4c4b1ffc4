"""Inner loops of the tile gather, in C, one for each form of packed photos.

RGB: a first loop over the tile, in vectors, projects and leaves the place and the bilinear weights
of every pixel; a second one takes the four corners of a pixel, with all their channels, as one
vector. Grey: one loop does both, with the vector's lanes along the pixels.
"""

from dataclasses import dataclass
from string import Template


@dataclass(frozen=True)
class Form:
    """C of one form. Names ending in `[i]` belong to pixel i of the tile.

    Args:
        word: Type of a packed pixel.
        declare: Arrays of the tile.
        clear: Sets the sums of pixel i to 0.
        place: Weighs the corners of pixel i by the fractions fu and fv of its place in a photo,
            in a vector loop; `in` tells whether the photo sees it.
        mix: Adds up the corners of all pixels.
        sums: Sum of each channel, and last that of the weights.
        unit: Factor on the sum of the weights.
    """

    word: str
    declare: str
    clear: str
    place: str
    mix: str
    sums: tuple[str, ...]
    unit: float = 1.0

    @property
    def channels(self) -> int:
        """Channels of the image."""
        return len(self.sums) - 1


# the bilinear weights are whole numbers that sum to 16384, side by side in 64 bits
_RGB8 = Form(
    word="unsigned",
    declare="""
    alignas(64) f32x8 sums[SIZE];
    alignas(64) unsigned long long shares[2 * SIZE];
""",
    clear="sums[i] = f32x8{};",
    place="""
    const int iu = (int)(fu * 16384.0f + 0.5f), iv = (int)(fv * 16384.0f + 0.5f);
    const int corner = (iu * iv + 8192) >> 14;
    const unsigned upper = (unsigned)(16384 - iu - iv + corner) | (unsigned)(iu - corner) << 16;
    const unsigned lower = (unsigned)(iv - corner) | (unsigned)corner << 16;
    shares[half + i] = in ? (unsigned long long)lower << 32 | upper : 0;
""",
    mix="""
    const f32x8 gains = {gain_0, gain_0, gain_1, gain_1, gain_2, gain_2, 1.0f, 1.0f};
    for (int i = 0; i < SIZE; ++i) {
        const unsigned* at = frame + places[half + i];
        u64x2 corners;
        __builtin_memcpy(&corners, at, 8);
        __builtin_memcpy((char*)&corners + 8, at + row_stride, 8);
        const u8x16 bytes = __builtin_shufflevector((u8x16)corners, (u8x16)corners,
            0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
        const i16x16 values = __builtin_convertvector(bytes, i16x16);
        const unsigned long long four = shares[half + i];
        const u64x4 share = {four, four, four, four};
    #ifdef __AVX2__
        const i32x8 pairs = (i32x8)__builtin_ia32_pmaddwd256(values, (i16x16)share);
    #else
        const i32x16 products = __builtin_convertvector(values, i32x16)
            * __builtin_convertvector((i16x16)share, i32x16);
        const i32x8 pairs =
            __builtin_shufflevector(products, products, 0, 2, 4, 6, 8, 10, 12, 14)
            + __builtin_shufflevector(products, products, 1, 3, 5, 7, 9, 11, 13, 15);
    #endif
        sums[i] += __builtin_convertvector(pairs, f32x8) * gains;
    }
""",
    sums=tuple(f"(sums[i][{2 * c}] + sums[i][{2 * c + 1}])" for c in range(4)),
    unit=1.0 / 16384.0,
)

_CORNERS = """
    alignas(64) float upper_left[2 * SIZE], upper_right[2 * SIZE];
    alignas(64) float lower_left[2 * SIZE], lower_right[2 * SIZE];
"""

_RGB16 = Form(
    word="unsigned long long",
    declare=_CORNERS + "alignas(64) f32x8 sums[SIZE];",
    clear="sums[i] = f32x8{};",
    place="""
    const float corner = fu * fv;
    upper_left[half + i] = in ? 1.0f - fu - fv + corner : 0.0f;
    upper_right[half + i] = in ? fu - corner : 0.0f;
    lower_left[half + i] = in ? fv - corner : 0.0f;
    lower_right[half + i] = in ? corner : 0.0f;
""",
    mix="""
    const f32x8 gains = {gain_0, gain_1, gain_2, 1.0f, gain_0, gain_1, gain_2, 1.0f};
    for (int i = 0; i < SIZE; ++i) {
        const unsigned long long* at = frame + places[half + i];
        f16x8 upper, lower;
        __builtin_memcpy(&upper, at, 16);
        __builtin_memcpy(&lower, at + row_stride, 16);
        const float a = upper_left[half + i], b = upper_right[half + i];
        const float c = lower_left[half + i], d = lower_right[half + i];
        const f32x8 ab = {a, a, a, a, b, b, b, b}, cd = {c, c, c, c, d, d, d, d};
        sums[i] += (__builtin_convertvector(upper, f32x8) * ab
            + __builtin_convertvector(lower, f32x8) * cd) * gains;
    }
""",
    sums=tuple(f"(sums[i][{c}] + sums[i][{c + 4}])" for c in range(4)),
)

_PAIRS = """
    unsigned long long upper, lower;
    __builtin_memcpy(&upper, at, 8);
    __builtin_memcpy(&lower, at + row_stride, 8);
    const unsigned a = (unsigned)upper, b = (unsigned)(upper >> 32);
    const unsigned c = (unsigned)lower, d = (unsigned)(lower >> 32);
"""

_SINGLES = """
    const unsigned long long a = at[0], b = at[1], c = at[row_stride], d = at[row_stride + 1];
"""

_GREY = Template("""
    #pragma clang loop vectorize(enable) vectorize_width(16)
    for (int i = 0; i < SIZE; ++i) {
        const $word* at = frame + places[half + i];
        $load
        const float wa = upper_left[half + i] * $weight_a, wb = upper_right[half + i] * $weight_b;
        const float wc = lower_left[half + i] * $weight_c, wd = lower_right[half + i] * $weight_d;
        total_w[i] += wa + wb + wc + wd;
        total[i] += gain_0 * (wa * $level_a + wb * $level_b + wc * $level_c + wd * $level_d);
    }
""")


def _grey(word: str, load: str, level: str, weight: str) -> Form:
    """Form of one channel: level and weight are C of a corner, named `@`."""
    corners = {f"level_{p}": level.replace("@", p) for p in "abcd"}
    corners |= {f"weight_{p}": weight.replace("@", p) for p in "abcd"}
    return Form(
        word=word,
        declare=_CORNERS + "alignas(64) float total[SIZE], total_w[SIZE];",
        clear="total[i] = total_w[i] = 0.0f;",
        place=_RGB16.place,
        mix=_GREY.substitute(word=word, load=load, **corners),
        sums=("total[i]", "total_w[i]"),
    )


FORMS = {
    "rgb8": _RGB8,
    "rgb16": _RGB16,
    "grey16": _grey(
        *("unsigned", _PAIRS, "(float)(int)(@ & 65535u)"),
        "(__builtin_bit_cast(float, @ >> 16 << 12) * 0x1p96f)",
    ),
    "grey32": _grey("unsigned", _PAIRS, "__builtin_bit_cast(float, @)", "1.0f"),
    "grey32 weighted": _grey(
        *("unsigned long long", _SINGLES, "__builtin_bit_cast(float, (unsigned)@)"),
        "__builtin_bit_cast(float, (unsigned)(@ >> 32))",
    ),
}
"""Form by name; see `packing.Packed`."""
