// Rasterizer types: plain data shared by its driver and the kernels of every instruction set.
#pragma once

#include "gscore/raster.h"
#include "types.h"

// The layout in std140 and std430 blocks.
static_assert(sizeof(gs_view) == 128 && offsetof(gs_view, background) == 112);

namespace gs {

constexpr int sh_rest_of(int degree) { return (degree + 1) * (degree + 1) - 1; }

constexpr int kTileWidth = GS_LIST_TILE_WIDTH, kTileHeight = GS_LIST_TILE_HEIGHT;
constexpr int kTilePixels = kTileWidth * kTileHeight;
// Order of a tile's pixels in memory: strips of 4 columns from left to right, each row by row. Sixteen consecutive ones
// are a block of 4 x 4.
constexpr int kBlock = 4;
constexpr int kBlockPixels = kBlock * kBlock;
constexpr int kTileBlocks = kTilePixels / kBlockPixels;
constexpr int kStrips = kTileWidth / kBlock, kStripBlocks = kTileHeight / kBlock;
static_assert(kTileBlocks == 32 && kStripBlocks == 8, "the blocks of a tile are the bits of a word, a byte a strip");
constexpr int column_of_pixel(int i) { return i / (kBlock * kTileHeight) * kBlock + i % kBlock; }
constexpr int row_of_pixel(int i) { return i / kBlock % kTileHeight; }

constexpr int kChannelInvZ = 3, kChannelZ = 4;

// A projected splat as the blend loops read it: one cache line.
// With d = pixel - mean: alpha = exp2(log2_opacity - u^2 - v^2), u = ua * dx + ub * dy, v = vc * dy. This factored
// form of the conic keeps needles accurate, where A dx^2 + 2 B dx dy + C dy^2 would cancel.
struct alignas(64) Projected {
    float mean_x, mean_y;
    float ua, ub, vc;
    float log2_opacity;
    float channel[5]; // colour, 1 / z, z
    // The ellipse alpha >= 1/255 for binning: half-sides of its box in px, the slope of the line that halves
    // its vertical chords, and the half-length of the chord at distance x: half_chord * sqrt(extent_x^2 - x^2).
    float extent_x, extent_y, slope, half_chord;
    uint32_t id;
};
static_assert(sizeof(Projected) == 64 && offsetof(Projected, vc) == 16 && offsetof(Projected, channel) == 24 &&
              offsetof(Projected, extent_y) == 48 && offsetof(Projected, id) == 60);

// A splat in a tile's list.
struct Entry {
    uint32_t slot;   // index into Projected
    uint32_t blocks; // bit mask of its blocks
    uint32_t moment; // index into the moments, where all entries of a splat are contiguous
    uint32_t key;    // bits of the depth
};

// The same before sorting into tiles, in the order of a chunk's slots.
struct Instance {
    uint32_t tile;
    uint32_t blocks;
};

// A splat's instances in the list of its chunk.
struct Span {
    uint32_t begin, count;
};

// Sums over the pixels of one entry, and after merging of one splat. With g = dL / d ln(alpha) and u, v as above:
// sum of g, g u, g v, g u^2, g u v, g v^2, then gradients of colour, inverse depth and depth.
enum MomentIndex { kG, kGu, kGv, kGuu, kGuv, kGvv, kRed, kGreen, kBlue, kInvZ, kZ, kMomentCount = 12 };
struct alignas(16) Moments {
    float v[kMomentCount];
};

struct InstanceBuffer {
    Instance *data;
    size_t size, capacity;
    bool (*grow)(InstanceBuffer *self); // makes room for at least 4096 more; false: out of memory
};

struct ProjectArgs {
    const gs_splats *splats;
    const gs_view *view;
    Projected *projected; // [chunks * kChunk], visible ones packed at the start of each chunk
    uint32_t *depth_keys; // same layout: bits of z
    int32_t *radii;       // [N] or null
    int32_t *visible;     // [chunks]
};

struct BinArgs {
    const Projected *projected;
    const int32_t *visible; // [chunks]
    Span *spans;            // [slots]
    int32_t width, height, tiles_x;
    uint32_t disable;               // bits of gs_host.disable
    const volatile int32_t *cancel; // may be null
    const uint8_t *tiles;           // gs_host.tiles
};

struct BlendArgs {
    const Projected *projected;
    const Entry *entries;
    const uint32_t *tile_begin; // [tiles + 1]
    int32_t width, height, tiles_x;
    float background[3];
    const float *far_depths; // [height, width], or null
    gs_image image;
    float *final_transmittance; // [tiles * kTilePixels]
    int32_t *stop_index;        // [tiles * kTilePixels], first entry of the tile that is not blended, or INT32_MAX
};

struct PairCount {
    int64_t evaluated, useful; // useful: counted on request
};

struct BlendBackwardArgs {
    const BlendArgs *forward;
    gs_image_grads grads;
    Moments *moments; // [entries], splat by splat
    bool skip_zero_tiles;
};

struct ProjectBackwardArgs {
    ProjectArgs forward;
    const Span *spans;            // [slots]: a splat's moments, relative to
    const uint32_t *moment_begin; // [chunks]
    const Moments *moments;
    gs_splat_grads grads;
    double *viewmat_partial; // [chunks * 16] or null
};

} // namespace gs
