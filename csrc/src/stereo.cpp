// Stereo driver: packs the sources for one load per sample, sweeps bands of rows in parallel.
#include "stereo.h"

#include "cpu_dispatch.h"
#include "parallel.h"
#include "thread_count.h"

#include <algorithm>
#include <atomic>
#include <new>
#include <vector>

namespace gs {

namespace {

// Each pixel with its neighbours to the right and below; those beyond the sides repeat the last ones.
std::vector<uint32_t> quads_of(const gs_stereo_source &source) {
    const int64_t width = source.width, height = source.height;
    std::vector<uint32_t> quads(size_t(width * height));
    for (int64_t y = 0; y < height; ++y) {
        const uint8_t *const upper = source.grey + y * width, *const lower = upper + (y + 1 < height ? width : 0);
        for (int64_t x = 0; x < width; ++x) {
            const int64_t right = std::min(x + 1, width - 1);
            quads[size_t(y * width + x)] = uint32_t(upper[x]) | uint32_t(upper[right]) << 8 | uint32_t(lower[x]) << 16 |
                                           uint32_t(lower[right]) << 24;
        }
    }
    return quads;
}

} // namespace

gs_status stereo_sweep(const gs_stereo_sweep_args &args, const gs_stereo_found &found) {
    std::vector<std::vector<uint32_t>> quads;
    std::vector<StereoSource> sources;
    for (int32_t i = 0; i < args.source_count; ++i) {
        const gs_stereo_source &source = args.sources[i];
        quads.push_back(quads_of(source));
        sources.push_back({quads.back().data(), source.width, source.height, source.warp});
    }
    const StereoArgs sweep = {&args, sources.data(), found};
    const StereoBand layout(args.width, args.radius);
    const int threads = threads_of(args.threads), bands = ceil_div(args.height, kStereoRows);
    const size_t floats = layout.scratch_floats();
    std::vector<float> scratch(floats * size_t(std::min(threads, bands)));
    const Kernels &k = kernels();
    parallel_for(size_t(bands), std::min(threads, bands), [&](size_t band, int worker) {
        if (!(args.cancel && *args.cancel))
            k.stereo_sweep(sweep, int(band), scratch.data() + floats * size_t(worker));
    });
    return args.cancel && *args.cancel ? GS_CANCELLED : GS_OK;
}

} // namespace gs
