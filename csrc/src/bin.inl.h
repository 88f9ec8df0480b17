// Which tiles, and which rows inside them, a projected splat reaches.
// The region alpha >= 1/255 is an ellipse. Cut by a slab of pixel columns it is convex, so its rows form one interval
// with closed-form ends; tiles and row ranges of both 8-column halves of a tile follow from these intervals alone.
#pragma once

#include "simd.h"
#include "types.h"

namespace gs::GS_NAMESPACE {

constexpr int kSlab = kTile / 2;

// Slack in px that covers rounding of the ends: a row too many costs time, one too few would change the image.
static inline float slack_px(float extent) { return 0.01f + 1e-4f * extent; }

static inline int floor_int(float x) {
    const int i = int(x);
    return i - (float(i) > x);
}

static inline int clamp_int(float x, int low, int high) {
    return x < float(low) ? low : x > float(high) ? high : floor_int(x);
}

static inline uint8_t pack_rows(int first, int last, int tile_first) {
    first = first > tile_first ? first - tile_first : 0;
    last = last < tile_first + kTile - 1 ? last - tile_first : kTile - 1;
    return first > last ? kNoRows : uint8_t(first | last << 4);
}

// What an extent is multiplied by to reach where an opaque splat of the same shape falls to the threshold.
static inline float opaque_extent(const Projected &p) {
    return __builtin_sqrtf(kLog2AlphaMin / (kLog2AlphaMin - p.log2_opacity));
}

static bool bin(const BinArgs &a, size_t begin, size_t end, InstanceBuffer *out, uint32_t *first_instance,
                uint32_t *instance_count) {
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
        first_instance[slot] = 0; // the caller adds the start of this range
        instance_count[slot] = 0;
        if (x_first > x_last || box_first > box_last)
            continue;
        const int slab_first = x_first / kSlab & ~1, slab_last = x_last / kSlab | 1;
        // Where the ellipse is highest: its mean plus (x_top, extent_y).
        const float x_top = -p.ub / p.ua * ey;
        // An even number of slabs at a time: whole tiles.
        for (int s0 = slab_first; s0 <= slab_last; s0 += kLanes) {
            alignas(64) int32_t first_row[kLanes], last_row[kLanes];
            if (!(a.disable & GS_NO_EXACT_CULL)) {
                const Vec left = (iota() + float(s0)) * float(kSlab) + (0.5f - p.mean_x);
                const Vec l = max(left, set1(-ex)), h = min(left + float(kSlab - 1), set1(ex));
                const Vec top = min(max(set1(x_top), l), h), bottom = min(max(set1(-x_top), l), h);
                const Vec ex2 = set1(ex * ex);
                const Vec reach_top = p.half_chord * sqrt(max(fnma(top, top, ex2), Vec{}));
                const Vec reach_bottom = p.half_chord * sqrt(max(fnma(bottom, bottom, ex2), Vec{}));
                const Mask inside = ge(h + sx, l - sx);
                Vec high = fma(set1(p.slope), top, reach_top) + (p.mean_y + (sy - 0.5f));
                Vec low = fma(set1(p.slope), bottom, -reach_bottom) + (p.mean_y + (0.5f - sy));
                // Rounding down by truncation: both are at least zero after the shift by one.
                high = min(max(high, set1(-1.0f)), set1(float(box_last))) + 1.0f;
                low = min(max(low, set1(float(box_first))), set1(float(a.height))) + 1.0f;
                high = select(inside, high, Vec{});
                low = select(inside, low, set1(float(a.height) + 1.0f));
                const IVec last_of = __builtin_convertvector(high, IVec) - 1;
                const IVec first_of = __builtin_convertvector(low, IVec) - 1;
                std::memcpy(last_row, &last_of, sizeof last_row);
                std::memcpy(first_row, &first_of, sizeof first_row);
            } else {
                for (int l = 0; l < kLanes; ++l) {
                    first_row[l] = box_first;
                    last_row[l] = box_last;
                }
            }
            const int slabs = slab_last - s0 + 1 < kLanes ? slab_last - s0 + 1 : kLanes;
            for (int s = 0; s < slabs; s += 2) {
                const int32_t *first = first_row + s, *last = last_row + s;
                const bool none0 = first[0] > last[0], none1 = first[1] > last[1];
                if (none0 && none1)
                    continue;
                const int top = none0 ? first[1] : none1 ? first[0] : first[0] < first[1] ? first[0] : first[1];
                const int end_row = none0 ? last[1] : none1 ? last[0] : last[0] > last[1] ? last[0] : last[1];
                const int tile_x = (s0 + s) / 2;
                if (tile_x >= a.tiles_x)
                    break;
                for (int ty = top / kTile; ty <= end_row / kTile; ++ty) {
                    const uint32_t tile = uint32_t(ty * a.tiles_x + tile_x);
                    if (a.tiles && !a.tiles[tile])
                        continue;
                    RowRange rows = {{none0 ? kNoRows : pack_rows(first[0], last[0], ty * kTile),
                                            none1 ? kNoRows : pack_rows(first[1], last[1], ty * kTile)}};
                    if (rows.half[0] == kNoRows && rows.half[1] == kNoRows)
                        continue;
                    if (a.disable & GS_NO_ROW_RANGE)
                        rows = {{kAllRows, kAllRows}};
                    if (out->size == out->capacity && !out->grow(out))
                        return false;
                    out->data[out->size++] = {tile, slot, rows, 0};
                }
            }
        }
        first_instance[slot] = uint32_t(size_before);
        instance_count[slot] = uint32_t(out->size - size_before);
    }
    return true;
}

} // namespace gs::GS_NAMESPACE
