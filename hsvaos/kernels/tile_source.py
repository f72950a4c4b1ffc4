"""The tile gather in C: culling, projection and the order of frames; see `tiles`."""

from string import Template

from hsvaos.kernels.tile_forms import Form

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
    const float reach = job.reach, right = job.right, bottom = job.bottom;
    const float *m = job.poses.data, *sides = job.sides.data;
    const int tiles_x = (width + SIDE - 1) / SIDE;
    const int left = (tile % tiles_x) * SIDE, top = (tile / tiles_x) * SIDE;
    const int columns = width - left < SIDE ? width - left : SIDE;
    const int rows = height - top < SIDE ? height - top : SIDE;

    // points of the tile about the middle of their box, so that small differences stay exact
    alignas(64) float px[SIZE], py[SIZE], pz[SIZE], live[SIZE];
    float low[3] = {1e30f, 1e30f, 1e30f}, high[3] = {-1e30f, -1e30f, -1e30f};
    int seen = 0;
    for (int i = 0; i < SIZE; ++i) {
        const int x = i % SIDE, y = i / SIDE;
        live[i] = 0.0f;
        if (x >= columns || y >= rows) continue;
        const wp::vec4& p = job.points.data[(size_t)(top + y) * width + left + x];
        if (!(p[3] > 0.0f)) continue;
        live[i] = 1.0f;
        ++seen;
        px[i] = p[0], py[i] = p[1], pz[i] = p[2];
        for (int k = 0; k < 3; ++k) {
            low[k] = p[k] < low[k] ? p[k] : low[k];
            high[k] = p[k] > high[k] ? p[k] : high[k];
        }
    }
    float middle[3], radius = 0.0f;
    for (int k = 0; k < 3; ++k) {
        middle[k] = 0.5f * (low[k] + high[k]);
        radius += (high[k] - middle[k]) * (high[k] - middle[k]);
    }
    radius = __builtin_sqrtf(radius);
    if (radius > 1000.0f) {  // towards the horizon: exact for the near points, which count
        for (int k = 0; k < 3; ++k) {
            middle[k] = low[k] > 0.0f ? low[k] : (high[k] < 0.0f ? high[k] : 0.0f);
        }
        radius *= 2.0f;
    }
    for (int i = 0; i < SIZE; ++i) {
        px[i] = live[i] > 0.0f ? px[i] - middle[0] : 0.0f;
        py[i] = live[i] > 0.0f ? py[i] - middle[1] : 0.0f;
        pz[i] = live[i] > 0.0f ? pz[i] - middle[2] : 0.0f;
    }

    alignas(64) int places[2 * SIZE];
    $declare
    for (int i = 0; i < SIZE; ++i) { $clear }

    for (int start = 0; seen > 0 && start < count; start += CHUNK) {
        const int some = count - start < CHUNK ? count - start : CHUNK;
        alignas(64) float at_x[CHUNK], at_y[CHUNK], at_z[CHUNK];
        alignas(64) int state[CHUNK];  // 0: the frame cannot see the tile, 2: sees all of it
        #pragma clang loop vectorize(enable)
        for (int k = 0; k < some; ++k) {
            const float* f = m + start + k;
            const float dx = middle[0] - f[9 * count], dy = middle[1] - f[10 * count];
            const float dz = middle[2] - f[11 * count];
            const float x = f[0] * dx + f[count] * dy + f[2 * count] * dz;
            const float y = f[3 * count] * dx + f[4 * count] * dy + f[5 * count] * dz;
            const float z = f[6 * count] * dx + f[7 * count] * dy + f[8 * count] * dz;
            const float away = __builtin_sqrtf(dx * dx + dy * dy);
            // distance of the middle to each side of the view, in units of the sphere's radius
            float least = z - sides[4];
            float most = reach - away;
            const float s0 = (x - sides[0] * z) * sides[5];
            const float s1 = (sides[1] * z - x) * sides[6];
            const float s2 = (y - sides[2] * z) * sides[7];
            const float s3 = (sides[3] * z - y) * sides[8];
            least = s0 < least ? s0 : least;
            least = s1 < least ? s1 : least;
            least = s2 < least ? s2 : least;
            least = s3 < least ? s3 : least;
            least = most < least ? most : least;
            at_x[k] = x;
            at_y[k] = y;
            at_z[k] = z;
            state[k] = (least > -radius ? 1 : 0) + (least > radius ? 1 : 0);
        }
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
                const float m00 = f[0], m01 = f[count], m02 = f[2 * count];
                const float m10 = f[3 * count], m11 = f[4 * count], m12 = f[5 * count];
                const float m20 = f[6 * count], m21 = f[7 * count], m22 = f[8 * count];
                const float ax = middle[0] - f[9 * count], ay = middle[1] - f[10 * count];
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
                for (int i = 0; i < SIZE; i += 8) {
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
    for (int i = 0; i < SIZE; ++i) {
        const int x = i % SIDE, y = i / SIDE;
        if (x >= columns || y >= rows) continue;
        const size_t pixel = (size_t)(top + y) * width + left + x;
        const float weight = $weight;
        const float share = weight > 0.0f ? weight : 1.0f;
        job.footprint.data[pixel] = weight * job.weight_unit;
        $store
    }
}""")

_PROJECT = """
                        const float x = x0 + m00 * px[i] + m01 * py[i] + m02 * pz[i];
                        const float y = y0 + m10 * px[i] + m11 * py[i] + m12 * pz[i];
                        const float z = z0 + m20 * px[i] + m21 * py[i] + m22 * pz[i];
                        const float near = 1.0f / z;
"""

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
                        const float ex = ax + px[i], ey = ay + py[i];
                        const bool in = (z > 0.0f) & (u >= -0.5f) & (v >= -0.5f) & (u <= right)
                            & (v <= bottom) & (ex * ex + ey * ey <= reach * reach)
                            & (live[i] > 0.0f);
                        u = in ? u + 1.0f : 0.0f;
                        v = in ? v + 1.0f : 0.0f;
"""


_PLACE = """
                        const int ui = (int)u, vi = (int)v;
                        const float fu = u - (float)ui, fv = v - (float)vi;
                        places[half + i] = vi * row_stride + ui;
"""


def tile_source(form: Form) -> str:
    """Return the C of the tile gather for one form of packed photos."""
    channels = range(form.channels)
    gains = "".join(f"const float gain_{c} = f[{13 + c} * count];\n" for c in channels)
    store = "".join(
        f"job.image.data[pixel * {form.channels} + {c}] = {form.sums[c]} * job.white / share;\n"
        for c in channels
    )
    return _TILE.substitute(
        word=form.word,
        declare=form.declare,
        clear=form.clear,
        gains=gains,
        project=_PROJECT,
        test=_TEST,
        distort=_DISTORT,
        place=_PLACE + form.place,
        mix=form.mix,
        weight=form.sums[-1],
        store=store,
    )
