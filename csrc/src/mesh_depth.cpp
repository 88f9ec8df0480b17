// Mesh depth: triangles against pixel rays in homogeneous coordinates (Olano and Greer 1997), without clipping.
//
// With the corners p0, p1, p2 as (u z, v z, z) and the ray r = (u, v, 1) of a pixel, z r = sum of l_i p_i gives
// l_i / z = r . (p_j x p_k) / D with D = p0 . (p1 x p2). The ray hits the triangle in front of the camera if all three
// are >= 0, and as the l_i add up to 1, their sum is 1 / z.
#include "mesh_depth.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gs {

namespace {

// Minimum z of a hit, relative to the triangle's largest z.
constexpr double kNearest = 1e-9;

// A function of the pixel that is linear in it.
struct Linear {
    double u, v, rest;
    double at(double x, double y) const { return u * x + v * y + rest; }
};

// Function of an edge, 0 on it. The other triangle of the edge gets the exact opposite, so there are no cracks.
Linear edge(const double *a, const double *b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

struct Bounds {
    double low[2] = {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
    double high[2] = {-low[0], -low[0]};

    void add(double x, double y, double z) {
        const double place[2] = {x / z, y / z};
        for (int i = 0; i < 2; ++i) {
            low[i] = std::min(low[i], place[i]);
            high[i] = std::max(high[i], place[i]);
        }
    }
};

// Range of pixels covered by the part in front of the camera.
Bounds bounds_of(const double *const corners[3]) {
    const double most = std::max({corners[0][2], corners[1][2], corners[2][2]}), near = kNearest * most;
    Bounds out;
    for (int i = 0; i < 3 && most > 0; ++i) {
        const double *const a = corners[i], *const b = corners[(i + 1) % 3];
        if (a[2] >= near)
            out.add(a[0], a[1], a[2]);
        if ((a[2] >= near) != (b[2] >= near)) {
            const double t = (near - a[2]) / (b[2] - a[2]);
            out.add(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), near);
        }
    }
    return out;
}

// Pixels [first, last) whose centres may be between two coordinates, with a pixel of margin at both ends for rounding.
struct Span {
    int32_t first, last;
    Span(double low, double high, int32_t size)
        : first(int32_t(std::clamp(std::floor(low - 1), 0.0, double(size)))),
          last(int32_t(std::clamp(std::ceil(high + 1), 0.0, double(size)))) {}
};

// Columns of a row that no edge clearly excludes; `per_u` is 1 / u of each edge.
Span columns_of(const Linear edges[3], const double per_u[3], double y, const Bounds &bounds, int32_t width) {
    double low = bounds.low[0], high = bounds.high[0];
    for (int i = 0; i < 3; ++i) {
        const double at = -(edges[i].v * y + edges[i].rest) * per_u[i];
        if (edges[i].u > 0)
            low = std::max(low, at);
        else if (edges[i].u < 0)
            high = std::min(high, at);
    }
    return Span(low, high, width);
}

// Inverse depths of the corners farthest from the camera and nearest to it, to which hits are clamped, because rounding
// may exceed them in degenerate triangles.
struct Range {
    double low, high;
    explicit Range(const double *const corners[3])
        : low(1 / std::max({corners[0][2], corners[1][2], corners[2][2]})), high(std::numeric_limits<float>::max()) {
        const double nearest = std::min({corners[0][2], corners[1][2], corners[2][2]});
        if (nearest > 0)
            high = std::min(high, 1 / nearest);
        low = std::min(low, high);
    }
};

void draw(const double *const corners[3], int32_t width, int32_t height, float *inverse_depth) {
    Linear edges[3] = {edge(corners[1], corners[2]), edge(corners[2], corners[0]), edge(corners[0], corners[1])};
    const double *const p = corners[0];
    const double volume = edges[0].u * p[0] + edges[0].v * p[1] + edges[0].rest * p[2];
    const Bounds bounds = bounds_of(corners);
    if (volume == 0 || !(bounds.low[0] <= bounds.high[0]))
        return; // edge-on, or behind the camera
    const double side = volume > 0 ? 1 : -1, per = 1 / std::fabs(volume);
    for (Linear &e : edges)
        e = {side * e.u, side * e.v, side * e.rest};
    const double per_u[3] = {1 / edges[0].u, 1 / edges[1].u, 1 / edges[2].u};
    const Range range(corners);
    const Span rows(bounds.low[1], bounds.high[1], height);
    for (int32_t row = rows.first; row < rows.last; ++row) {
        const double y = row + 0.5;
        const Span columns = columns_of(edges, per_u, y, bounds, width);
        float *const line = inverse_depth + int64_t(row) * width;
        // Without branches, so that compilers make vectors of it; inverse depths are above 0.
        for (int32_t column = columns.first; column < columns.last; ++column) {
            const double x = column + 0.5, a = edges[0].at(x, y), b = edges[1].at(x, y), c = edges[2].at(x, y);
            const double sum = (a + b + c) * per, above = sum < range.low ? range.low : sum;
            const double value = above > range.high ? range.high : above;
            const float hit = (a >= 0) & (b >= 0) & (c >= 0) ? float(value) : 0.0f;
            line[column] = line[column] < hit ? hit : line[column];
        }
    }
}

} // namespace

void mesh_depth(const gs_mesh &mesh, int32_t width, int32_t height, float *inverse_depth) {
    std::fill_n(inverse_depth, int64_t(width) * height, 0.0f);
    for (int64_t i = 0; i < mesh.triangle_count; ++i) {
        const int32_t *const rows = mesh.triangles + 3 * i;
        const double *const corners[3] = {mesh.corners + 3 * int64_t(rows[0]), mesh.corners + 3 * int64_t(rows[1]),
                                          mesh.corners + 3 * int64_t(rows[2])};
        draw(corners, width, height, inverse_depth);
    }
}

} // namespace gs
