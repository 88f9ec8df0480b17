// Drives the stages: project, sort, bin, blend; and back.
#include "raster.h"

#include "dispatch.h"
#include "loss.h"
#include "parallel.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>

#if defined(__linux__)
#include <sys/mman.h>
#endif

using namespace gs;

namespace {

constexpr size_t kHugePage = size_t(2) << 20;

std::align_val_t alignment_of(size_t bytes) { return std::align_val_t(bytes < kHugePage ? 64 : kHugePage); }

} // namespace

void *gs::allocate_pages(size_t bytes) {
    void *const p = ::operator new(bytes, alignment_of(bytes));
#if defined(__linux__)
    // The last page only where it is ours to the end. Where this fails, small pages do.
    if (bytes >= kHugePage)
        madvise(p, bytes / kHugePage * kHugePage, MADV_HUGEPAGE);
#endif
    return p;
}

void gs::free_pages(void *p, size_t bytes) { ::operator delete(p, alignment_of(bytes)); }

namespace {

class Timer {
  public:
    double lap_ms() {
        const auto now = std::chrono::steady_clock::now();
        const double ms = std::chrono::duration<double, std::milli>(now - last_).count();
        last_ = now;
        return ms;
    }

  private:
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

int threads_of(int32_t wanted) { return wanted > 0 ? wanted : default_threads(); }

int64_t chunks_of(int64_t count) { return (count + kChunk - 1) / kChunk; }

constexpr size_t kCancelEvery = 1 << 16; // entries scattered between two looks at the flag

bool cancelled(const volatile int32_t *cancel) { return cancel && *cancel; }

} // namespace

bool GrowingInstances::grow_more(InstanceBuffer *self) {
    const size_t wanted = self->capacity ? self->capacity * 2 : 4096;
    void *p = std::realloc(self->data, wanted * sizeof(Instance));
    if (!p)
        return false;
    self->data = static_cast<Instance *>(p);
    self->capacity = wanted;
    return true;
}

ProjectArgs gs_raster::project_args(const gs_splats &splats) const {
    return {&splats, &camera_, &options_, projected_.get(), depth_keys_.get(), nullptr, visible_.get()};
}

// Stable radix sort of the visible splats by the bits of z, which is positive, so bits order like values; ties keep the
// order of ids.
void gs_raster::sort_by_depth(size_t count, int) {
    constexpr int kBits = 11, kBuckets = 1 << kBits, kPasses = 3;
    uint32_t *keys = keys_.get(), *order = order_.get();
    uint32_t *keys_to = keys_scratch_.ensure(count), *order_to = order_scratch_.ensure(count);
    uint32_t histogram[kPasses][kBuckets] = {};
    for (size_t i = 0; i < count; ++i)
        for (int p = 0; p < kPasses; ++p)
            ++histogram[p][keys[i] >> (p * kBits) & (kBuckets - 1)];
    for (int p = 0; p < kPasses; ++p) {
        uint32_t start = 0;
        for (uint32_t &h : histogram[p]) {
            const uint32_t n = h;
            h = start;
            start += n;
        }
        for (size_t i = 0; i < count; ++i) {
            const uint32_t at = histogram[p][keys[i] >> (p * kBits) & (kBuckets - 1)]++;
            keys_to[at] = keys[i];
            order_to[at] = order[i];
        }
        std::swap(keys, keys_to);
        std::swap(order, order_to);
    }
    // An odd number of passes ends in the scratch buffers.
    std::swap(order_, order_scratch_);
    std::swap(keys_, keys_scratch_);
}

gs_status gs_raster::bin(const BinArgs &args, size_t count, uint32_t tiles, int threads) {
    // Ranges of splats in depth order are listed independently, then scattered to their tiles with one cursor per
    // (range, tile), which keeps depth order whatever the number of ranges.
    const int ranges = int(std::clamp<size_t>(count / 2048, 1, size_t(std::min(kMaxRanges, 2 * threads))));
    uint32_t *first = moment_begin_.get(), *number = moment_count_.get();
    const auto range_begin = [&](int r) { return count * size_t(r) / size_t(ranges); };
    std::atomic<bool> out_of_memory{false};
    const Kernels &k = kernels();
    uint32_t *cursor = tile_cursor_.ensure(size_t(ranges) * tiles);
    parallel_for(size_t(ranges), threads, [&](size_t r, int) {
        GrowingInstances &out = instances_[r];
        out.size = 0;
        if (!k.bin(args, range_begin(int(r)), range_begin(int(r) + 1), &out, number)) {
            out_of_memory = true;
            return;
        }
        uint32_t *counts = cursor + r * tiles;
        std::memset(counts, 0, tiles * sizeof(uint32_t));
        for (size_t i = 0; i < out.size; ++i)
            ++counts[out.data[i].tile];
    });
    if (out_of_memory)
        throw std::bad_alloc();
    if (cancelled(args.cancel))
        return GS_CANCELLED;
    size_t total = 0;
    for (int r = 0; r < ranges; ++r)
        total += instances_[r].size;
    if (total > size_t(INT32_MAX))
        return GS_TOO_MANY;
    entry_count_ = total;
    uint32_t *begin = tile_begin_.ensure(size_t(tiles) + 1);
    uint32_t running = 0;
    for (uint32_t t = 0; t < tiles; ++t) {
        begin[t] = running;
        for (int r = 0; r < ranges; ++r) {
            const uint32_t n = cursor[size_t(r) * tiles + t];
            cursor[size_t(r) * tiles + t] = running;
            running += n;
        }
    }
    begin[tiles] = running;
    // Moments lie in the order of the slots: the pass back reads them one after the other.
    uint32_t moment = 0;
    for (int64_t c = 0; c < chunks_of(splat_count_); ++c)
        for (int64_t slot = c * kChunk; slot < c * kChunk + visible_.get()[c]; ++slot) {
            first[slot] = moment;
            moment += number[slot];
        }
    Entry *entries = entries_.ensure(total);
    parallel_for(size_t(ranges), threads, [&](size_t r, int) {
        const Instance *in = instances_[r].data;
        uint32_t *at = cursor + r * tiles;
        for (size_t i = range_begin(int(r)); i < range_begin(int(r) + 1); ++i) {
            if (i % kCancelEvery == 0 && cancelled(args.cancel))
                return;
            const uint32_t slot = args.order[i];
            for (uint32_t n = 0; n < number[slot]; ++n, ++in)
                entries[at[in->tile]++] = {slot, in->blocks, first[slot] + n};
        }
    });
    return GS_OK;
}

gs_status gs_raster::forward(const gs_splats &splats, const gs_camera &camera, const gs_options &options,
                             const gs_image &image) {
    valid_ = false;
    stats = {};
    camera_ = camera;
    options_ = options;
    options_.threads = threads_of(options.threads);
    splat_count_ = splats.count;
    const int threads = options_.threads;
    const Kernels &k = kernels();
    Timer timer;

    const int64_t chunks = chunks_of(splats.count);
    const size_t slots = size_t(chunks) * size_t(kChunk);
    projected_.ensure(slots);
    depth_keys_.ensure(slots);
    visible_.ensure(size_t(chunks));
    moment_begin_.ensure(slots);
    moment_count_.ensure(slots);
    ProjectArgs project = project_args(splats);
    project.radii = image.radii;
    parallel_for(size_t(chunks), threads, [&](size_t c, int) {
        if (cancelled(options.cancel))
            return;
        k.project(project, int64_t(c));
    });
    if (cancelled(options.cancel))
        return GS_CANCELLED;
    size_t visible = 0;
    for (int64_t c = 0; c < chunks; ++c)
        visible += size_t(visible_.get()[c]);
    uint32_t *order = order_.ensure(visible), *keys = keys_.ensure(visible);
    size_t at = 0;
    for (int64_t c = 0; c < chunks; ++c)
        for (int32_t i = 0; i < visible_.get()[c]; ++i, ++at) {
            order[at] = uint32_t(c * kChunk + i);
            keys[at] = depth_keys_.get()[c * kChunk + i];
        }
    stats.project_ms = timer.lap_ms();
    sort_by_depth(visible, threads);
    stats.sort_ms = timer.lap_ms();

    const int tiles_x = (camera.width + kTile - 1) / kTile, tiles_y = (camera.height + kTile - 1) / kTile;
    const uint32_t tiles = uint32_t(tiles_x) * uint32_t(tiles_y);
    const BinArgs bins = {projected_.get(), order_.get(), camera.width,
                          camera.height,    tiles_x,      options.disable,
                          options.cancel,   options.tiles};
    if (const gs_status s = bin(bins, visible, tiles, threads))
        return s;
    if (cancelled(options.cancel))
        return GS_CANCELLED;
    stats.bin_ms = timer.lap_ms();

    blend_.projected = projected_.get();
    blend_.entries = entries_.get();
    blend_.tile_begin = tile_begin_.get();
    blend_.width = camera.width;
    blend_.height = camera.height;
    blend_.tiles_x = tiles_x;
    std::copy_n(options.background, 3, blend_.background);
    blend_.image = image;
    blend_.final_transmittance = final_transmittance_.ensure(size_t(tiles) * kTilePixels);
    blend_.stop_index = stop_index_.ensure(size_t(tiles) * kTilePixels);
    std::atomic<int64_t> pairs{0}, useful{0};
    parallel_for(tiles, threads, [&](size_t t, int) {
        if (cancelled(options.cancel))
            return;
        const PairCount found = k.blend(blend_, options.outputs, uint32_t(t));
        pairs += found.evaluated;
        useful += found.useful;
    });
    blend_.image = {}; // the caller's arrays may be gone by the backward call
    options_.cancel = nullptr;
    options_.tiles = nullptr;
    if (cancelled(options.cancel))
        return GS_CANCELLED;
    stats.blend_ms = timer.lap_ms();
    stats.visible = int64_t(visible);
    stats.entries = int64_t(entry_count_);
    stats.forward_pairs = pairs;
    stats.useful_pairs = useful;
    stats.workspace_bytes = workspace_bytes();
    valid_ = true;
    return GS_OK;
}

gs_status gs_raster::backward(const gs_splats &splats, const gs_image_grads &image_grads, const gs_splat_grads &grads,
                              const volatile int32_t *cancel) {
    if (!valid_ || splats.count != splat_count_)
        return GS_BAD_ARGUMENT;
    if (camera_.orthographic)
        return GS_UNSUPPORTED;
    const Kernels &k = kernels();
    const int threads = options_.threads;
    Timer timer;
    const uint32_t tiles = uint32_t(blend_.tiles_x) * uint32_t((blend_.height + kTile - 1) / kTile);
    const BlendBackwardArgs args = {&blend_, image_grads, moments_.ensure(entry_count_),
                                    !(options_.disable & GS_NO_ZERO_TILE)};
    std::atomic<int64_t> pairs{0};
    parallel_for(tiles, threads, [&](size_t t, int) {
        if (!cancelled(cancel))
            pairs += k.blend_backward(args, options_.outputs, uint32_t(t));
    });
    if (cancelled(cancel))
        return GS_CANCELLED;
    stats.backward_pairs = pairs;
    stats.blend_backward_ms = timer.lap_ms();

    const int64_t chunks = chunks_of(splats.count);
    ProjectBackwardArgs project = {project_args(splats), moment_begin_.get(), moment_count_.get(),
                                   moments_.get(),       grads,               nullptr};
    if (grads.viewmat)
        project.viewmat_partial = viewmat_partial_.ensure(size_t(chunks) * 16);
    parallel_for(size_t(chunks), threads, [&](size_t c, int) {
        if (!cancelled(cancel))
            k.project_backward(project, int64_t(c));
    });
    if (cancelled(cancel))
        return GS_CANCELLED;
    if (grads.viewmat)
        for (int i = 0; i < 16; ++i) {
            double sum = 0;
            for (int64_t c = 0; c < chunks; ++c)
                sum += project.viewmat_partial[c * 16 + i];
            grads.viewmat[i] = float(sum);
        }
    stats.project_backward_ms = timer.lap_ms();
    stats.workspace_bytes = workspace_bytes();
    return GS_OK;
}

gs_status gs_raster::image_loss(const gs_loss_args &args, gs_loss_result &result, float *v_image) {
    const Kernels &k = kernels();
    const int threads = threads_of(args.threads), bands = loss_bands(args.height);
    const size_t scratch = loss_scratch_floats(args.width);
    float *scratches = loss_scratch_.ensure(scratch * size_t(std::min(threads, bands)));
    const LossArgs loss = {&args, loss_partial_.ensure(size_t(bands) * 3), v_image};
    parallel_for(size_t(bands), threads,
                 [&](size_t b, int worker) { k.image_loss(loss, int(b), scratches + scratch * size_t(worker)); });
    double sums[3] = {};
    for (int b = 0; b < bands; ++b)
        for (int i = 0; i < 3; ++i)
            sums[i] += loss.partial[3 * b + i];
    const double n = 3.0 * args.width * args.height;
    result.l1 = sums[0] / n;
    result.ssim = sums[1] / n;
    result.mse = sums[2] / n;
    const double w = double(args.ssim_weight);
    result.loss = (1.0 - w) * result.l1 + w * (1.0 - result.ssim);
    return GS_OK;
}

gs_status gs_raster::projected(float *means2d, float *depths, float *conics, float *colors, float *opacities) const {
    if (!valid_)
        return GS_BAD_ARGUMENT;
    const auto clear = [&](float *p, size_t width) {
        if (p)
            std::memset(p, 0, size_t(splat_count_) * width * sizeof(float));
    };
    clear(means2d, 2);
    clear(depths, 1);
    clear(conics, 3);
    clear(colors, 3);
    clear(opacities, 1);
    for (int64_t c = 0; c < chunks_of(splat_count_); ++c)
        for (int32_t i = 0; i < visible_.get()[c]; ++i) {
            const Projected &p = projected_.get()[c * kChunk + i];
            const size_t id = p.id;
            if (means2d) {
                means2d[2 * id] = p.mean_x;
                means2d[2 * id + 1] = p.mean_y;
            }
            if (depths)
                depths[id] = p.channel[kChannelZ];
            if (conics) {
                conics[3 * id] = p.ua * p.ua / kHalfLog2E;
                conics[3 * id + 1] = p.ua * p.ub / kHalfLog2E;
                conics[3 * id + 2] = (p.ub * p.ub + p.vc * p.vc) / kHalfLog2E;
            }
            if (colors)
                std::copy_n(p.channel, 3, colors + 3 * id);
            if (opacities)
                opacities[id] = std::exp2(p.log2_opacity);
        }
    return GS_OK;
}

int64_t gs_raster::workspace_bytes() const {
    size_t bytes = projected_.bytes() + depth_keys_.bytes() + visible_.bytes() + moment_begin_.bytes() +
                   moment_count_.bytes() + order_.bytes() + order_scratch_.bytes() + keys_.bytes() +
                   keys_scratch_.bytes() + tile_cursor_.bytes() + tile_begin_.bytes() + entries_.bytes() +  moments_.bytes() + final_transmittance_.bytes() + stop_index_.bytes() +
                   viewmat_partial_.bytes() + loss_scratch_.bytes() + loss_partial_.bytes();
    for (const GrowingInstances &i : instances_)
        bytes += i.capacity * sizeof(Instance);
    return int64_t(bytes);
}
