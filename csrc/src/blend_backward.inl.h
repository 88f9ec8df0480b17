// Backward blending kernel: gradients of the splats of one tile.
// Loops over splats: the sums of a splat stay in registers, after the exponentials of all its blocks.
#pragma once

#include "blend.inl.h"

namespace gs::GS_NAMESPACE {

// Backward: splats and items, which are the blocks that each reaches.
constexpr int kBatchItems = 64 + kTileBlocks;
struct BackwardBatch : Batch<kBatchItems> {
    int items;
    int32_t item_end[kBatchItems];
    Moments *moments[kBatchItems]; // destination of a splat's sums
    // Per item; padding is written too, and overwritten.
    uint8_t splat_of[kBatchItems + kTileBlocks], block[kBatchItems + kTileBlocks];
    alignas(64) float alpha[kBatchItems + kGroup][kBlockPixels];
    alignas(64) float u[kBatchItems + kGroup][kBlockPixels], v[kBatchItems + kGroup][kBlockPixels];

    bool full() const { return items > kBatchItems - kTileBlocks; }
    // `blocks` is not empty.
    void add_reaching(uint32_t blocks, const Projected &p, int32_t index_in_list, float x, float y) {
        std::memset(splat_of + items, splats, kTileBlocks);
        for (int k = 0; k < kStrips; ++k)
            items += write_positions(blocks >> (8 * k) & 0xff, k * kStripBlocks, block + items);
        item_end[splats] = items;
        add(p, index_in_list, x, y);
    }
    void find_alphas();
};

// Alphas of all items before the clamp, zero below the threshold.
inline void BackwardBatch::find_alphas() {
    constexpr int kCount = kGroup * kBlockVecs;
    // The last group may be incomplete: it is padded with repetitions.
    for (int i = items; i % kGroup; ++i)
        splat_of[i] = block[i] = 0;
    for (int i = 0; i < items; i += kGroup) {
        Vec q[kCount], found[kCount];
        for (int j = 0; j < kGroup; ++j)
            for (int k = 0; k < kBlockVecs; ++k) {
                const int at = block[i + j] * kBlockPixels, lane = k * kLanes;
                // Vectors of a block are whole rows with the same columns.
                const Reach r = reach(*this, splat_of[i + j], load(kPixels.x + at), load(kPixels.y + at + lane));
                store(u[i + j] + lane, r.u);
                store(v[i + j] + lane, r.v);
                q[j * kBlockVecs + k] = r.log2_alpha;
            }
        exp2_above<kCount>(GS_LOG2_ALPHA_MIN, q, found);
        for (int j = 0; j < kCount; ++j)
            store(reinterpret_cast<float *>(alpha + i) + j * kLanes, found[j]); // across rows of the array
    }
}
static_assert(kLanes % kBlock == 0);

// A tile's pixels in the backward pass, from back to front.
struct Ground {
    alignas(64) float trans[kTilePixels], behind[kTilePixels];
    int32_t block_stop[kTileBlocks]; // the first list entry after the last one that a block needs
};
// dL/dC of a tile's pixels; separate from `Ground`, so that stores there do not invalidate gradients in registers.
template <int kChannels> struct ColorGradients {
    alignas(64) float v[kChannels][kTilePixels];
};

// Loads the tile's part of the gradients of the pictures; `behind` receives that of alpha.
template <int kChannels>
GS_INLINE void read_gradients(Ground &ground, ColorGradients<kChannels> &color, const BlendBackwardArgs &args,
                              uint32_t outputs, const Area &area, uint32_t tile) {
    const BlendArgs &a = *args.forward;
    std::memcpy(ground.trans, a.final_transmittance + size_t(tile) * kTilePixels, sizeof ground.trans);
    std::memset(color.v, 0, sizeof color.v);
    std::memset(ground.behind, 0, sizeof ground.behind);
    const float *planes[2] = {nullptr, nullptr};
    if constexpr (kChannels >= 4)
        planes[0] = outputs & GS_OUT_INVERSE_DEPTH ? args.grads.inverse_depth : args.grads.depth;
    if constexpr (kChannels >= 5)
        planes[1] = args.grads.depth;
    for (int s = 0; s * kBlock < area.columns; ++s)
        for (int r = 0; r < area.rows; ++r) {
            const int first = s * kBlock * kTileHeight + r * kBlock;
            const size_t count = size_t(area.columns - s * kBlock < kBlock ? area.columns - s * kBlock : kBlock);
            const size_t pixel = size_t(area.y0 + r) * size_t(a.width) + size_t(area.x0 + s * kBlock);
            if (args.grads.rgb) {
                float rgb[3 * kBlock] = {};
                if (count == kBlock)
                    std::memcpy(rgb, args.grads.rgb + 3 * pixel, sizeof rgb);
                else
                    std::memcpy(rgb, args.grads.rgb + 3 * pixel, 3 * count * sizeof(float));
                for (int x = 0; x < kBlock; ++x)
                    for (int k = 0; k < 3; ++k)
                        color.v[k][first + x] = rgb[3 * x + k];
            }
            for (int k = 3; k < kChannels; ++k)
                if (planes[k - 3])
                    std::memcpy(color.v[k] + first, planes[k - 3] + pixel, count * sizeof(float));
            if (args.grads.alpha)
                std::memcpy(ground.behind + first, args.grads.alpha + pixel, count * sizeof(float));
        }
}

// Initialises `behind` with the background, and determines the stop of each block, 0 without image gradient; returns
// the last of the stops.
template <int kChannels>
GS_INLINE int32_t find_stops(Ground &ground, const ColorGradients<kChannels> &color, const int32_t *stop,
                             const BlendBackwardArgs &args) {
    int32_t start = 0;
    for (int b = 0; b < kTileBlocks; ++b) {
        int32_t last = 0;
        IVec any = {};
        for (int i = b * kBlockPixels; i < (b + 1) * kBlockPixels; ++i)
            last = stop[i] > last ? stop[i] : last;
        for (int i = b * kBlockPixels; i < (b + 1) * kBlockPixels; i += kLanes) {
            Vec back = -load(ground.behind + i); // the gradient of alpha
            any |= as_int(back);
            for (int k = 0; k < kChannels; ++k)
                any |= as_int(load(color.v[k] + i));
            for (int k = 0; k < 3; ++k)
                back = fma(load(color.v[k] + i), set1(args.forward->background[k]), back);
            store(ground.behind + i, back);
        }
        // Without their signs, because of negative zeros.
        ground.block_stop[b] = !args.skip_zero_tiles || bits(gt_int(any & INT32_MAX, IVec{})) ? last : 0;
        start = ground.block_stop[b] > start ? ground.block_stop[b] : start;
    }
    return start;
}

// State of the traversal of a tile's list, from back to front.
struct Walk {
    uint32_t begin;    // of the list
    int32_t i;         // remaining entries
    uint32_t live;     // blocks reached so far
    int32_t next_stop; // entry at which the next block is reached
};

// Loads the next splats that reach a block; the sums of those that reach none are zero.
GS_INLINE void fill(BackwardBatch &batch, Walk &walk, const BlendBackwardArgs &args, const Area &area,
                    const int32_t *block_stop) {
    // Records are fetched this many list entries ahead of their use.
    constexpr uint32_t kPrefetch = 8;
    const BlendArgs &a = *args.forward;
    batch.splats = batch.items = 0;
    while (walk.i > 0 && !batch.full()) {
        const int32_t i = --walk.i;
        if (i < walk.next_stop) {
            walk.next_stop = 0;
            for (int b = 0; b < kTileBlocks; ++b)
                if (block_stop[b] > i)
                    walk.live |= 1u << b;
                else
                    walk.next_stop = block_stop[b] > walk.next_stop ? block_stop[b] : walk.next_stop;
        }
        const uint32_t e = walk.begin + uint32_t(i);
        if (uint32_t(i) >= kPrefetch)
            __builtin_prefetch(&a.projected[a.entries[e - kPrefetch].slot]);
        const Entry entry = a.entries[e];
        Moments *const moments = args.moments + entry.moment;
        if (const uint32_t blocks = entry.blocks & walk.live) {
            // Written when the batch is done; their addresses are random.
            __builtin_prefetch(moments, 1);
            __builtin_prefetch(moments->v + kMomentCount - 1, 1);
            batch.moments[batch.splats] = moments;
            batch.add_reaching(blocks, a.projected[entry.slot], i, area.first_x, area.first_y);
        } else {
            *moments = {};
        }
    }
    batch.find_alphas();
}

// Backward step of splat p at kLanes pixels, `at` of the tile and `lane` of item n; adds to its sums.
template <int kChannels>
GS_INLINE void pass_pixels(Ground &ground, const ColorGradients<kChannels> &color, const int32_t *stop,
                           const BackwardBatch &batch, const Projected &p, IVec index, int n, int lane, int third,
                           Vec *sums) {
    const int at = batch.block[n] * kBlockPixels + lane;
    IVec stops;
    std::memcpy(&stops, stop + at, sizeof stops);
    // A pixel only receives entries before its stop.
    const Vec raw = keep(gt_int(stops, index), load(batch.alpha[n] + lane));
    const Vec alpha = min(raw, set1(GS_ALPHA_MAX));
    const Vec t = quotient(load(ground.trans + at), 1.0f - alpha);
    store(ground.trans + at, t);
    const Vec w = alpha * t;
    Vec own = set1(p.channel[0]) * load(color.v[0] + at);
    for (int k = 1; k < kChannels; ++k)
        own = fma(set1(p.channel[k < 3 ? k : third + k - 3]), load(color.v[k] + at), own);
    const Vec back = load(ground.behind + at);
    const Vec diff = own - back;
    store(ground.behind + at, fma(alpha, diff, back));

    const Vec g = keep(ge(set1(GS_ALPHA_MAX), raw), w * diff);
    const Vec u = load(batch.u[n] + lane), v = load(batch.v[n] + lane);
    const Vec gu = g * u, gv = g * v;
    sums[kG] += g;
    sums[kGu] += gu;
    sums[kGv] += gv;
    sums[kGuu] = fma(gu, u, sums[kGuu]);
    sums[kGuv] = fma(gu, v, sums[kGuv]);
    sums[kGvv] = fma(gv, v, sums[kGvv]);
    for (int k = 0; k < kChannels; ++k)
        sums[kRed + k] = fma(w, load(color.v[k] + at), sums[kRed + k]);
}

// With C the colour a pixel shows from splat i on (background last) and c_i its own, C_i = alpha_i c_i + (1 - alpha_i)
// C_{i+1}; therefore dL/dalpha_i = T_i (c_i - C_{i+1}) . dL/dC. Walking back to front, `behind` is C_{i+1} . dL/dC and
// T_i = T_{i+1} / (1 - alpha_i). All quantities are relative to the colour behind, so distant splats keep precision.
template <int kChannels>
static int64_t blend_tile_backward(const BlendBackwardArgs &args, uint32_t outputs, uint32_t tile) {
    const BlendArgs &a = *args.forward;
    const uint32_t begin = a.tile_begin[tile], count = a.tile_begin[tile + 1] - begin;
    if (count == 0)
        return 0;
    const Area area = area_of(a, tile);
    fetch_pixels(args.grads.rgb, 3, a.width, area.x0, area.y0, area.columns, area.rows);
    fetch_pixels(args.grads.alpha, 1, a.width, area.x0, area.y0, area.columns, area.rows);
    Ground ground;
    ColorGradients<kChannels> color;
    read_gradients(ground, color, args, outputs, area, tile);
    const int32_t *const stop = a.stop_index + size_t(tile) * kTilePixels;
    int32_t start = find_stops(ground, color, stop, args);
    start = start < int32_t(count) ? start : int32_t(count);
    for (int32_t i = start; i < int32_t(count); ++i)
        args.moments[a.entries[begin + uint32_t(i)].moment] = {};

    const int third = third_channel(outputs);
    BackwardBatch batch;
    Walk walk = {begin, start, 0, start};
    int64_t items = 0;
    while (walk.i > 0) {
        fill(batch, walk, args, area, ground.block_stop);
        items += batch.items;
        for (int s = 0, n = 0; s < batch.splats; ++s) {
            const IVec index = IVec{} + batch.index[s];
            Vec sums[kMomentCount] = {};
            for (; n < batch.item_end[s]; ++n)
                for (int j = 0; j < kBlockVecs; ++j)
                    pass_pixels(ground, color, stop, batch, batch.splat[s], index, n, j * kLanes, third, sums);
            if constexpr (kChannels == 4)
                if (!(outputs & GS_OUT_INVERSE_DEPTH)) {
                    sums[kZ] = sums[kInvZ];
                    sums[kInvZ] = Vec{};
                }
            lane_sums(sums, batch.moments[s]->v);
        }
    }
    return items * kBlockPixels;
}

static int64_t blend_backward(const BlendBackwardArgs &a, uint32_t outputs, uint32_t tile) {
    const int extra = bool(outputs & GS_OUT_INVERSE_DEPTH) + bool(outputs & GS_OUT_DEPTH);
    return extra == 0   ? blend_tile_backward<3>(a, outputs, tile)
           : extra == 1 ? blend_tile_backward<4>(a, outputs, tile)
                        : blend_tile_backward<5>(a, outputs, tile);
}

} // namespace gs::GS_NAMESPACE
