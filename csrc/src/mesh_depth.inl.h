// Mesh depth kernel: triangles against pixel rays in homogeneous coordinates (Olano and Greer 1997).
//
// With the corners p0, p1, p2 as (u z, v z, z) and the ray r = (u, v, 1) of a pixel, z r = sum of l_i p_i gives
// l_i / z = r . (p_j x p_k) / D with D = p0 . (p1 x p2). The ray hits the triangle in front of the camera if all three
// are >= 0, and as the l_i add up to 1, their sum is 1 / z.
#pragma once

#include "mesh_depth.h"
#include "simd.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gs::GS_NAMESPACE {

// Vectors of doubles as wide as the registers, and as many floats and 64-bit masks.
constexpr int kDoubles = kLanes >= 8 ? kLanes / 2 : 2;
typedef double MeshDoubles __attribute__((vector_size(8 * kDoubles)));
typedef float MeshFloats __attribute__((vector_size(4 * kDoubles)));

// Minimum z of a hit, relative to the triangle's largest z.
constexpr double kMeshNearest = 1e-9;
// Distance, px, of a centre from a triangle's bounds within which rounding may decide.
constexpr double kMeshMargin = 0.25;

// A function of the pixel that is linear in it.
struct MeshEdge {
    double u, v, rest;
    double at(double x, double y) const { return u * x + v * y + rest; }
};

// Function of an edge, 0 on it. The other triangle of the edge gets the exact opposite, so there are no cracks.
static MeshEdge mesh_edge(const double *a, const double *b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

struct MeshBounds {
    double low[2] = {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
    double high[2] = {-low[0], -low[0]};

    void add(double x, double y, double z) {
        const double per = 1 / z, place[2] = {x * per, y * per};
        for (int i = 0; i < 2; ++i) {
            low[i] = std::min(low[i], place[i]);
            high[i] = std::max(high[i], place[i]);
        }
    }
};

// Range of pixels covered by the part in front of the camera.
static MeshBounds mesh_bounds(const double *const corners[3]) {
    const double most = std::max({corners[0][2], corners[1][2], corners[2][2]}), near = kMeshNearest * most;
    MeshBounds out;
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

// Pixels [first, last) whose centres may be between two coordinates, with a margin at both ends for rounding.
struct MeshSpan {
    int32_t first, last;
    MeshSpan(double low, double high, int32_t size)
        : first(int32_t(std::clamp(std::ceil(low - 0.5 - kMeshMargin), 0.0, double(size)))),
          last(int32_t(std::clamp(std::floor(high + 0.5 + kMeshMargin), 0.0, double(size)))) {}
};

// Columns of a row that no edge clearly excludes; `per_u` is 1 / u of each edge.
static MeshSpan mesh_columns(const MeshEdge edges[3], const double per_u[3], double y, const MeshBounds &bounds,
                             int32_t width) {
    double low = bounds.low[0], high = bounds.high[0];
    for (int i = 0; i < 3; ++i) {
        const double at = -(edges[i].v * y + edges[i].rest) * per_u[i];
        if (edges[i].u > 0)
            low = std::max(low, at);
        else if (edges[i].u < 0)
            high = std::min(high, at);
    }
    return MeshSpan(low, high, width);
}

// Inverse depths of the corners farthest from the camera and nearest to it, to which hits are clamped, because rounding
// may exceed them in degenerate triangles.
struct MeshRange {
    double low, high;
    explicit MeshRange(const double *const corners[3])
        : low(1 / std::max({corners[0][2], corners[1][2], corners[2][2]})), high(std::numeric_limits<float>::max()) {
        const double nearest = std::min({corners[0][2], corners[1][2], corners[2][2]});
        if (nearest > 0)
            high = std::min(high, 1 / nearest);
        low = std::min(low, high);
    }
};

// Rows [first, last) of a picture.
struct MeshBand {
    int32_t width, first, last;
    float *inverse_depth; // of the whole picture

    // Whether all pixels are on the outer side of one of the band's borders. Linear in homogeneous coordinates, so that
    // corners behind the camera need no case of their own.
    bool misses(const double *const corners[3]) const {
        const double *const a = corners[0], *const b = corners[1], *const c = corners[2];
        const double right = width, top = first, bottom = last;
        return ((a[0] < 0) & (b[0] < 0) & (c[0] < 0)) |
               ((a[1] < top * a[2]) & (b[1] < top * b[2]) & (c[1] < top * c[2])) |
               ((a[0] > right * a[2]) & (b[0] > right * b[2]) & (c[0] > right * c[2])) |
               ((a[1] > bottom * a[2]) & (b[1] > bottom * b[2]) & (c[1] > bottom * c[2]));
    }
};

// Raises the first `count` pixels of a line to hits.
GS_INLINE void raise_to(float *line, int32_t count, MeshFloats hit) {
    const size_t size = size_t(count < kDoubles ? count : kDoubles) * sizeof(float);
    MeshFloats before = {};
    if (count >= kDoubles)
        before = load<MeshFloats>(line);
    else
        std::memcpy(&before, line, size);
    before = before < hit ? hit : before;
    if (count >= kDoubles)
        store(line, before);
    else
        std::memcpy(line, &before, size);
}

static void draw_triangle(const double *const corners[3], const MeshBand &band) {
    const MeshBounds bounds = mesh_bounds(corners);
    const MeshSpan rows(bounds.low[1], bounds.high[1], band.last), all(bounds.low[0], bounds.high[0], band.width);
    if (rows.first >= rows.last || all.first >= all.last)
        return; // between centres, or behind the camera
    MeshEdge edges[3] = {mesh_edge(corners[1], corners[2]), mesh_edge(corners[2], corners[0]),
                         mesh_edge(corners[0], corners[1])};
    const double *const p = corners[0];
    const double volume = edges[0].u * p[0] + edges[0].v * p[1] + edges[0].rest * p[2];
    if (volume == 0)
        return; // edge-on
    const double side = volume > 0 ? 1 : -1, per = 1 / std::fabs(volume);
    for (MeshEdge &e : edges)
        e = {side * e.u, side * e.v, side * e.rest};
    const double per_u[3] = {1 / edges[0].u, 1 / edges[1].u, 1 / edges[2].u};
    const MeshRange range(corners);
    const bool narrow = all.last - all.first <= kDoubles; // its rows take one step each
    MeshDoubles steps;
    for (int i = 0; i < kDoubles; ++i)
        steps[i] = i + 0.5;
    for (int32_t row = std::max(rows.first, band.first); row < rows.last; ++row) {
        const double y = row + 0.5;
        const MeshSpan columns = narrow ? all : mesh_columns(edges, per_u, y, bounds, band.width);
        float *const line = band.inverse_depth + int64_t(row) * band.width;
        for (int32_t column = columns.first; column < columns.last; column += kDoubles) {
            const MeshDoubles x = steps + double(column);
            const MeshDoubles a = edges[0].u * x + edges[0].v * y + edges[0].rest;
            const MeshDoubles b = edges[1].u * x + edges[1].v * y + edges[1].rest;
            const MeshDoubles c = edges[2].u * x + edges[2].v * y + edges[2].rest;
            const MeshDoubles sum = (a + b + c) * per, above = sum < range.low ? range.low - MeshDoubles{} : sum;
            const MeshDoubles value = above > range.high ? range.high - MeshDoubles{} : above;
            const auto inside = (a >= 0) & (b >= 0) & (c >= 0) & (x < double(columns.last));
            const MeshDoubles hit = inside ? value : MeshDoubles{};
            raise_to(line + column, band.width - column, __builtin_convertvector(hit, MeshFloats));
        }
    }
}

// A triangle without its part nearer than z = near: one or two triangles.
static void draw_clipped(const double *const corners[3], double near, const MeshBand &band) {
    double cuts[2][3];
    const double *kept[4];
    int count = 0, cut = 0;
    for (int i = 0; i < 3; ++i) {
        const double *const a = corners[i], *const b = corners[(i + 1) % 3];
        if (a[2] >= near)
            kept[count++] = a;
        if ((a[2] >= near) != (b[2] >= near)) {
            // From the same end in both triangles of an edge, so that there are no cracks.
            const double *const in = a[2] >= near ? a : b, *const out = a[2] >= near ? b : a;
            const double share = (near - in[2]) / (out[2] - in[2]);
            double *const at = cuts[cut++];
            for (int k = 0; k < 3; ++k)
                at[k] = k < 2 ? in[k] + share * (out[k] - in[k]) : near;
            kept[count++] = at;
        }
    }
    for (int i = 2; i < count; ++i) {
        const double *const part[3] = {kept[0], kept[i - 1], kept[i]};
        draw_triangle(part, band);
    }
}

static void mesh_depth(const MeshArgs &a, int band) {
    const int32_t first = int32_t(int64_t(a.height) * band / a.bands),
                  last = int32_t(int64_t(a.height) * (band + 1) / a.bands);
    const MeshBand rows = {a.width, first, last, a.inverse_depth};
    std::fill(a.inverse_depth + int64_t(first) * a.width, a.inverse_depth + int64_t(last) * a.width, 0.0f);
    for (int64_t i = 0; i < a.mesh->triangle_count; ++i) {
        const int32_t *const at = a.mesh->triangles + 3 * i;
        const double *corners[3];
        for (int k = 0; k < 3; ++k)
            corners[k] = a.mesh->corners + 3 * int64_t(at[k]);
        if (rows.misses(corners))
            continue;
        if (a.near > 0 && std::min({corners[0][2], corners[1][2], corners[2][2]}) < a.near)
            draw_clipped(corners, a.near, rows);
        else
            draw_triangle(corners, rows);
    }
}

} // namespace gs::GS_NAMESPACE
