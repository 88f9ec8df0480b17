// Types: plain data shared by the driver and the kernels of every instruction set.
#pragma once

#include "gscore.h"

#include <cstddef>
#include <cstdint>

namespace gs {

constexpr int ceil_div(int a, int b) { return (a + b - 1) / b; }

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
constexpr float kAlphaMax = GS_ALPHA_MAX;
constexpr float kTransmittanceMin = GS_TRANSMITTANCE_MIN;
constexpr float kLog2AlphaMin = -7.99435343685886f; // log2(1 / 255)
constexpr float kQuatMin = 1e-8f;
// Brighter splats are culled as invalid, because their gradients would overflow, or cancel those of other splats.
constexpr float kColorMax = 1e9f;
// Gaussian exponent -d/2 in base 2: exp(-d / 2) = exp2(-kHalfLog2E * d).
constexpr float kHalfLog2E = 0.72134752044448170f;

// Splats are projected in chunks of this many; part of the numeric definition of sums, so it never depends on threads.
constexpr int64_t kChunk = 1024;
constexpr int64_t chunks_of(int64_t rows) { return (rows + kChunk - 1) / kChunk; }

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
    const gs_camera *camera;
    const gs_options *options;
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
    uint32_t disable;               // bits of gs_options.disable
    const volatile int32_t *cancel; // may be null
    const uint8_t *tiles;           // gs_options.tiles
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

struct LossArgs {
    const gs_loss_args *args;
    double *partial; // [tiles * kLossSums] sums of l1, ssim, mse and, by channel, of the derivative in ln gain
    float *v_image;  // null: no gradient
};

// A tensor under Adam with the constants of its step.
struct AdamTensor {
    gs_adam_tensor t;
    float beta1, beta2, gain1, gain2;     // gain = 1 - beta
    float eps2;                           // eps^2 (1 - beta2^t): added to second moments without bias correction
    float rate;                           // lr sqrt(1 - beta2^t) / (1 - beta1^t)
    const float *drift, *decay1, *decay2; // [GS_ADAM_LAGS] by number of pending steps
};

struct AdamArgs {
    int64_t rows;
    const AdamTensor *tensors;
    int count;
    const int32_t *radii; // [rows] or null
};

struct CatchUpArgs {
    const AdamTensor *tensor;
    const gs_splats *splats;
    const gs_camera *camera; // null: all rows
    float eps2d;
    float *out; // [rows, width], or null: in place
};

// A photo of a stereo sweep; each word contains a pixel, and those to its right, below it, and to the lower right.
struct StereoSource {
    const uint32_t *quads; // [height, width]
    int32_t width, height;
    gs_stereo_warp warp;
};

struct StereoArgs {
    const gs_stereo_sweep_args *args;
    const StereoSource *sources;
    gs_stereo_found found;
};

// Nearest descriptors of the other photo. The closeness is twice the dot product minus the other's squared length,
// which decreases with the squared distance.
struct Nearest {
    int32_t *closeness, *second; // [padded], at least kNoCloseness
    int32_t *row;                // [padded]
};

// Descriptors of a photo, padded with zeros whose squared length excludes them.
struct MatchSide {
    int64_t padded;
    const int16_t *values;          // [padded, GS_DESCRIPTOR_SIZE]
    const int32_t *squared_lengths; // [padded]
    Nearest nearest;
};

struct MatchArgs {
    MatchSide first, second;
    int32_t *packed; // [second.padded * GS_DESCRIPTOR_SIZE / 2]
};

// One instruction set's kernels.
struct Kernels {
    const char *name;
    void (*project)(const ProjectArgs &, int64_t chunk);
    // Instances of a chunk's splats appended to `out`; false: out of memory.
    bool (*bin)(const BinArgs &, int64_t chunk, InstanceBuffer *out);
    PairCount (*blend)(const BlendArgs &, uint32_t outputs, uint32_t tile);
    // Returns the number of pairs evaluated.
    int64_t (*blend_backward)(const BlendBackwardArgs &, uint32_t outputs, uint32_t tile);
    void (*project_backward)(const ProjectBackwardArgs &, int64_t chunk);
    // One tile of `loss_grid`; `scratch` holds its scratch_floats().
    void (*image_loss)(const LossArgs &, int tile, float *scratch);
    // One chunk of rows; returns how many had gradients that are not finite.
    int64_t (*adam_step)(const AdamArgs &, int64_t chunk);
    void (*adam_catch_up)(const CatchUpArgs &, int64_t chunk);
    void (*exp2)(const float *x, float *y, int64_t count);
    // One band of rows of `StereoBand`; `scratch` holds its scratch_floats().
    void (*stereo_sweep)(const StereoArgs &, int band, float *scratch);
    void (*match)(const MatchArgs &);
};

} // namespace gs
