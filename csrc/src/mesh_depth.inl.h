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
typedef int32_t MeshInts __attribute__((vector_size(4 * kDoubles)));

// Minimum z of a hit, relative to the triangle's largest z.
constexpr double kMeshNearest = 1e-9;
// Distance, px, of a centre from a triangle's bounds within which rounding may decide.
constexpr double kMeshMargin = 0.25;

GS_INLINE MeshDoubles mesh_min(MeshDoubles a, MeshDoubles b) { return b < a ? b : a; }
GS_INLINE MeshDoubles mesh_max(MeshDoubles a, MeshDoubles b) { return a < b ? b : a; }

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
    MeshSpan(int32_t begin, int32_t end) : first(begin), last(end) {}
    MeshSpan(double low, double high, int32_t size)
        : first(int32_t(std::clamp(std::ceil(low - 0.5 - kMeshMargin), 0.0, double(size)))),
          last(int32_t(std::clamp(std::floor(high + 0.5 + kMeshMargin), 0.0, double(size)))) {}
};

// The same of each lane.
struct MeshSpans {
    MeshInts first, last;
    MeshSpans(MeshDoubles low, MeshDoubles high, int32_t size) {
        const MeshDoubles end = double(size) - MeshDoubles{}, none = MeshDoubles{};
        const MeshDoubles begin = mesh_min(mesh_max(none, low - (0.5 + kMeshMargin)), end);
        first = __builtin_convertvector(begin, MeshInts);
        first += __builtin_convertvector(__builtin_convertvector(first, MeshDoubles) < begin, MeshInts) & 1;
        last = __builtin_convertvector(mesh_min(mesh_max(none, high + (0.5 + kMeshMargin)), end), MeshInts);
    }
    MeshSpan lane(int i) const { return {first[i], last[i]}; }
};

// Rows [first, last) of a picture.
struct MeshBand {
    int32_t width, first, last;
    float *inverse_depth; // of the whole picture
};

// Of each corner, a bit for each border of a band, and for the near plane, on whose outer side it is. Linear in
// homogeneous coordinates, so that corners behind the camera need no case of their own.
constexpr uint8_t kMeshNear = 16;

static void mesh_sides(const MeshArgs &a, const MeshBand &band, uint8_t *sides) {
    const double right = band.width, top = band.first, bottom = band.last;
    for (int64_t i = 0; i < a.mesh->corner_count; ++i) {
        const double *const p = a.mesh->corners + 3 * i;
        const double x = p[0], y = p[1], z = p[2];
        sides[i] = uint8_t((x < 0) | (y < top * z) << 1 | (x > right * z) << 2 | (y > bottom * z) << 3 |
                           (z < a.near) * kMeshNear);
    }
}

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

// A function of the pixel that is linear in it, 0 on an edge.
struct MeshEdge {
    double u, v, rest, per_u; // per_u: 1 / u
    double rest_at(double y) const { return v * y + rest; }
};

// A triangle that is ready to be drawn.
struct MeshTriangle {
    MeshEdge edges[3];
    double per; // 1 / z is this share of the edges' sum
    // Inverse depths of the corners farthest from the camera and nearest to it, to which hits are clamped, because
    // rounding may exceed them in degenerate triangles.
    double least, most;
    MeshBounds bounds;

    // Columns of a row that no edge clearly excludes.
    MeshSpan columns(double y, int32_t width) const {
        double low = bounds.low[0], high = bounds.high[0];
        for (const MeshEdge &e : edges) {
            const double at = -e.rest_at(y) * e.per_u;
            if (e.u > 0)
                low = std::max(low, at);
            else if (e.u < 0)
                high = std::min(high, at);
        }
        return MeshSpan(low, high, width);
    }

    void draw(const MeshSpan &rows, const MeshSpan &all, const MeshBand &band) const {
        const bool narrow = all.last - all.first <= kDoubles; // its rows take one step each
        MeshDoubles steps;
        for (int i = 0; i < kDoubles; ++i)
            steps[i] = i + 0.5;
        for (int32_t row = std::max(rows.first, band.first); row < rows.last; ++row) {
            const double y = row + 0.5;
            const double rests[3] = {edges[0].rest_at(y), edges[1].rest_at(y), edges[2].rest_at(y)};
            const MeshSpan span = narrow ? all : columns(y, band.width);
            float *const line = band.inverse_depth + int64_t(row) * band.width;
            for (int32_t column = span.first; column < span.last; column += kDoubles) {
                const MeshDoubles x = steps + double(column);
                const MeshDoubles a = edges[0].u * x + rests[0], b = edges[1].u * x + rests[1],
                                  c = edges[2].u * x + rests[2];
                const MeshDoubles above = mesh_max((a + b + c) * per, least - MeshDoubles{});
                const MeshDoubles value = mesh_min(above, most - MeshDoubles{});
                const auto inside = (a >= 0) & (b >= 0) & (c >= 0) & (x < double(span.last));
                const MeshDoubles hit = inside ? value : MeshDoubles{};
                raise_to(line + column, band.width - column, __builtin_convertvector(hit, MeshFloats));
            }
        }
    }
};

// Triangles that are set up together, one in each lane.
class MeshBatch {
  public:
    explicit MeshBatch(const MeshBand &rows) : band(rows) {}

    void add(const double *const corners[3]) {
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k)
                lanes[i][k][count] = corners[i][k];
        if (++count == kDoubles)
            draw();
    }

    void draw() {
        const MeshDoubles(&p)[3] = lanes[0], (&q)[3] = lanes[1], (&r)[3] = lanes[2];
        const MeshDoubles farthest = mesh_max(mesh_max(p[2], q[2]), r[2]);
        const MeshDoubles nearest = mesh_min(mesh_min(p[2], q[2]), r[2]);
        const MeshDoubles per_z[3] = {1 / p[2], 1 / q[2], 1 / r[2]};
        MeshDoubles low[2], high[2];
        for (int k = 0; k < 2; ++k) {
            const MeshDoubles a = p[k] * per_z[0], b = q[k] * per_z[1], c = r[k] * per_z[2];
            low[k] = mesh_min(mesh_min(a, b), c);
            high[k] = mesh_max(mesh_max(a, b), c);
        }
        Edges edges[3] = {Edges(q, r), Edges(r, p), Edges(p, q)};
        const MeshDoubles volume = edges[0].u * p[0] + edges[0].v * p[1] + edges[0].rest * p[2];
        const MeshDoubles side = volume > 0 ? 1 - MeshDoubles{} : -1 - MeshDoubles{}, per = 1 / (side * volume);
        const double largest = std::numeric_limits<float>::max();
        const MeshDoubles most = nearest > 0 ? mesh_min(largest - MeshDoubles{}, 1 / nearest) : largest - MeshDoubles{};
        const MeshDoubles least = mesh_min(1 / farthest, most);
        for (Edges &e : edges)
            e.turn(side);
        const auto in_front = nearest >= kMeshNearest * farthest;
        const MeshSpans lines(low[1], high[1], band.last), columns(low[0], high[0], band.width);
        for (int i = 0; i < count; ++i) {
            if (volume[i] == 0)
                continue; // edge-on
            MeshBounds bounds = {{low[0][i], low[1][i]}, {high[0][i], high[1][i]}};
            MeshSpan rows = lines.lane(i), all = columns.lane(i);
            if (!in_front[i]) {
                bounds = part_in_front(i);
                rows = MeshSpan(bounds.low[1], bounds.high[1], band.last);
                all = MeshSpan(bounds.low[0], bounds.high[0], band.width);
            }
            if (rows.first >= rows.last || all.first >= all.last)
                continue; // between centres, or behind the camera
            const MeshTriangle one = {
                {edges[0].lane(i), edges[1].lane(i), edges[2].lane(i)}, per[i], least[i], most[i], bounds};
            one.draw(rows, all, band);
        }
        count = 0;
    }

  private:
    // Functions of an edge. The other triangle of the edge gets the exact opposite, so there are no cracks.
    struct Edges {
        MeshDoubles u, v, rest, per_u;
        Edges(const MeshDoubles a[3], const MeshDoubles b[3])
            : u(a[1] * b[2] - a[2] * b[1]), v(a[2] * b[0] - a[0] * b[2]), rest(a[0] * b[1] - a[1] * b[0]) {}
        void turn(MeshDoubles side) {
            u *= side;
            v *= side;
            rest *= side;
            per_u = 1 / u;
        }
        MeshEdge lane(int i) const { return {u[i], v[i], rest[i], per_u[i]}; }
    };

    MeshBounds part_in_front(int lane) const {
        double at[3][3];
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k)
                at[i][k] = lanes[i][k][lane];
        const double *const corners[3] = {at[0], at[1], at[2]};
        return mesh_bounds(corners);
    }

    MeshBand band;
    MeshDoubles lanes[3][3] = {}; // [corner][axis]
    int count = 0;
};

// A triangle without its part nearer than z = near: one or two triangles.
static void draw_clipped(const double *const corners[3], double near, MeshBatch &batch) {
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
        batch.add(part);
    }
}

static void mesh_depth(const MeshArgs &a, int band) {
    const int32_t first = int32_t(int64_t(a.height) * band / a.bands),
                  last = int32_t(int64_t(a.height) * (band + 1) / a.bands);
    const MeshBand rows = {a.width, first, last, a.inverse_depth};
    std::fill(a.inverse_depth + int64_t(first) * a.width, a.inverse_depth + int64_t(last) * a.width, 0.0f);
    uint8_t *const sides = a.sides + band * a.mesh->corner_count;
    mesh_sides(a, rows, sides);
    MeshBatch batch(rows);
    for (int64_t i = 0; i < a.mesh->triangle_count; ++i) {
        const int32_t *const at = a.mesh->triangles + 3 * i;
        const uint8_t p = sides[at[0]], q = sides[at[1]], r = sides[at[2]];
        if (p & q & r)
            continue;
        const double *corners[3];
        for (int k = 0; k < 3; ++k)
            corners[k] = a.mesh->corners + 3 * int64_t(at[k]);
        if (a.near > 0 && ((p | q | r) & kMeshNear))
            draw_clipped(corners, a.near, batch);
        else
            batch.add(corners);
    }
    batch.draw();
}

} // namespace gs::GS_NAMESPACE
