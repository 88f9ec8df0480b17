// Blending kernel: alpha blending of one tile, forward and backward (Kerbl et al. 2023, section 6).
// One thread processes a tile. Its pixels are stored in blocks of 4 x 4, which fit the ellipse of a splat better than
// rows. Splats are processed in batches, several exponentials at a time, because their dependency chains are long.
// Forward loops over blocks: the pixels of a block stay in registers for all splats of the batch that reach it.
// Backward loops over splats: the sums of a splat stay in registers, after the exponentials of all its blocks.
#pragma once

#include "simd.h"
#include "types.h"

namespace gs::GS_NAMESPACE {

constexpr int kBlockVecs = kBlockPixels / kLanes;
// Blocks whose exponentials are computed together.
constexpr int kGroup = kLanes == 16 ? 4 : kLanes == 8 ? 2 : 1;
constexpr uint32_t kAllPixels = (1u << kBlockPixels) - 1;

// Columns and rows of a tile's pixels in their order in memory.
struct PixelTable {
    alignas(64) float x[kTilePixels], y[kTilePixels];
};
static constexpr PixelTable make_pixel_table() {
    PixelTable t = {};
    for (int i = 0; i < kTilePixels; ++i) {
        t.x[i] = float(column_of_pixel(i));
        t.y[i] = float(row_of_pixel(i));
    }
    return t;
}
static constexpr PixelTable kPixels = make_pixel_table();

// Positions of the bits set in a byte.
struct BitTable {
    uint8_t bits[256][8];
};
static constexpr BitTable make_bit_table() {
    BitTable t = {};
    for (int i = 0; i < 256; ++i)
        for (int bit = 0, n = 0; bit < 8; ++bit)
            if (i >> bit & 1)
                t.bits[i][n++] = uint8_t(bit);
    return t;
}
static constexpr BitTable kBits = make_bit_table();

// Writes the positions of a byte's bits, counted from `first`, and returns their number; eight bytes are written.
static inline int write_positions(uint32_t byte, int first, uint8_t *to) {
    uint64_t positions;
    std::memcpy(&positions, kBits.bits[byte], sizeof positions);
    positions += uint64_t(first) * 0x0101010101010101u;
    std::memcpy(to, &positions, sizeof positions);
    return __builtin_popcount(byte);
}

// Consecutive splats of a tile's list.
template <int kCapacity> struct Batch {
    int splats;
    Projected splat[kCapacity];
    // At column x and row y of the tile, u = u0 + ua x + ub y and v = v0 + vc y.
    float u0[kCapacity], v0[kCapacity];
    int32_t index[kCapacity]; // in the tile's list

    // x and y are those of the tile's first pixel.
    void add(const Projected &p, int32_t index_in_list, float x, float y) {
        const int s = splats++;
        splat[s] = p;
        // In double, because for a needle the two terms are large and their sum is small.
        const double dx = double(x) - double(p.mean_x), dy = double(y) - double(p.mean_y);
        u0[s] = float(double(p.ua) * dx + double(p.ub) * dy);
        v0[s] = float(double(p.vc) * dy);
        index[s] = index_in_list;
    }
};

// Coordinates u and v of pixels, and log2 of the unclamped alpha of splat `s`. Together with `exp2_above` the only
// place that decides which splat contributes to which pixel.
struct Reach {
    Vec u, v, log2_alpha;
};
template <class B> static inline Reach reach(const B &b, int s, Vec x, Vec y) {
    const Projected &p = b.splat[s];
    const Vec u = fma(set1(p.ub), y, fma(set1(p.ua), x, set1(b.u0[s]))), v = fma(set1(p.vc), y, set1(b.v0[s]));
    return {u, v, fnma(v, v, fnma(u, u, set1(p.log2_opacity)))};
}

// Prefetches a tile of a picture that is `stride` pixels wide, with `width` floats per pixel.
static inline void fetch_pixels(const float *picture, int width, int stride, int x0, int y0, int columns, int rows) {
    constexpr int kLine = 64 / sizeof(float);
    for (int r = 0; picture && r < rows; ++r) {
        const float *const first = picture + (size_t(y0 + r) * size_t(stride) + size_t(x0)) * size_t(width);
        const float *const last = first + columns * width - 1;
        for (const float *p = first; p < last; p += kLine)
            __builtin_prefetch(p, 1);
        __builtin_prefetch(last, 1);
    }
}

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
        splat[kNobody].log2_opacity = 2 * kLog2AlphaMin;
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
        exp2_above<kCount>(kLog2AlphaMin, q, found);
        for (int j = 0; j < kCount; ++j)
            store(reinterpret_cast<float *>(alpha + i) + j * kLanes, found[j]); // across rows of the array
    }
}
static_assert(kLanes % kBlock == 0);

// Position of a tile in the picture, px; tiles at the right and lower edges may extend beyond it.
struct Area {
    int x0, y0, columns, rows;
    float first_x, first_y; // centre of the first pixel
};
static inline Area area_of(const BlendArgs &a, uint32_t tile) {
    const int x0 = int(tile) % a.tiles_x * kTileWidth, y0 = int(tile) / a.tiles_x * kTileHeight;
    return {x0,
            y0,
            a.width - x0 < kTileWidth ? a.width - x0 : kTileWidth,
            a.height - y0 < kTileHeight ? a.height - y0 : kTileHeight,
            float(x0) + 0.5f,
            float(y0) + 0.5f};
}

// The first channel of a splat after its colours.
static inline int third_channel(uint32_t outputs) { return outputs & GS_OUT_INVERSE_DEPTH ? kChannelInvZ : kChannelZ; }

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
    exp2_above<kGroup * kBlockVecs>(kLog2AlphaMin, q, alpha);
}

// Stops the pixels that splat `index` of the tile's list would complete: stores their transmittance and stop index, and
// sets the splat's weights there to zero. `at` is the block's first pixel, t its transmittance before the splat, w the
// splat's weights and next the transmittance after it.
GS_INLINE void stop_pixels(Ends ends, int at, int32_t index, const Vec *t, Vec *w, Vec *next) {
    for (int k = 0; k < kBlockVecs; ++k) {
        // Pixels completed earlier have a transmittance of zero, so the new ones are the others.
        const Mask fresh = both(ge(set1(kTransmittanceMin), next[k]), gt(t[k], Vec{}));
        const Mask goes_on = gt(next[k], set1(kTransmittanceMin));
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

// Adds a splat with weights w to the pixels of a block, whose transmittance becomes `next`.
template <class C>
GS_INLINE void add_splat(Vec (&pixels)[C::kPlanes][kBlockVecs], const Projected &p, int third, const Vec *w,
                         const Vec *next) {
    for (int k = 0; k < kBlockVecs; ++k) {
        for (int c = 0; c < C::kChannels; ++c)
            pixels[1 + c][k] = fma(w[k], set1(p.channel[c < 3 ? c : third + c - 3]), pixels[1 + c][k]);
        if constexpr (C::kSumAlpha)
            pixels[C::kCover][k] += w[k];
        if constexpr (C::kMedian) {
            const Mask crossed = both(gt(pixels[0][k], set1(0.5f)), ge(set1(0.5f), next[k]));
            const Mask blended = gt(next[k], Vec{}); // not the one that stops the pixel
            pixels[C::kMedianAt][k] += keep(both(crossed, blended), set1(p.channel[kChannelZ]));
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
                w[k] = min(alpha[j * kBlockVecs + k], set1(kAlphaMax)) * pixels[0][k];
                next[k] = pixels[0][k] - w[k];
            }
            if (far) [[unlikely]]
                end_before(batch.splat[s].channel[kChannelZ], far + at, next);
            for (int k = 0; k < kBlockVecs; ++k)
                finished |= bits(ge(set1(kTransmittanceMin), next[k])) << (k * kLanes);
            if (finished != complete) [[unlikely]] {
                stop_pixels(ends, at, batch.index[s], pixels[0], w, next);
                complete = finished;
                if (complete == kAllPixels)
                    passed = i + j + 1;
            }
            if (outputs & GS_COUNT_USEFUL) [[unlikely]]
                for (const Vec weight : w)
                    useful += __builtin_popcount(bits(gt(weight, Vec{})));
            add_splat<C>(pixels, batch.splat[s], third, w, next);
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
    const Vec alpha = min(raw, set1(kAlphaMax));
    const Vec t = quotient(load(ground.trans + at), 1.0f - alpha);
    store(ground.trans + at, t);
    const Vec w = alpha * t;
    Vec own = set1(p.channel[0]) * load(color.v[0] + at);
    for (int k = 1; k < kChannels; ++k)
        own = fma(set1(p.channel[k < 3 ? k : third + k - 3]), load(color.v[k] + at), own);
    const Vec back = load(ground.behind + at);
    const Vec diff = own - back;
    store(ground.behind + at, fma(alpha, diff, back));

    const Vec g = keep(ge(set1(kAlphaMax), raw), w * diff);
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
