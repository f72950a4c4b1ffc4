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
    const float *m = job.poses.data, *sides = job.sides.data;
    const int planes = job.planes, plane = index % planes, tile = index / planes;
    const int tiles_x = (width + SIDE - 1) / SIDE;
    const int left = (tile % tiles_x) * SIDE, top = (tile / tiles_x) * SIDE;
    const int columns = width - left < SIDE ? width - left : SIDE;
    const int rows = height - top < SIDE ? height - top : SIDE;
    $points
    alignas(64) int places[2 * SIZE];
    $declare
    const float right = job.right * $step, bottom = job.bottom * $step;

    for (int start = 0; seen > 0 && start < count; start += CHUNK) {
        const int some = count - start < CHUNK ? count - start : CHUNK;
        alignas(64) float at_x[CHUNK], at_y[CHUNK], at_z[CHUNK];
        alignas(64) int state[CHUNK];  // 0: the frame cannot see the tile, 2: sees all of it
        $cull
        int seeing[CHUNK], views = 0;
        for (int k = 0; k < some; ++k) {
            if (state[k] > 0) seeing[views++] = k;
        }
        // two frames at a time: what they add up to is read and written once
        for (int turn = 0; turn < views; turn += 2) {
            const $word* frames[2];
            float gains_of[2][$channels];
            const int both = turn + 1 < views;
            for (int which = 0; which < $taken; ++which) {
                const int half = which * SIZE;
                const int k = seeing[turn + (which & both)];
                const float* f = m + start + k;
                const $word* frame = (const $word*)job.words.data
                    + (size_t)__builtin_bit_cast(int, f[12 * count]) * job.frame_stride;
                frames[which] = frame;
                for (int c = 0; c < $channels; ++c) gains_of[which][c] = f[(13 + c) * count];
                const float x0 = at_x[k], y0 = at_y[k], z0 = at_z[k];
                $slopes
                const float* l = sides + 9;
                if (which > both) {  // no second frame is left: nothing of it counts
                    const bool in = false;
                    for (int i = 0; i < SIZE; ++i) {
                        const float u = 0.0f, v = 0.0f;
                        $place
                    }
                } else if (state[k] == 2 && seen == SIZE && !distorted) {
                    $place_inside
                } else if (!distorted) {
                    $place_tested
                } else {
                    $place_distorted
                }
                for (int i = 0; plane == 0 && i < SIZE; i += 8) {
                    const int* at = places + half + i;
                    __builtin_prefetch(frame + at[0]);
                    __builtin_prefetch(frame + at[7] + 1);
                    if (i >= SIZE - SIDE) __builtin_prefetch(frame + at[0] + row_stride);
                }
            }
            $mix
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

# for forms that mix one frame after the other
_EACH = Template("""
            for (int which = 0; which <= both; ++which) {
                const int half = which * SIZE;
                const $word* frame = frames[which];
                const float* gains = gains_of[which];
                $mix
            }
""")

# a row of the tile at a time, in vectors
_PLACES = Template("""
                    for (int j = 0; j < SIDE; ++j) {
                        $row
                        #pragma clang loop vectorize(enable) vectorize_width(16)
                        for (int c = 0; c < SIDE; ++c) {
                            const int i = j * SIDE + c;
                            $project
                            $seen
                            $place
                        }
                    }
""")

_INSIDE = """
                            const float near = $step / z;
                            const float u = x * near + $origin, v = y * near + $origin;
                            const bool in = true;
"""

_TEST = """
                            const bool in = (z > 0.0f) & (u >= -0.5f * $step)
                                & (v >= -0.5f * $step) & (u <= right) & (v <= bottom) & hit;
                            u = in ? u + $origin : 0.0f;
                            v = in ? v + $origin : 0.0f;
"""

_TESTED = f"""
                            const float near = $step / z;
                            float u = x * near, v = y * near;
                            {_TEST}
"""

_DISTORTED = f"""
                            const float xn = x / z, yn = y / z;
                            const float r2 = xn * xn + yn * yn;
                            const float radial = 1.0f + r2 * (l[4] + r2 * (l[5] + r2 * l[8]));
                            float u = $step * (l[0] * (xn * radial + 2.0f * l[6] * xn * yn
                                + l[7] * (r2 + 2.0f * xn * xn)) + l[2]);
                            float v = $step * (l[1] * (yn * radial
                                + l[6] * (r2 + 2.0f * yn * yn) + 2.0f * l[7] * xn * yn) + l[3]);
                            u = r2 <= l[9] ? u : -9.0f * $step;
                            {_TEST}
"""


def tile_source(form: Form, way: Way) -> str:
    """Return the C of the tile gather for one form of packed photos and one way into them."""
    store = "".join(
        f"job.image.data[pixel * {form.channels} + {c}] = {form.sums[c]} * scale;\n"
        for c in range(form.channels)
    )

    def places(seen: str) -> str:
        units = {"step": form.step, "origin": form.origin}
        return _PLACES.substitute(
            row=way.row,
            project=way.project,
            seen=Template(seen).substitute(units),
            place=form.place,
        )

    return _TILE.substitute(
        word=form.word,
        declare=form.declare,
        channels=form.channels,
        points=way.points,
        cull=way.cull,
        slopes=way.slopes,
        step=form.step,
        taken="2" if form.pairs else "1 + both",
        place=form.place,
        place_inside=places(_INSIDE),
        place_tested=places(_TESTED),
        place_distorted=places(_DISTORTED),
        mix=form.mix if form.pairs else _EACH.substitute(mix=form.mix, word=form.word),
        weight=form.sums[-1],
        unit=form.unit,
        store=store,
    )
