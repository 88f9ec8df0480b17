// Which tiles, and which rows inside them, a projected splat reaches.
// The region alpha >= 1/255 is an ellipse. Cut by a slab of pixel columns it is convex, so its rows form one interval
// with closed-form ends; with a slab for each strip of a tile, tiles and blocks follow from these intervals alone.
#pragma once

#include "simd.h"
#include "types.h"

namespace gs::GS_NAMESPACE {

typedef uint8_t Bytes __attribute__((vector_size(kLanes)));

// Slack in px that covers rounding of the ends: a row too many costs time, one too few would change the image.
static inline float slack_px(float extent) { return 0.01f + 1e-4f * extent; }

static inline int floor_int(float x) {
    const int i = int(x);
    return i - (float(i) > x);
}

static inline int clamp_int(float x, int low, int high) {
    return x < float(low) ? low : x > float(high) ? high : floor_int(x);
}

// The rows first..last of a tile as blocks of a strip, a bit each; `first` up to kTile, `last` from -1 on, any lane may
// hold none.
static inline IVec blocks_of_rows(Vec first, Vec last) {
    const IVec f = __builtin_convertvector(first, IVec) >> 2;
    const IVec l = __builtin_convertvector(last, IVec) >> 2;
    return ((IVec{} + 0xf) << f) & ((IVec{} + 0xf) >> (kStrips - 1 - l));
}
static_assert(kBlock == 4 && kStrips == 4);

// The strips' bytes of a tile as its blocks, a bit each.
static inline uint32_t blocks_of_strips(uint32_t bytes) {
    bytes |= bytes >> 4;
    return (bytes & 0xff) | (bytes >> 8 & 0xff00);
}

// What an extent is multiplied by to reach where an opaque splat of the same shape falls to the threshold.
static inline float opaque_extent(const Projected &p) {
    return __builtin_sqrtf(kLog2AlphaMin / (kLog2AlphaMin - p.log2_opacity));
}

static bool bin(const BinArgs &a, size_t begin, size_t end, InstanceBuffer *out, uint32_t *instance_count) {
    for (size_t i = begin; i < end; ++i) {
        const uint32_t slot = a.order[i];
        const Projected &p = a.projected[slot];
        if (i + 8 < end)
            __builtin_prefetch(&a.projected[a.order[i + 8]]);
        const size_t size_before = out->size;
        if (a.cancel && *a.cancel)
            return true; // the caller looks too, and throws the lists away
        const float widen = a.disable & GS_NO_OPACITY_EXTENT ? opaque_extent(p) : 1.0f;
        const float ex = p.extent_x * widen, ey = p.extent_y * widen;
        const float sx = slack_px(ex), sy = slack_px(ey);
        const int x_first = clamp_int(p.mean_x - ex - sx + 0.5f, 0, a.width);
        const int x_last = clamp_int(p.mean_x + ex + sx - 0.5f, -1, a.width - 1);
        const int box_first = clamp_int(p.mean_y - ey - sy + 0.5f, 0, a.height);
        const int box_last = clamp_int(p.mean_y + ey + sy - 0.5f, -1, a.height - 1);
        instance_count[slot] = 0;
        if (x_first > x_last || box_first > box_last)
            continue;
        const int strip_first = x_first / kTile * kStrips, strip_last = x_last / kBlock;
        const int tile_first = box_first / kTile, tile_last = box_last / kTile;
        // Where the ellipse is highest: its mean plus (x_top, extent_y).
        const float x_top = -p.ub / p.ua * ey;
        // Vectors of strips start where they do for the splat's own extent, so that its tiles keep their order, and sums
        // over them their rounding.
        int start = clamp_int(p.mean_x - p.extent_x - slack_px(p.extent_x) + 0.5f, 0, a.width) / kTile * kStrips;
        while (start > strip_first)
            start -= kLanes;
        for (int s0 = start; s0 <= strip_last; s0 += kLanes) {
            const Vec left = (iota() + float(s0)) * float(kBlock) + (0.5f - p.mean_x);
            const Vec l = max(left, set1(-ex)), h = min(left + float(kBlock - 1), set1(ex));
            const Mask inside = ge(h + sx, l - sx);
            Vec first, last;
            if (!(a.disable & GS_NO_EXACT_CULL)) {
                const Vec top = min(max(set1(x_top), l), h), bottom = min(max(set1(-x_top), l), h);
                const Vec ex2 = set1(ex * ex);
                const Vec reach_top = p.half_chord * sqrt(max(fnma(top, top, ex2), Vec{}));
                const Vec reach_bottom = p.half_chord * sqrt(max(fnma(bottom, bottom, ex2), Vec{}));
                last = fma(set1(p.slope), top, reach_top) + (p.mean_y + (sy - 0.5f));
                first = fma(set1(p.slope), bottom, -reach_bottom) + (p.mean_y + (0.5f - sy));
                // Rounding down by truncation: both are at least zero after the shift by one.
                last = min(max(last, set1(-1.0f)), set1(float(box_last))) + 1.0f;
                first = min(max(first, set1(float(box_first))), set1(float(a.height))) + 1.0f;
                last = __builtin_convertvector(__builtin_convertvector(last, IVec) - 1, Vec);
                first = __builtin_convertvector(__builtin_convertvector(first, IVec) - 1, Vec);
            } else {
                first = set1(float(box_first));
                last = set1(float(box_last));
            }
            // What is empty stays so in every tile.
            first = select(inside, first, set1(float(a.height + kTile)));
            last = select(inside, last, set1(-1.0f));
            const int tile_x = s0 / kStrips;
            const int tiles = a.tiles_x - tile_x < kLanes / kStrips ? a.tiles_x - tile_x : kLanes / kStrips;
            for (int ty = tile_first; ty <= tile_last; ++ty) {
                if (out->capacity - out->size < size_t(kLanes / kStrips) && !out->grow(out))
                    return false;
                const float y = float(ty * kTile);
                const Vec from = min(max(first - y, Vec{}), set1(float(kTile)));
                const Vec to = min(max(last - y, set1(-1.0f)), set1(float(kTile - 1)));
                const Bytes bytes = __builtin_convertvector(blocks_of_rows(from, to), Bytes);
                uint32_t strips[kLanes / kStrips];
                std::memcpy(strips, &bytes, sizeof strips);
                for (int t = tile_x < 0 ? -tile_x : 0; t < tiles; ++t) {
                    const uint32_t tile = uint32_t(ty * a.tiles_x + tile_x + t);
                    const uint32_t blocks = blocks_of_strips(strips[t]);
                    out->data[out->size] = {tile, slot, a.disable & GS_NO_ROW_RANGE ? 0xffff : blocks};
                    out->size += blocks != 0 && (!a.tiles || a.tiles[tile]);
                }
            }
        }
        instance_count[slot] = uint32_t(out->size - size_before);
    }
    return true;
}

} // namespace gs::GS_NAMESPACE
