"""Ways from the pixels of a tile into the photos, in C: by points of a surface, or over planes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Way:
    """C that brings the pixels of a tile into a photo; the parts of `tile_source`.

    Args:
        points: Where the tile is, and how many of its pixels meet the surface, as `seen`.
        cull: Which frames of a chunk see the tile, and where they see its middle.
        slopes: What the frame's projection needs.
        row: What pixels of row j of the tile share.
        project: Homogeneous coordinates x, y, z of pixel i in the photo, and whether it is `hit`.
    """

    points: str
    cull: str
    slopes: str
    row: str
    project: str


_POINTS = """
    const float reach = job.reach;
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
"""

_POINTS_CULL = """
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
"""

_POINTS_SLOPES = """
                const float m00 = f[0], m01 = f[count], m02 = f[2 * count];
                const float m10 = f[3 * count], m11 = f[4 * count], m12 = f[5 * count];
                const float m20 = f[6 * count], m21 = f[7 * count], m22 = f[8 * count];
                const float ax = middle[0] - f[9 * count], ay = middle[1] - f[10 * count];
"""

_POINTS_PROJECT = """
                        const float x = x0 + m00 * px[i] + m01 * py[i] + m02 * pz[i];
                        const float y = y0 + m10 * px[i] + m11 * py[i] + m12 * pz[i];
                        const float z = z0 + m20 * px[i] + m21 * py[i] + m22 * pz[i];
                        const float ex = ax + px[i], ey = ay + py[i];
                        const bool hit = (ex * ex + ey * ey <= reach * reach) & (live[i] > 0.0f);
"""

# Over a plane the way from the view's pixels into a photo is projective: three numbers that are
# linear in the pixel. They are taken about the middle of the tile, in float64.
_PLANE = """
    const double* map = job.maps.data + (size_t)plane * 13;
    const double middle_x = left + 7.5, middle_y = top + 7.5;
    double middle[3];
    for (int k = 0; k < 3; ++k) {
        middle[k] = map[3 * k] * middle_x + map[3 * k + 1] * middle_y + map[3 * k + 2];
    }
    const double scale = map[9] * middle_x + map[10] * middle_y + map[11];
    const float live0 = (float)(scale - map[12]), live1 = (float)map[9], live2 = (float)map[10];
    const float change = 7.5f * (__builtin_fabsf(live1) + __builtin_fabsf(live2));
    const int seen = live0 > change ? SIZE : (live0 > -change ? 1 : 0);
"""

_PLANE_CULL = """
        alignas(64) float slopes[6][CHUNK];
        #pragma clang loop vectorize(enable)
        for (int k = 0; k < some; ++k) {
            const double* f = job.placed.data + start + k;
            double at[3], along[3], down[3];
            for (int c = 0; c < 3; ++c) {
                const double centre = f[(9 + c) * count];
                at[c] = middle[c] - centre * scale;
                along[c] = map[3 * c] - centre * map[9];
                down[c] = map[3 * c + 1] - centre * map[10];
            }
            double to[3][3];
            for (int r = 0; r < 3; ++r) {
                const double a = f[3 * r * count], b = f[(3 * r + 1) * count];
                const double c = f[(3 * r + 2) * count];
                to[r][0] = a * at[0] + b * at[1] + c * at[2];
                to[r][1] = a * along[0] + b * along[1] + c * along[2];
                to[r][2] = a * down[0] + b * down[1] + c * down[2];
            }
            // what is linear is inside, or beyond a side, everywhere if it is so at the corners
            int within = 1, beyond = 31;
            for (int corner = 0; corner < 4; ++corner) {
                const float i = corner & 1 ? 7.5f : -7.5f, j = corner & 2 ? 7.5f : -7.5f;
                const float x = (float)to[0][0] + (float)to[0][1] * i + (float)to[0][2] * j;
                const float y = (float)to[1][0] + (float)to[1][1] * i + (float)to[1][2] * j;
                const float z = (float)to[2][0] + (float)to[2][1] * i + (float)to[2][2] * j;
                const int out = (z > 0.0f ? 0 : 1) | (x >= sides[0] * z ? 0 : 2)
                    | (x <= sides[1] * z ? 0 : 4) | (y >= sides[2] * z ? 0 : 8)
                    | (y <= sides[3] * z ? 0 : 16);
                within = out != 0 ? 0 : within;
                beyond &= out;
            }
            at_x[k] = (float)to[0][0];
            at_y[k] = (float)to[1][0];
            at_z[k] = (float)to[2][0];
            for (int r = 0; r < 3; ++r) {
                slopes[2 * r][k] = (float)to[r][1];
                slopes[2 * r + 1][k] = (float)to[r][2];
            }
            state[k] = beyond != 0 ? 0 : 1 + within;
        }
"""

_PLANE_SLOPES = """
                const float m00 = slopes[0][k], m10 = slopes[2][k], m20 = slopes[4][k];
                alignas(64) float row_x[SIDE], row_y[SIDE], row_z[SIDE];
                #pragma clang loop vectorize(enable) vectorize_width(16)
                for (int j = 0; j < SIDE; ++j) {
                    const float down = (float)j - 7.5f;
                    row_x[j] = x0 + slopes[1][k] * down;
                    row_y[j] = y0 + slopes[3][k] * down;
                    row_z[j] = z0 + slopes[5][k] * down;
                }
"""

_PLANE_ROW = """
                        const float xj = row_x[j], yj = row_y[j], zj = row_z[j];
                        const float live_j = live0 + live2 * ((float)j - 7.5f);
"""

_PLANE_PROJECT = """
                            const float across = (float)c - 7.5f;
                            const float x = xj + m00 * across;
                            const float y = yj + m10 * across;
                            const float z = zj + m20 * across;
                            const bool hit = live_j + live1 * across > 0.0f;
"""

WAYS = {
    "points": Way(_POINTS, _POINTS_CULL, _POINTS_SLOPES, "", _POINTS_PROJECT),
    "plane": Way(_PLANE, _PLANE_CULL, _PLANE_SLOPES, _PLANE_ROW, _PLANE_PROJECT),
}
"""By name: over any surface, whose points are known, or over planes, for undistorted views."""
