"""Inner loops of the tile gather, in C, one for each form of packed photos.

RGB: a first loop over the tile, in vectors, projects and leaves the place and the bilinear weights
of every pixel; a second one takes the four corners of a pixel, with all their channels, as one
vector, for two frames at once where a channel has a byte. Grey: one loop does both, with the
vector's lanes along the pixels.
"""

from dataclasses import dataclass
from string import Template


@dataclass(frozen=True)
class Form:
    """C of one form. Names ending in `[i]` belong to pixel i of the tile.

    Args:
        word: Type of a packed pixel.
        declare: Arrays of the tile, the sums 0.
        place: Keeps where pixel i is in a photo, from u and v, and how its corners weigh, in a
            vector loop; `in` tells whether the photo sees it.
        mix: Adds up the corners of all pixels; of one frame from `half` on, or of two.
        sums: Sum of each channel, and last that of the weights.
        unit: C of the factor on the sum of the weights.
        pairs: Whether `mix` takes two frames at once.
        step: Units of u and v in a pixel.
        origin: u and v of the centre of a photo's first pixel.
    """

    word: str
    declare: str
    place: str
    mix: str
    sums: tuple[str, ...]
    unit: str = "1.0f"
    pairs: bool = False
    step: str = "1.0f"
    origin: str = "1.0f"

    @property
    def channels(self) -> int:
        """Channels of the image."""
        return len(self.sums) - 1


# Places are whole numbers of 1/8192 pixel, bilinear weights of 1/8192. Where the processor
# multiplies bytes by fours (VNNI), weights are kept as two bytes, whose products with the corners
# are summed apart; else they lie side by side in 64 bits.
_BYTES_DECLARE = """
    enum { BITS = 13, UNIT = 1 << BITS };
#if defined(__AVX512VNNI__) && defined(__AVX512BW__) && defined(__AVX512VL__)
    #define HSVAOS_FOURS
    typedef int i32v __attribute__((vector_size(64)));
    typedef float f32v __attribute__((vector_size(64)));
    typedef unsigned char u8v __attribute__((vector_size(64)));
    typedef long long i64v __attribute__((vector_size(64)));
    typedef long long i64x2 __attribute__((vector_size(16)));
    alignas(64) float sums[4 * SIZE];
    alignas(64) unsigned coarse[2 * SIZE], fine[2 * SIZE];
    const auto sum_of = [&](int i, int c) { return sums[4 * i + c]; };
#else
    alignas(64) f32x8 sums[SIZE];
    alignas(64) unsigned long long shares[2 * SIZE];
    const auto sum_of = [&](int i, int c) { return sums[i][2 * c] + sums[i][2 * c + 1]; };
#endif
    __builtin_memset(sums, 0, sizeof(sums));
"""

_BYTES_PLACE = """
    const int up = (int)u, vp = (int)v;
    places[half + i] = (vp >> BITS) * row_stride + (up >> BITS);
    const int iu = up & (UNIT - 1), iv = vp & (UNIT - 1);
    const int corner = (iu * iv + UNIT / 2) >> BITS;
    const int right_of = iu - corner;
    const unsigned upper = (unsigned)(UNIT - iv - right_of) | (unsigned)right_of << 16;
    const unsigned lower = (unsigned)(iv - corner) | (unsigned)corner << 16;
#ifdef HSVAOS_FOURS
    // bytes of upper left, lower left, upper right and lower right
    const unsigned most = (upper >> 7 & 0x00ff00ffu) | (lower << 1 & 0xff00ff00u);
    coarse[half + i] = in ? most : 0u;
    fine[half + i] = in ? (upper & 0x007f007fu) | (lower << 8 & 0x7f007f00u) : 0u;
#else
    shares[half + i] = in ? (unsigned long long)lower << 32 | upper : 0ull;
#endif
"""

# Two frames of the same gains add up as whole numbers.
_BYTES_MIX = Template("""
    const $word *frame_a = frames[0], *frame_b = frames[1];
    const float *ga = gains_of[0], *gb = gains_of[1];
    const bool alike = (ga[0] == gb[0]) & (ga[1] == gb[1]) & (ga[2] == gb[2]);
#ifdef HSVAOS_FOURS
    const f32v gains_a = {ga[0], ga[1], ga[2], 1.0f, ga[0], ga[1], ga[2], 1.0f,
        ga[0], ga[1], ga[2], 1.0f, ga[0], ga[1], ga[2], 1.0f};
    const f32v gains_b = {gb[0], gb[1], gb[2], 1.0f, gb[0], gb[1], gb[2], 1.0f,
        gb[0], gb[1], gb[2], 1.0f, gb[0], gb[1], gb[2], 1.0f};
    // masks the compiler does not see through: it shall merge loads, not shuffle registers
    const unsigned one = row_stride > 0;
    if (alike) {
        for (int i = 0; i < SIZE; i += 16) {
            $weights
            $fours_alike
        }
    } else {
        for (int i = 0; i < SIZE; i += 16) {
            $weights
            $fours
        }
    }
#else
    const f32x8 gains_a = {ga[0], ga[0], ga[1], ga[1], ga[2], ga[2], 1.0f, 1.0f};
    const f32x8 gains_b = {gb[0], gb[0], gb[1], gb[1], gb[2], gb[2], 1.0f, 1.0f};
    const auto mixed = [&](const $word* frame, int i) {
        const $word* at = frame + places[i];
        u64x2 corners;
        $load
        const u8x16 bytes = __builtin_shufflevector((u8x16)corners, (u8x16)corners, $across);
        const i16x16 values = __builtin_convertvector(bytes, i16x16);
        const unsigned long long four = shares[i];
        const u64x4 share = {four, four, four, four};
    #ifdef __AVX2__
        return (i32x8)__builtin_ia32_pmaddwd256(values, (i16x16)share);
    #else
        const i32x16 products = __builtin_convertvector(values, i32x16)
            * __builtin_convertvector((i16x16)share, i32x16);
        return __builtin_shufflevector(products, products, 0, 2, 4, 6, 8, 10, 12, 14)
            + __builtin_shufflevector(products, products, 1, 3, 5, 7, 9, 11, 13, 15);
    #endif
    };
    if (alike) {
        for (int i = 0; i < SIZE; ++i) {
            const i32x8 sum = mixed(frame_a, i) + mixed(frame_b, SIZE + i);
            sums[i] += __builtin_convertvector(sum, f32x8) * gains_a;
        }
    } else {
        for (int i = 0; i < SIZE; ++i) {
            sums[i] += __builtin_convertvector(mixed(frame_a, i), f32x8) * gains_a
                + __builtin_convertvector(mixed(frame_b, SIZE + i), f32x8) * gains_b;
        }
    }
#endif
""")

_WEIGHTS = """
            const i32v high_a = *(const i32v*)(coarse + i);
            const i32v low_a = *(const i32v*)(fine + i);
            const i32v high_b = *(const i32v*)(coarse + SIZE + i);
            const i32v low_b = *(const i32v*)(fine + SIZE + i);
"""

# corners of four pixels, with all channels, against their weights
_CORNERS_OF_FOUR = Template("""
            u8v bytes_$ab;
            {
                const $word* frame = frame_$ab;
                const int* to = places + $half + i + $first;
                $load
                bytes_$ab = __builtin_shufflevector((u8v)corners, (u8v)corners, $down);
            }
            const i32v most_$ab = __builtin_shufflevector(high_$ab, high_$ab, $spread);
            const i32v rest_$ab = __builtin_shufflevector(low_$ab, low_$ab, $spread);
""")

_FOUR_ALIKE = Template("""{
            $corners
            i32v total = __builtin_ia32_vpdpbusd512((i32v){}, (i32v)bytes_a, most_a);
            total = __builtin_ia32_vpdpbusd512(total, (i32v)bytes_b, most_b);
            total = __builtin_ia32_vpdpbusd512(total << 7, (i32v)bytes_a, rest_a);
            total = __builtin_ia32_vpdpbusd512(total, (i32v)bytes_b, rest_b);
            *(f32v*)(sums + 4 * (i + $first)) += __builtin_convertvector(total, f32v) * gains_a;
        }
""")

_FOUR = Template("""{
            $corners
            i32v of_a = __builtin_ia32_vpdpbusd512((i32v){}, (i32v)bytes_a, most_a);
            i32v of_b = __builtin_ia32_vpdpbusd512((i32v){}, (i32v)bytes_b, most_b);
            of_a = __builtin_ia32_vpdpbusd512(of_a << 7, (i32v)bytes_a, rest_a);
            of_b = __builtin_ia32_vpdpbusd512(of_b << 7, (i32v)bytes_b, rest_b);
            *(f32v*)(sums + 4 * (i + $first)) += __builtin_convertvector(of_a, f32v) * gains_a
                + __builtin_convertvector(of_b, f32v) * gains_b;
        }
""")

_ROWS_LOAD = """
        __builtin_memcpy(&corners, at, 8);
        __builtin_memcpy((char*)&corners + 8, at + row_stride, 8);
"""

_ROWS_LOAD_FOUR = """
            long long pair[8];
            for (int k = 0; k < 4; ++k) {
                __builtin_memcpy(&pair[2 * k], frame + to[k], 8);
                __builtin_memcpy(&pair[2 * k + 1], frame + to[k] + row_stride, 8);
            }
            i64v corners = {pair[0], 0, 0, 0, 0, 0, 0, 0};
            #pragma unroll
            for (int k = 1; k < 8; ++k) {
                const i64v again = {pair[k], pair[k], pair[k], pair[k],
                    pair[k], pair[k], pair[k], pair[k]};
                corners = (i64v)__builtin_ia32_selectq_512(
                    (unsigned char)(one << k), again, corners);
            }
"""

_PAIRS_LOAD_FOUR = """
            i64x2 pair[4];
            for (int k = 0; k < 4; ++k) __builtin_memcpy(&pair[k], frame + to[k], 16);
            const i64v corners = {pair[0][0], pair[0][1], pair[1][0], pair[1][1],
                pair[2][0], pair[2][1], pair[3][0], pair[3][1]};
"""


def _bytes(word: str, load: str, load_four: str, corners: tuple[int, int, int, int]) -> Form:
    """Form of RGB and weight in bytes.

    Args:
        word: Type of a packed pixel.
        load: Takes the 16 bytes of a pixel's corners at `at`.
        load_four: Takes the corners of the pixels `to[0]` to `to[3]`.
        corners: Where in the 16 bytes the upper left, upper right, lower left and lower right are.
    """
    a, b, c, d = corners
    down = [
        pixel + k + channel
        for pixel in (0, 16, 32, 48)
        for channel in range(4)
        for k in (a, c, b, d)
    ]

    def fours(mixed: Template) -> str:
        return "".join(mixed.substitute(first=i, corners=both(i)) for i in (0, 4, 8, 12))

    def both(first: int) -> str:
        spread = _listed([first + k // 4 for k in range(16)])
        shared = {"word": word, "first": first, "load": load_four, "spread": spread}
        return "".join(
            _CORNERS_OF_FOUR.substitute(shared, down=_listed(down), ab=ab, half=half)
            for ab, half in (("a", "0"), ("b", "SIZE"))
        )

    across = _listed([k + ch for ch in range(4) for k in corners])
    return Form(
        word=word,
        declare=_BYTES_DECLARE,
        place=_BYTES_PLACE,
        mix=_BYTES_MIX.substitute(
            weights=_WEIGHTS,
            fours_alike=fours(_FOUR_ALIKE),
            fours=fours(_FOUR),
            word=word,
            load=load,
            across=across,
        ),
        sums=tuple(f"sum_of(i, {c})" for c in range(4)),
        unit="(1.0f / UNIT)",
        pairs=True,
        step="(float)UNIT",
        origin="((float)UNIT + 0.5f)",
    )


def _listed(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers))


_CORNERS = """
    alignas(64) float upper_left[2 * SIZE], upper_right[2 * SIZE];
    alignas(64) float lower_left[2 * SIZE], lower_right[2 * SIZE];
"""

_PLACE = """
    const int ui = (int)u, vi = (int)v;
    const float fu = u - (float)ui, fv = v - (float)vi;
    places[half + i] = vi * row_stride + ui;
    const float corner = fu * fv;
    upper_left[half + i] = in ? 1.0f - fu - fv + corner : 0.0f;
    upper_right[half + i] = in ? fu - corner : 0.0f;
    lower_left[half + i] = in ? fv - corner : 0.0f;
    lower_right[half + i] = in ? corner : 0.0f;
"""

_RGB16 = Form(
    word="unsigned long long",
    declare=_CORNERS + "alignas(64) f32x8 sums[SIZE] = {};",
    place=_PLACE,
    mix="""
    const float red = gains[0], green = gains[1], blue = gains[2];
    const f32x8 gain = {red, green, blue, 1.0f, red, green, blue, 1.0f};
    for (int i = 0; i < SIZE; ++i) {
        const unsigned long long* at = frame + places[half + i];
        f16x8 upper, lower;
        __builtin_memcpy(&upper, at, 16);
        __builtin_memcpy(&lower, at + row_stride, 16);
        const float a = upper_left[half + i], b = upper_right[half + i];
        const float c = lower_left[half + i], d = lower_right[half + i];
        const f32x8 ab = {a, a, a, a, b, b, b, b}, cd = {c, c, c, c, d, d, d, d};
        sums[i] += (__builtin_convertvector(upper, f32x8) * ab
            + __builtin_convertvector(lower, f32x8) * cd) * gain;
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
    const float gain = gains[0];
    #pragma clang loop vectorize(enable) vectorize_width(16)
    for (int i = 0; i < SIZE; ++i) {
        const $word* at = frame + places[half + i];
        $load
        const float wa = upper_left[half + i] * $weight_a, wb = upper_right[half + i] * $weight_b;
        const float wc = lower_left[half + i] * $weight_c, wd = lower_right[half + i] * $weight_d;
        total_w[i] += wa + wb + wc + wd;
        total[i] += gain * (wa * $level_a + wb * $level_b + wc * $level_c + wd * $level_d);
    }
""")


def _grey(word: str, load: str, level: str, weight: str) -> Form:
    """Form of one channel: level and weight are C of a corner, named `@`."""
    corners = {f"level_{p}": level.replace("@", p) for p in "abcd"}
    corners |= {f"weight_{p}": weight.replace("@", p) for p in "abcd"}
    return Form(
        word=word,
        declare=_CORNERS + "alignas(64) float total[SIZE] = {}, total_w[SIZE] = {};",
        place=_PLACE,
        mix=_GREY.substitute(word=word, load=load, **corners),
        sums=("total[i]", "total_w[i]"),
    )


FORMS = {
    "rgb8": _bytes("unsigned", _ROWS_LOAD, _ROWS_LOAD_FOUR, (0, 4, 8, 12)),
    "rgb8 pairs": _bytes(
        *("unsigned long long", "__builtin_memcpy(&corners, at, 16);", _PAIRS_LOAD_FOUR),
        (0, 8, 4, 12),
    ),
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
