// Tile binning kernel: the tiles, and the rows inside them, that a projected splat reaches.
// The region alpha >= 1/255 is an ellipse. Its intersection with a slab of pixel columns is convex, so its rows form
// one interval with closed-form ends; the intervals of all strips of a tile give tiles and blocks. Splats within two
// columns of tiles are processed one per lane, wider ones one strip per lane.
#pragma once

#include "raster_types.h"
#include "simd.h"

namespace gs::GS_NAMESPACE {

typedef uint8_t Bytes __attribute__((vector_size(kLanes)));

// Slack for rounding of the ends, px: an extra row costs time, a missing one would change the image.
static inline float slack_px(float extent) { return 0.01f + 1e-4f * extent; }

static inline Vec slack_px(Vec extent) { return 0.01f + 1e-4f * extent; }

static inline int floor_int(float x) {
    const int i = int(x);
    return i - (float(i) > x);
}

static inline int clamp_int(float x, int low, int high) {
    return x < float(low) ? low : x > float(high) ? high : floor_int(x);
}

static inline IVec clamp_int(Vec x, Vec low, Vec high) {
    x = min(max(x, low), high);
    const IVec i = __builtin_convertvector(x, IVec);
    return i + (IVec)(__builtin_convertvector(i, Vec) > x);
}

// x rounded down, for x >= -1.
static inline IVec floor_by_truncation(Vec x) { return __builtin_convertvector(x + 1.0f, IVec) - 1; }

// Bit mask of a strip's blocks in the rows first..last of a tile; `first` is at most kTileHeight, `last` at least -1,
// and a lane may be empty.
static inline IVec blocks_of_rows(Vec first, Vec last) {
    const IVec f = __builtin_convertvector(first, IVec) >> 2;
    const IVec l = __builtin_convertvector(last, IVec) >> 2;
    return ((IVec{} + 0xff) << f) & ((IVec{} + 0xff) >> (kStripBlocks - 1 - l));
}
static_assert(kBlock == 4 && kStripBlocks == 8);

// Factor from an extent to that of an opaque splat of the same shape.
static inline float opaque_extent(const Projected &p) {
    return __builtin_sqrtf(GS_LOG2_ALPHA_MIN / (GS_LOG2_ALPHA_MIN - p.log2_opacity));
}

// Intersections of a strip's columns with ellipses around the origin, of half-widths ex.
struct Slab {
    Vec left, right;
    Mask inside;
};
static inline Slab slab_at(Vec left, Vec ex, Vec sx) {
    const Vec l = max(left, -ex), h = min(left + float(kBlock - 1), ex);
    return {l, h, ge(h + sx, l - sx)};
}

// The first and last row of the intersection, not rounded.
static inline void rows_of_slab(const Slab &slab, Vec ex, Vec x_top, Vec slope, Vec half_chord, Vec mean_y, Vec sy,
                                Vec &first, Vec &last) {
    const Vec top = min(max(x_top, slab.left), slab.right), bottom = min(max(-x_top, slab.left), slab.right);
    const Vec ex2 = ex * ex;
    const Vec reach_top = half_chord * sqrt(max(fnma(top, top, ex2), Vec{}));
    const Vec reach_bottom = half_chord * sqrt(max(fnma(bottom, bottom, ex2), Vec{}));
    last = fma(slope, top, reach_top) + (mean_y + (sy - 0.5f));
    first = fma(slope, bottom, -reach_bottom) + (mean_y + (0.5f - sy));
}

// Appends instances; kPlain: all of them, with all their blocks.
template <bool kPlain> class Appender {
  public:
    Appender(const BinArgs &a, InstanceBuffer *out)
        : a_(a), at_(out->data + out->size), all_rows_(a.disable & GS_NO_ROW_RANGE) {}

    // Appends those with blocks; the buffer has room.
    void add(uint32_t tile, uint32_t blocks) {
        if constexpr (!kPlain) {
            blocks = all_rows_ && blocks ? ~0u : blocks;
            if (a_.tiles)
                blocks &= blocks_drawn(tile);
        }
        *at_ = {tile, blocks};
        at_ += blocks != 0;
    }
    void finish(InstanceBuffer *out) const { out->size = size_t(at_ - out->data); }

  private:
    // The blocks of a tile that gs_host.tiles enables: upper and lower half of each strip.
    uint32_t blocks_drawn(uint32_t tile) const {
        static_assert(kTileWidth == GS_TILE && kTileHeight == 2 * GS_TILE);
        const uint32_t columns = uint32_t(a_.tiles_x), row = 2 * (tile / columns), column = tile % columns;
        const uint8_t *const upper = a_.tiles + size_t(row) * columns + column;
        const bool has_lower = (row + 1) * GS_TILE < uint32_t(a_.height);
        return (upper[0] ? 0x0f0f0f0f : 0) | (has_lower && upper[columns] ? 0xf0f0f0f0 : 0);
    }

    const BinArgs &a_;
    Instance *at_;
    const bool all_rows_;
};

// Appends the instances of a splat of any size; false: out of memory.
template <bool kPlain> static bool bin_wide(const BinArgs &a, const Projected &p, InstanceBuffer *out) {
    const float widen = a.disable & GS_NO_OPACITY_EXTENT ? opaque_extent(p) : 1.0f;
    const float ex = p.extent_x * widen, ey = p.extent_y * widen;
    const float sx = slack_px(ex), sy = slack_px(ey);
    const int x_first = clamp_int(p.mean_x - ex - sx + 0.5f, 0, a.width);
    const int x_last = clamp_int(p.mean_x + ex + sx - 0.5f, -1, a.width - 1);
    const int box_first = clamp_int(p.mean_y - ey - sy + 0.5f, 0, a.height);
    const int box_last = clamp_int(p.mean_y + ey + sy - 0.5f, -1, a.height - 1);
    if (x_first > x_last || box_first > box_last)
        return true;
    const int strip_first = x_first / kTileWidth * kStrips, strip_last = x_last / kBlock;
    const int tile_first = box_first / kTileHeight, tile_last = box_last / kTileHeight;
    // The top of the ellipse: its mean plus (x_top, extent_y).
    const float x_top = -p.ub / p.ua * ey;
    // Vectors of strips start at the same strip as for the splat's own extent, so that the order of its tiles, and the
    // rounding of sums over them, do not change.
    int start = clamp_int(p.mean_x - p.extent_x - slack_px(p.extent_x) + 0.5f, 0, a.width) / kTileWidth * kStrips;
    while (start > strip_first)
        start -= kLanes;
    for (int s0 = start; s0 <= strip_last; s0 += kLanes) {
        const Slab slab = slab_at((iota() + float(s0)) * float(kBlock) + (0.5f - p.mean_x), set1(ex), set1(sx));
        Vec first, last;
        if (!(a.disable & GS_NO_EXACT_CULL)) {
            rows_of_slab(slab, set1(ex), set1(x_top), set1(p.slope), set1(p.half_chord), set1(p.mean_y), set1(sy),
                         first, last);
            last = min(max(last, set1(-1.0f)), set1(float(box_last)));
            first = min(max(first, set1(float(box_first))), set1(float(a.height)));
            last = __builtin_convertvector(floor_by_truncation(last), Vec);
            first = __builtin_convertvector(floor_by_truncation(first), Vec);
        } else {
            first = set1(float(box_first));
            last = set1(float(box_last));
        }
        // An empty intersection stays empty in every tile.
        first = select(slab.inside, first, set1(float(a.height + kTileHeight)));
        last = select(slab.inside, last, set1(-1.0f));
        const int tile_x = s0 / kStrips;
        const int tiles = a.tiles_x - tile_x < kLanes / kStrips ? a.tiles_x - tile_x : kLanes / kStrips;
        for (int ty = tile_first; ty <= tile_last; ++ty) {
            if (out->capacity - out->size < size_t(kLanes / kStrips) && !out->grow(out))
                return false;
            const float y = float(ty * kTileHeight);
            const Vec from = min(max(first - y, Vec{}), set1(float(kTileHeight)));
            const Vec to = min(max(last - y, set1(-1.0f)), set1(float(kTileHeight - 1)));
            const Bytes bytes = __builtin_convertvector(blocks_of_rows(from, to), Bytes);
            uint32_t strips[kLanes / kStrips];
            std::memcpy(strips, &bytes, sizeof strips);
            Appender<kPlain> to_list(a, out);
            for (int t = tile_x < 0 ? -tile_x : 0; t < tiles; ++t)
                to_list.add(uint32_t(ty * a.tiles_x + tile_x + t), strips[t]);
            to_list.finish(out);
        }
    }
    return true;
}

// Limits of `bin_narrow`: splats within this number of tiles. A tile's blocks are the bits of a word.
constexpr int kNarrowColumns = 2, kNarrowRows = 3;

// The tiles of kLanes splats.
struct Narrow {
    alignas(64) int32_t tile[kLanes], rows[kLanes]; // first tile and number of rows; kWide: too many
    alignas(64) uint32_t blocks[kNarrowRows][kNarrowColumns][kLanes];

    static constexpr int kWide = -1;
};

static inline void bin_narrow(const BinArgs &a, const Projected *p, int lanes, Narrow &out) {
    enum { kMeanX, kMeanY, kUa, kUb, kEx, kEy, kSlope, kHalfChord, kColumns };
    alignas(64) float columns[kColumns][kLanes];
    for (int l = 0; l < kLanes; ++l) {
        const Projected &q = p[l < lanes ? l : 0];
        columns[kMeanX][l] = q.mean_x;
        columns[kMeanY][l] = q.mean_y;
        columns[kUa][l] = q.ua;
        columns[kUb][l] = q.ub;
        columns[kEx][l] = q.extent_x;
        columns[kEy][l] = q.extent_y;
        columns[kSlope][l] = q.slope;
        columns[kHalfChord][l] = q.half_chord;
    }
    const Vec mean_x = load(columns[kMeanX]), mean_y = load(columns[kMeanY]);
    const Vec ex = load(columns[kEx]), ey = load(columns[kEy]), sx = slack_px(ex), sy = slack_px(ey);
    const Vec slope = load(columns[kSlope]), half_chord = load(columns[kHalfChord]);
    const Vec x_top = -load(columns[kUb]) / load(columns[kUa]) * ey;
    const Vec none = set1(-1.0f), width = set1(float(a.width)), height = set1(float(a.height));
    const IVec x_first = clamp_int(mean_x - ex - sx + 0.5f, Vec{}, width);
    const IVec x_last = clamp_int(mean_x + ex + sx - 0.5f, none, width - 1.0f);
    const IVec box_first = clamp_int(mean_y - ey - sy + 0.5f, Vec{}, height);
    const IVec box_last = clamp_int(mean_y + ey + sy - 0.5f, none, height - 1.0f);
    // -1 where true, per lane.
    const IVec empty = (IVec)(x_first > x_last) | (IVec)(box_first > box_last);
    const IVec tile_x = x_first >> 4, tile_y = box_first >> 5;
    const IVec more_columns = (x_last >> 4) - tile_x, more_rows = (box_last >> 5) - tile_y;
    const IVec wide = ~empty & ((IVec)(more_columns >= kNarrowColumns) | (IVec)(more_rows >= kNarrowRows));
    const IVec tile = tile_y * a.tiles_x + tile_x, rows = ((more_rows + 1) & ~empty) | wide;
    std::memcpy(out.tile, &tile, sizeof out.tile);
    std::memcpy(out.rows, &rows, sizeof out.rows);

    const IVec strip_first = x_first >> 2, strip_last = x_last >> 2;
    const IVec strips = (strip_last - strip_first + 1) & ~(empty | wide);
    alignas(64) int32_t strips_of[kLanes];
    std::memcpy(strips_of, &strips, sizeof strips_of);
    int most_strips = 0, most_rows = 0;
    for (int l = 0; l < kLanes; ++l) {
        most_strips = strips_of[l] > most_strips ? strips_of[l] : most_strips;
        most_rows = out.rows[l] > most_rows ? out.rows[l] : most_rows;
    }
    const Vec low = __builtin_convertvector(box_first, Vec), high = __builtin_convertvector(box_last, Vec);
    const Vec y = __builtin_convertvector(tile_y << 5, Vec);
    IVec blocks[kNarrowRows][kNarrowColumns] = {};
    for (int s = 0; s < most_strips; ++s) {
        const IVec strip = strip_first + s;
        const Slab slab = slab_at(__builtin_convertvector(strip, Vec) * float(kBlock) + (0.5f - mean_x), ex, sx);
        Vec first, last;
        rows_of_slab(slab, ex, x_top, slope, half_chord, mean_y, sy, first, last);
        last = __builtin_convertvector(floor_by_truncation(min(max(last, none), high)), Vec);
        first = __builtin_convertvector(floor_by_truncation(min(max(first, low), height)), Vec);
        first = select(slab.inside, first, set1(float(a.height + kTileHeight)));
        last = select(slab.inside, last, none);
        // Bit mask of the rows of blocks from the first tile on, eight per tile.
        const Vec from = min(max(first - y, Vec{}), set1(float(kNarrowRows * kTileHeight)));
        const Vec to = min(max(last - y, none), set1(float(kNarrowRows * kTileHeight - 1)));
        const IVec f = __builtin_convertvector(from, IVec) >> 2, t = __builtin_convertvector(to, IVec) >> 2;
        const IVec bits = ((IVec{} + 0xffffff) << f) & ((IVec{} + 0xffffff) >> (23 - t)) & (IVec)(strip <= strip_last);
        const IVec place = strip - (tile_x << 2), at = (place & (kStrips - 1)) << 3;
        const IVec left = (IVec)(place < kStrips);
        for (int r = 0; r < most_rows; ++r) {
            const IVec here = ((bits >> (8 * r)) & 0xff) << at;
            blocks[r][0] |= here & left;
            blocks[r][1] |= here & ~left;
        }
    }
    std::memcpy(out.blocks, blocks, sizeof out.blocks);
}
static_assert(kTileWidth == 16 && kTileHeight == 32 && kBlock == 4 && kNarrowColumns == 2 &&
              kNarrowRows * kStripBlocks == 24);

template <bool kPlain> static bool bin_chunk(const BinArgs &a, int64_t chunk, InstanceBuffer *out) {
    // All together, or one after the other in the order of `bin_wide`.
    constexpr int kColumnsAtOnce = kLanes / kStrips < kNarrowColumns ? kLanes / kStrips : kNarrowColumns;
    const bool all_wide = !kPlain && a.disable & (GS_NO_OPACITY_EXTENT | GS_NO_EXACT_CULL);
    const int64_t begin = chunk * kChunk, end = begin + a.visible[chunk];
    const int tiles_x = a.tiles_x;
    Narrow narrow;
    for (int64_t first = begin; first < end; first += kLanes) {
        if (a.cancel && *a.cancel)
            return true; // the caller polls too, and discards the lists
        const int lanes = end - first < kLanes ? int(end - first) : kLanes;
        if (!all_wide)
            bin_narrow(a, a.projected + first, lanes, narrow);
        for (int l = 0; l < lanes; ++l) {
            const size_t size_before = out->size;
            if (all_wide || narrow.rows[l] == Narrow::kWide) {
                if (!bin_wide<kPlain>(a, a.projected[first + l], out))
                    return false;
            } else {
                if (out->capacity - out->size < size_t(kNarrowColumns * kNarrowRows) && !out->grow(out))
                    return false;
                Appender<kPlain> to_list(a, out);
                for (int c0 = 0; c0 < kNarrowColumns; c0 += kColumnsAtOnce)
                    for (int r = 0; r < narrow.rows[l]; ++r)
                        for (int c = c0; c < c0 + kColumnsAtOnce; ++c)
                            to_list.add(uint32_t(narrow.tile[l] + r * tiles_x + c), narrow.blocks[r][c][l]);
                to_list.finish(out);
            }
            a.spans[first + l] = {uint32_t(size_before), uint32_t(out->size - size_before)};
        }
    }
    return true;
}

static bool bin(const BinArgs &a, int64_t chunk, InstanceBuffer *out) {
    return a.tiles || a.disable ? bin_chunk<false>(a, chunk, out) : bin_chunk<true>(a, chunk, out);
}

} // namespace gs::GS_NAMESPACE
