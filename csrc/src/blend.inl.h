// Blending kernels, shared part: alpha blending of one tile (Kerbl et al. 2023, section 6).
// One thread processes a tile. Its pixels are stored in blocks of 4 x 4, which fit the ellipse of a splat better than
// rows. Splats are processed in batches, several exponentials at a time, because their dependency chains are long.
#pragma once

#include "raster_types.h"
#include "simd.h"

namespace gs::GS_NAMESPACE {

constexpr int kBlockVecs = kBlockPixels / kLanes;
// Blocks whose exponentials are computed together.
constexpr int kGroup = kLanes == 16 ? 4 : kLanes == 8 ? 2 : 1;

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

} // namespace gs::GS_NAMESPACE
