// Forward blending kernel: the pictures of one tile.
// Loops over blocks: the pixels of a block stay in registers for all splats of the batch that reach it.
#pragma once

#include "blend.inl.h"

namespace gs::GS_NAMESPACE {

constexpr uint32_t kAllPixels = (1u << kBlockPixels) - 1;

// Forward: splats, and for each block a list of those that reach it.
constexpr int kForwardSplats = 128;
// Splats whose exponentials are computed before blending: one group if it fits into the registers next to the pixels.
constexpr int kRun = kLanes >= 8 ? kGroup : 32;
static_assert(kRun % kGroup == 0);
struct ForwardBatch : Batch<kForwardSplats + 1> {
    // The splat after the last: it reaches no pixel, and pads groups.
    static constexpr int kNobody = kForwardSplats;
    static_assert(kNobody < 256 && kForwardSplats % 8 == 0);

    uint8_t strips[kStrips][kForwardSplats]; // the blocks that a splat reaches, strip by strip
    uint8_t list[kTileBlocks][kForwardSplats + 8];
    int count[kTileBlocks];

    ForwardBatch() {
        splat[kNobody] = {};
        splat[kNobody].log2_opacity = 2 * GS_LOG2_ALPHA_MIN;
        u0[kNobody] = v0[kNobody] = 0;
    }
    bool full() const { return splats == kForwardSplats; }
    void add_reaching(uint32_t blocks, const Projected &p, int32_t index_in_list, float x, float y) {
        for (int k = 0; k < kStrips; ++k)
            strips[k][splats] = uint8_t(blocks >> (8 * k));
        add(p, index_in_list, x, y);
    }
    void make_lists();
};

// Eight bytes as a matrix of bits, transposed (Warren, Hacker's Delight, section 7-3).
static inline uint64_t transposed_bits(uint64_t x) {
    uint64_t t = (x ^ (x >> 7)) & 0x00aa00aa00aa00aau;
    x ^= t ^ (t << 7);
    t = (x ^ (x >> 14)) & 0x0000cccc0000ccccu;
    x ^= t ^ (t << 14);
    t = (x ^ (x >> 28)) & 0x00000000f0f0f0f0u;
    return x ^ t ^ (t << 28);
}

inline void ForwardBatch::make_lists() {
    static_assert(kStripBlocks == 8);
    for (int strip = 0; strip < kStrips; ++strip) {
        int n[kStripBlocks] = {};
        std::memset(strips[strip] + splats, 0, size_t(-splats & 7));
        for (int s = 0; s < splats; s += 8) {
            uint64_t blocks_of_splats;
            std::memcpy(&blocks_of_splats, strips[strip] + s, sizeof blocks_of_splats);
            const uint64_t splats_of_blocks = transposed_bits(blocks_of_splats);
            for (int k = 0; k < kStripBlocks; ++k)
                n[k] += write_positions(splats_of_blocks >> (8 * k) & 0xff, s, list[strip * kStripBlocks + k] + n[k]);
        }
        for (int k = 0; k < kStripBlocks; ++k) {
            count[strip * kStripBlocks + k] = n[k];
            std::memset(list[strip * kStripBlocks + k] + n[k], kNobody, kGroup);
        }
    }
}

// A tile's pixels during blending.
template <int kChannelCount, bool kWithMedian> struct Canvas {
    static constexpr int kChannels = kChannelCount;
    static constexpr bool kMedian = kWithMedian;
    // With depths, alpha is summed, because depths are divided by it and 1 - T loses the digits of faint pixels.
    static constexpr bool kSumAlpha = kChannels >= 4;
    // Transmittance, channels, and if needed the sum of weights and the median depth.
    static constexpr int kCover = 1 + kChannels, kMedianAt = kCover + kSumAlpha, kPlanes = kMedianAt + kMedian;
    alignas(64) float state[kPlanes][kTilePixels];
    uint32_t done[kTileBlocks]; // bit mask of the complete pixels of each block, whose transmittance is zero
};

// State of complete pixels for the backward pass.
struct Ends {
    float *trans;
    int32_t *stop;
};

// Returns the blocks with an incomplete pixel.
template <class C> GS_INLINE uint32_t clear(C &canvas, Ends ends, const Area &area) {
    uint32_t live = 0;
    std::memset(canvas.state, 0, sizeof canvas.state);
    for (int block = 0; block < kTileBlocks; ++block) {
        uint32_t inside = 0;
        for (int k = 0; k < kBlockVecs; ++k) {
            const int at = block * kBlockPixels + k * kLanes;
            const Mask in = both(gt(set1(float(area.columns)), load(kPixels.x + at)),
                                 gt(set1(float(area.rows)), load(kPixels.y + at)));
            store(canvas.state[0] + at, keep(in, set1(1.0f)));
            store(ends.trans + at, Vec{});
            const IVec never = as_int(keep(in, as_float(IVec{} + INT32_MAX)));
            std::memcpy(ends.stop + at, &never, sizeof never);
            inside |= bits(in) << (k * kLanes);
        }
        canvas.done[block] = inside ^ kAllPixels;
        live |= uint32_t(inside != 0) << block;
    }
    return live;
}

// Loads the next splats of the list that reach a block of `live`; returns the entry after them.
GS_INLINE uint32_t fill(ForwardBatch &batch, const BlendArgs &a, const Area &area, uint32_t begin, uint32_t e,
                        uint32_t end, uint32_t live) {
    // Records are fetched this many list entries ahead of their use.
    constexpr uint32_t kPrefetch = 64;
    batch.splats = 0;
    for (; e < end && !batch.full(); ++e) {
        if (e + kPrefetch < end)
            __builtin_prefetch(&a.projected[a.entries[e + kPrefetch].slot]);
        const Entry entry = a.entries[e];
        if (const uint32_t blocks = entry.blocks & live)
            batch.add_reaching(blocks, a.projected[entry.slot], int32_t(e - begin), area.first_x, area.first_y);
    }
    batch.make_lists();
    return e;
}

// Alphas before the clamp, zero below the threshold, of the splats list[0..kGroup) at the pixels of a block.
GS_INLINE void find_alphas(const ForwardBatch &batch, const uint8_t *list, Vec x, const Vec *y, Vec *alpha) {
    Vec q[kGroup * kBlockVecs];
    for (int j = 0; j < kGroup; ++j)
        for (int k = 0; k < kBlockVecs; ++k)
            q[j * kBlockVecs + k] = reach(batch, list[j], x, y[k]).log2_alpha;
    exp2_above<kGroup * kBlockVecs>(GS_LOG2_ALPHA_MIN, q, alpha);
}

// Stops the pixels that splat `index` of the tile's list would complete: stores their transmittance and stop index, and
// sets the splat's weights there to zero. `at` is the block's first pixel, t its transmittance before the splat, w the
// splat's weights and next the transmittance after it.
GS_INLINE void stop_pixels(Ends ends, int at, int32_t index, const Vec *t, Vec *w, Vec *next) {
    for (int k = 0; k < kBlockVecs; ++k) {
        // Pixels completed earlier have a transmittance of zero, so the new ones are the others.
        const Mask fresh = both(ge(set1(GS_TRANSMITTANCE_MIN), next[k]), gt(t[k], Vec{}));
        const Mask goes_on = gt(next[k], set1(GS_TRANSMITTANCE_MIN));
        float *final_at = ends.trans + at + k * kLanes;
        int32_t *stop_at = ends.stop + at + k * kLanes;
        store(final_at, select(fresh, t[k], load(final_at)));
        Vec stops;
        std::memcpy(&stops, stop_at, sizeof stops);
        stops = select(fresh, as_float(IVec{} + index), stops);
        std::memcpy(stop_at, &stops, sizeof stops);
        w[k] = keep(goes_on, w[k]);
        next[k] = keep(goes_on, next[k]);
    }
}

// Adds a splat with weights w to the pixels of a block, whose transmittance becomes `next`; `median` is its value in
// the median depth.
template <class C>
GS_INLINE void add_splat(Vec (&pixels)[C::kPlanes][kBlockVecs], const Projected &p, int third, float median,
                         const Vec *w, const Vec *next) {
    for (int k = 0; k < kBlockVecs; ++k) {
        for (int c = 0; c < C::kChannels; ++c)
            pixels[1 + c][k] = fma(w[k], set1(p.channel[c < 3 ? c : third + c - 3]), pixels[1 + c][k]);
        if constexpr (C::kSumAlpha)
            pixels[C::kCover][k] += w[k];
        if constexpr (C::kMedian) {
            const Mask crossed = both(gt(pixels[0][k], set1(0.5f)), ge(set1(0.5f), next[k]));
            const Mask blended = gt(next[k], Vec{}); // not the one that stops the pixel
            pixels[C::kMedianAt][k] += keep(both(crossed, blended), set1(median));
        }
        pixels[0][k] = next[k];
    }
}

// Sets the transmittance after a splat at depth z to zero in pixels whose far depth is nearer; `far` is the block's.
GS_INLINE void end_before(float z, const float *far, Vec *next) {
    for (int k = 0; k < kBlockVecs; ++k)
        next[k] = select(gt(set1(z), load(far + k * kLanes)), Vec{}, next[k]);
}

// Blends all splats of the batch that reach a block, and removes it from `live` when it is complete; returns the number
// of splats until then. `far` has the far depths of the tile's pixels; null: none.
template <class C>
GS_INLINE int blend_block(C &canvas, Ends ends, const ForwardBatch &batch, int block, uint32_t outputs, int third,
                          const float *far, uint32_t &live, int64_t &useful) {
    const int at = block * kBlockPixels, count = batch.count[block];
    const uint8_t *const list = batch.list[block];
    Vec pixels[C::kPlanes][kBlockVecs];
    for (int c = 0; c < C::kPlanes; ++c)
        for (int k = 0; k < kBlockVecs; ++k)
            pixels[c][k] = load(canvas.state[c] + at + k * kLanes);
    const Vec x = load(kPixels.x + at); // for all vectors of a block, because they are whole rows
    Vec y[kBlockVecs];
    for (int k = 0; k < kBlockVecs; ++k)
        y[k] = load(kPixels.y + at + k * kLanes);
    uint32_t complete = canvas.done[block];
    int passed = count;
    for (int i = 0; i < count; i += kRun) {
        const int run = kRun == kGroup || count - i > kRun ? kRun : count - i;
        Vec alpha[kRun * kBlockVecs];
        for (int first = 0; first < run; first += kGroup)
            find_alphas(batch, list + i + first, x, y, alpha + first * kBlockVecs);
        for (int j = 0; j < run; ++j) {
            const int s = list[i + j];
            Vec w[kBlockVecs], next[kBlockVecs];
            uint32_t finished = 0;
            for (int k = 0; k < kBlockVecs; ++k) {
                w[k] = min(alpha[j * kBlockVecs + k], set1(GS_ALPHA_MAX)) * pixels[0][k];
                next[k] = pixels[0][k] - w[k];
            }
            if (far) [[unlikely]]
                end_before(batch.splat[s].channel[kChannelZ], far + at, next);
            for (int k = 0; k < kBlockVecs; ++k)
                finished |= bits(ge(set1(GS_TRANSMITTANCE_MIN), next[k])) << (k * kLanes);
            if (finished != complete) [[unlikely]] {
                stop_pixels(ends, at, batch.index[s], pixels[0], w, next);
                complete = finished;
                if (complete == kAllPixels)
                    passed = i + j + 1;
            }
            if (outputs & GS_COUNT_USEFUL) [[unlikely]]
                for (const Vec weight : w)
                    useful += __builtin_popcount(bits(gt(weight, Vec{})));
            const Projected &p = batch.splat[s];
            const float median = outputs & GS_MEDIAN_SPLAT ? float(p.id) + 1 : p.channel[kChannelZ];
            add_splat<C>(pixels, p, third, median, w, next);
        }
        if (complete == kAllPixels)
            break;
    }
    for (int c = 0; c < C::kPlanes; ++c)
        for (int k = 0; k < kBlockVecs; ++k)
            store(canvas.state[c] + at + k * kLanes, pixels[c][k]);
    canvas.done[block] = complete;
    live &= ~(uint32_t(complete == kAllPixels) << block);
    return passed;
}

// Writes the tile's part of the pictures.
template <class C>
GS_INLINE void write_pictures(const C &canvas, Ends ends, const BlendArgs &a, uint32_t outputs, const Area &area) {
    for (int i = 0; i < kTilePixels; i += kLanes) // one of the two is zero
        store(ends.trans + i, load(ends.trans + i) + load(canvas.state[0] + i));
    for (int s = 0; s * kBlock < area.columns; ++s)
        for (int r = 0; r < area.rows; ++r) {
            const int first = s * kBlock * kTileHeight + r * kBlock;
            const int count = area.columns - s * kBlock < kBlock ? area.columns - s * kBlock : kBlock;
            const size_t pixel = size_t(area.y0 + r) * size_t(a.width) + size_t(area.x0 + s * kBlock);
            float rgb[3 * kBlock], alpha[kBlock];
            for (int x = 0; x < kBlock; ++x) {
                const float t = ends.trans[first + x];
                for (int k = 0; k < 3; ++k)
                    rgb[3 * x + k] = canvas.state[1 + k][first + x] + t * a.background[k];
                alpha[x] = C::kSumAlpha ? canvas.state[C::kCover][first + x] : 1.0f - t;
            }
            const auto write = [&](float *to, const float *from, int width) {
                if (count == kBlock)
                    std::memcpy(to, from, size_t(width) * kBlock * sizeof(float));
                else
                    std::memcpy(to, from, size_t(width) * size_t(count) * sizeof(float));
            };
            write(a.image.rgb + 3 * pixel, rgb, 3);
            write(a.image.alpha + pixel, alpha, 1);
            if (C::kChannels >= 4 && outputs & GS_OUT_INVERSE_DEPTH)
                write(a.image.inverse_depth + pixel, canvas.state[4] + first, 1);
            if (C::kChannels >= 4 && outputs & GS_OUT_DEPTH)
                write(a.image.depth + pixel, canvas.state[C::kChannels] + first, 1);
            if constexpr (C::kMedian)
                write(a.image.median_depth + pixel, canvas.state[C::kMedianAt] + first, 1);
        }
}

// The tile's part of `far_depths`, in the order of its pixels; 0 beyond the picture.
GS_INLINE void read_far(float *to, const BlendArgs &a, const Area &area) {
    std::memset(to, 0, kTilePixels * sizeof(float));
    for (int s = 0; s * kBlock < area.columns; ++s)
        for (int r = 0; r < area.rows; ++r) {
            const int count = area.columns - s * kBlock < kBlock ? area.columns - s * kBlock : kBlock;
            const size_t pixel = size_t(area.y0 + r) * size_t(a.width) + size_t(area.x0 + s * kBlock);
            // Not below 0, so that the padding splat, at depth 0, stops no pixel.
            for (int x = 0; x < count; ++x) {
                const float far = a.far_depths[pixel + size_t(x)];
                to[s * kBlock * kTileHeight + r * kBlock + x] = far < 0 ? 0 : far;
            }
        }
}

template <int kChannels, bool kMedian>
static PairCount blend_tile(const BlendArgs &a, uint32_t outputs, uint32_t tile) {
    const Area area = area_of(a, tile);
    fetch_pixels(a.image.rgb, 3, a.width, area.x0, area.y0, area.columns, area.rows);
    fetch_pixels(a.image.alpha, 1, a.width, area.x0, area.y0, area.columns, area.rows);
    Canvas<kChannels, kMedian> canvas;
    const Ends ends = {a.final_transmittance + size_t(tile) * kTilePixels, a.stop_index + size_t(tile) * kTilePixels};
    uint32_t live = clear(canvas, ends, area);
    const int third = third_channel(outputs);
    const uint32_t begin = a.tile_begin[tile], end = a.tile_begin[tile + 1];
    alignas(64) float far_depths[kTilePixels];
    const float *const far = a.far_depths ? far_depths : nullptr;
    if (far)
        read_far(far_depths, a, area);
    ForwardBatch batch;
    int64_t evaluated = 0, useful = 0;
    for (uint32_t e = begin; e < end && live;) {
        e = fill(batch, a, area, begin, e, end, live);
        for (uint32_t left = live; left; left &= left - 1) {
            const int block = __builtin_ctz(left);
            if (batch.count[block])
                evaluated += blend_block(canvas, ends, batch, block, outputs, third, far, live, useful);
        }
    }
    write_pictures(canvas, ends, a, outputs, area);
    return {evaluated * kBlockPixels, useful};
}

static PairCount blend(const BlendArgs &a, uint32_t outputs, uint32_t tile) {
    const int extra = bool(outputs & GS_OUT_INVERSE_DEPTH) + bool(outputs & GS_OUT_DEPTH);
    if (outputs & GS_OUT_MEDIAN_DEPTH)
        return extra == 0   ? blend_tile<3, true>(a, outputs, tile)
               : extra == 1 ? blend_tile<4, true>(a, outputs, tile)
                            : blend_tile<5, true>(a, outputs, tile);
    return extra == 0   ? blend_tile<3, false>(a, outputs, tile)
           : extra == 1 ? blend_tile<4, false>(a, outputs, tile)
                        : blend_tile<5, false>(a, outputs, tile);
}

} // namespace gs::GS_NAMESPACE
