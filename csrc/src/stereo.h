// Stereo: sizes of the plane sweep, shared by driver and kernels, and both stages.
#pragma once

#include "gscore/stereo.h"
#include "types.h"

namespace gs {

// Rows per band, swept by one thread: the maps of its pixels fit into the L2 cache.
constexpr int kStereoRows = 24;
// Floats by which a vector may extend beyond a row.
constexpr int kStereoMargin = 16;
// Scores of the planes before the first and after the last.
constexpr float kNoScore = -1.0f, kOutside = -2.0f;
// Minimum distance of the second best peak from the highest one, in planes, exclusive.
constexpr float kStereoNear = 2.0f;

// Memory layout of the rows of a band.
struct StereoBand {
    int radius, window;
    int64_t stride; // floats of a row

    StereoBand(int width, int r)
        : radius(r), window(2 * r + 1), stride(int64_t(ceil_div(width, kStereoMargin) + 2) * kStereoMargin) {}
    // Rows of the reference covered by the windows of a band, below a window's height of zeros.
    int reference_rows() const { return kStereoRows + 2 * radius + window; }
    // Maps of a band's pixels of `StereoSweep`.
    static constexpr int kMaps = 11;
    size_t scratch_floats() const {
        return size_t(reference_rows() + 2 * window + 3 + kMaps * kStereoRows) * size_t(stride);
    }
};

gs_status stereo_sweep(const gs_stereo_sweep_args &args, const gs_stereo_found &found);
void stereo_check(const gs_stereo_check_args &args, uint8_t *agree, uint8_t *contradict, float *inverse_depth);

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

} // namespace gs
