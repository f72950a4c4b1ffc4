"""The tile gather in C: culling, projection and the order of frames; see `tiles`."""

from string import Template

from hsvaos.kernels.tile_forms import Form
from hsvaos.kernels.tile_ways import Way

_TILE = Template("""{
    #pragma clang fp contract(fast)
    typedef unsigned char u8x16 __attribute__((vector_size(16)));
    typedef unsigned long long u64x2 __attribute__((vector_size(16)));
    typedef unsigned long long u64x4 __attribute__((vector_size(32)));
    typedef short i16x16 __attribute__((vector_size(32)));
    typedef int i32x8 __attribute__((vector_size(32)));
    typedef int i32x16 __attribute__((vector_size(64)));
    typedef _Float16 f16x8 __attribute__((vector_size(16)));
    typedef float f32x8 __attribute__((vector_size(32)));
    enum { SIDE = 16, SIZE = 256, CHUNK = 64 };
    const int width = job.width, height = job.height, count = job.count;
    const int row_stride = job.row_stride, distorted = job.distorted;
    const float right = job.right, bottom = job.bottom;
    const float *m = job.poses.data, *sides = job.sides.data;
    const int planes = job.planes, plane = index % planes, tile = index / planes;
    const int tiles_x = (width + SIDE - 1) / SIDE;
    const int left = (tile % tiles_x) * SIDE, top = (tile / tiles_x) * SIDE;
    const int columns = width - left < SIDE ? width - left : SIDE;
    const int rows = height - top < SIDE ? height - top : SIDE;
    $points
    alignas(64) int places[2 * SIZE];
    $declare

    for (int start = 0; seen > 0 && start < count; start += CHUNK) {
        const int some = count - start < CHUNK ? count - start : CHUNK;
        alignas(64) float at_x[CHUNK], at_y[CHUNK], at_z[CHUNK];
        alignas(64) int state[CHUNK];  // 0: the frame cannot see the tile, 2: sees all of it
        $cull
        int seeing[CHUNK], views = 0;
        for (int k = 0; k < some; ++k) {
            if (state[k] > 0) seeing[views++] = k;
        }
        // one frame ahead: its places are known, and on their way to the cache, when it is mixed
        for (int turn = 0; turn <= views; ++turn) {
            if (turn < views) {
                const int k = seeing[turn], half = (turn & 1) * SIZE;
                const float* f = m + start + k;
                const float x0 = at_x[k], y0 = at_y[k], z0 = at_z[k];
                $slopes
                const float* l = sides + 9;
                if (state[k] == 2 && seen == SIZE && !distorted) {
                    #pragma clang loop vectorize(enable) vectorize_width(16)
                    for (int i = 0; i < SIZE; ++i) {
                        $project
                        const float u = x * near + 1.0f, v = y * near + 1.0f;
                        const bool in = true;
                        $place
                    }
                } else if (!distorted) {
                    #pragma clang loop vectorize(enable) vectorize_width(16)
                    for (int i = 0; i < SIZE; ++i) {
                        $project
                        float u = x * near, v = y * near;
                        $test
                        $place
                    }
                } else {
                    #pragma clang loop vectorize(enable) vectorize_width(16)
                    for (int i = 0; i < SIZE; ++i) {
                        $project
                        const float xn = x * near, yn = y * near;
                        $distort
                        $test
                        $place
                    }
                }
                const $word* frame = (const $word*)job.words.data
                    + (size_t)__builtin_bit_cast(int, f[12 * count]) * job.frame_stride;
                for (int i = 0; plane == 0 && i < SIZE; i += 8) {
                    const int* at = places + half + i;
                    __builtin_prefetch(frame + at[0]);
                    __builtin_prefetch(frame + at[7] + 1);
                    if (i >= SIZE - SIDE) __builtin_prefetch(frame + at[0] + row_stride);
                }
            }
            if (turn > 0) {
                const int half = ((turn - 1) & 1) * SIZE;
                const float* f = m + start + seeing[turn - 1];
                const $word* frame = (const $word*)job.words.data
                    + (size_t)__builtin_bit_cast(int, f[12 * count]) * job.frame_stride;
                $gains
                $mix
            }
        }
    }
    const size_t first = (size_t)plane * width * height;
    for (int y = 0; y < rows; ++y) {
        for (int x = 0; x < columns; ++x) {
            const int i = y * SIDE + x;
            const size_t pixel = first + (size_t)(top + y) * width + left + x;
            const float weight = $weight;
            const float scale = job.white / (weight > 0.0f ? weight : 1.0f);
            job.footprint.data[pixel] = weight * $unit * job.weight_unit;
            $store
        }
    }
}""")

_DISTORT = """
                        const float r2 = xn * xn + yn * yn;
                        const float radial = 1.0f + r2 * (l[4] + r2 * (l[5] + r2 * l[8]));
                        float u = l[0] * (xn * radial + 2.0f * l[6] * xn * yn
                            + l[7] * (r2 + 2.0f * xn * xn)) + l[2];
                        float v = l[1] * (yn * radial + l[6] * (r2 + 2.0f * yn * yn)
                            + 2.0f * l[7] * xn * yn) + l[3];
                        u = r2 <= l[9] ? u : -9.0f;
"""

_TEST = """
                        const bool in = (z > 0.0f) & (u >= -0.5f) & (v >= -0.5f) & (u <= right)
                            & (v <= bottom) & hit;
                        u = in ? u + 1.0f : 0.0f;
                        v = in ? v + 1.0f : 0.0f;
"""


_PLACE = """
                        const int ui = (int)u, vi = (int)v;
                        const float fu = u - (float)ui, fv = v - (float)vi;
                        places[half + i] = vi * row_stride + ui;
"""


def tile_source(form: Form, way: Way) -> str:
    """Return the C of the tile gather for one form of packed photos and one way into them."""
    channels = range(form.channels)
    gains = "".join(f"const float gain_{c} = f[{13 + c} * count];\n" for c in channels)
    store = "".join(
        f"job.image.data[pixel * {form.channels} + {c}] = {form.sums[c]} * scale;\n"
        for c in channels
    )
    return _TILE.substitute(
        word=form.word,
        declare=form.declare,
        gains=gains,
        points=way.points,
        cull=way.cull,
        slopes=way.slopes,
        project=way.project,
        test=_TEST,
        distort=_DISTORT,
        place=_PLACE + form.place,
        mix=form.mix,
        weight=form.sums[-1],
        unit=form.unit,
        store=store,
    )
