// Rasterizer driver: project, sort, bin, blend; and the backward pass.
#include "raster.h"

#include "cpu_dispatch.h"
#include "loss.h"
#include "parallel.h"
#include "thread_count.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <new>

using namespace gs;

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

bool cancelled(const volatile int32_t *cancel) { return cancel && *cancel; }

} // namespace

GrowingInstances::~GrowingInstances() {
    if (data)
        free_pages(data, capacity * sizeof(Instance));
}

bool GrowingInstances::grow_more(InstanceBuffer *self) {
    const size_t wanted = self->capacity ? self->capacity / 2 * 3 : size_t(1) << 13;
    Instance *p;
    try {
        p = static_cast<Instance *>(allocate_pages(wanted * sizeof(Instance)));
    } catch (const std::bad_alloc &) {
        return false;
    }
    if (self->data) {
        std::memcpy(p, self->data, self->size * sizeof(Instance));
        free_pages(self->data, self->capacity * sizeof(Instance));
    }
    self->data = p;
    self->capacity = wanted;
    return true;
}

ProjectArgs gs_raster::project_args(const gs_splats &splats) const {
    return {&splats, &view_, projected_.get(), depth_keys_.get(), nullptr, visible_.get()};
}

gs_status gs_raster::bin(const BinArgs &args, uint32_t tiles, int threads) {
    const Kernels &k = kernels();
    const int64_t chunks = chunks_of(splat_count_);
    while (instances_.size() < size_t(threads))
        instances_.push_back(std::make_unique<GrowingInstances>());
    for (const auto &list : instances_)
        list->size = 0;
    uint32_t *const list_of_chunk = list_of_chunk_.ensure(size_t(chunks));
    std::atomic<bool> out_of_memory{false};
    parallel_for(size_t(chunks), threads, [&](size_t chunk, int worker) {
        list_of_chunk[chunk] = uint32_t(worker);
        if (!out_of_memory && !cancelled(args.cancel) && !k.bin(args, int64_t(chunk), instances_[size_t(worker)].get()))
            out_of_memory = true;
    });
    if (out_of_memory)
        throw std::bad_alloc();
    if (cancelled(args.cancel))
        return GS_CANCELLED;
    size_t total = 0;
    for (const auto &list : instances_)
        total += list->size;
    if (total > size_t(INT32_MAX))
        return GS_TOO_MANY;
    entry_count_ = total;
    uint32_t *const moment_begin = moment_begin_.ensure(size_t(chunks));
    for (int64_t c = 0; c < chunks; ++c) {
        moment_begin[c] = 0;
        for (uint32_t i = 0; i < list_of_chunk[c]; ++i)
            moment_begin[c] += uint32_t(instances_[i]->size);
    }

    // Ranges of chunks are counted independently, then scattered to their tiles with one cursor per (range, tile), so
    // the order of entries does not depend on the number of ranges.
    const int ranges = int(std::clamp<int64_t>(chunks / 2, 1, std::min(64, 2 * threads)));
    uint32_t *const cursor = tile_cursor_.ensure(size_t(ranges) * tiles);
    const Span *const spans = spans_.get();
    // Calls f(chunk, its list) for the chunks of a range.
    const auto each = [&](size_t range, const auto &f) {
        for (int64_t c = chunks * int64_t(range) / ranges; c < chunks * int64_t(range + 1) / ranges; ++c)
            if (visible_.get()[c] && !cancelled(args.cancel))
                f(c, instances_[list_of_chunk[c]]->data);
    };
    parallel_for(size_t(ranges), threads, [&](size_t r, int) {
        uint32_t *const counts = cursor + r * tiles;
        std::memset(counts, 0, tiles * sizeof(uint32_t));
        each(r, [&](int64_t c, const Instance *list) {
            const Span &last = spans[c * kChunk + visible_.get()[c] - 1];
            for (uint32_t n = spans[c * kChunk].begin; n < last.begin + last.count; ++n)
                ++counts[list[n].tile];
        });
    });
    uint32_t *const begin = tile_begin_.ensure(size_t(tiles) + 1);
    uint32_t running = 0;
    for (uint32_t t = 0; t < tiles; ++t) {
        begin[t] = running;
        for (int r = 0; r < ranges; ++r) {
            uint32_t &at = cursor[size_t(r) * tiles + t];
            const uint32_t n = at;
            at = running;
            running += n;
        }
    }
    begin[tiles] = running;
    Entry *const entries = entries_.ensure(total);
    parallel_for(size_t(ranges), threads, [&](size_t r, int) {
        uint32_t *const at = cursor + r * tiles;
        each(r, [&](int64_t c, const Instance *list) {
            for (int64_t slot = c * kChunk; slot < c * kChunk + visible_.get()[c]; ++slot) {
                const Span span = spans[slot];
                const uint32_t key = depth_keys_.get()[slot];
                for (uint32_t n = span.begin; n < span.begin + span.count; ++n)
                    entries[at[list[n].tile]++] = {uint32_t(slot), list[n].blocks, moment_begin[c] + n, key};
            }
        });
    });
    return GS_OK;
}

int64_t gs_raster::project(const gs_splats &splats, int32_t *radii) {
    const Kernels &k = kernels();
    const int64_t chunks = chunks_of(splats.count);
    const size_t slots = size_t(chunks) * size_t(kChunk);
    projected_.ensure(slots);
    depth_keys_.ensure(slots);
    visible_.ensure(size_t(chunks));
    spans_.ensure(slots);
    ProjectArgs args = project_args(splats);
    args.radii = radii;
    parallel_for(size_t(chunks), host_.threads, [&](size_t c, int) {
        if (!cancelled(host_.cancel))
            k.project(args, int64_t(c));
    });
    if (cancelled(host_.cancel))
        return 0;
    int64_t visible = 0;
    for (int64_t c = 0; c < chunks; ++c)
        visible += visible_.get()[c];
    return visible;
}

void gs_raster::sort(uint32_t tiles) {
    const int threads = host_.threads;
    const uint32_t *const tile_begin = tile_begin_.get();
    uint32_t longest = 0;
    for (uint32_t t = 0; t < tiles; ++t)
        longest = std::max(longest, tile_begin[t + 1] - tile_begin[t]);
    if (sorts_.size() < size_t(threads))
        sorts_.resize(size_t(threads));
    for (TileSort &sort : sorts_)
        sort.reserve(longest);
    parallel_for(tiles, threads, [&](size_t t, int worker) {
        if (!cancelled(host_.cancel))
            sorts_[size_t(worker)].run(entries_.get() + tile_begin[t], tile_begin[t + 1] - tile_begin[t]);
    });
}

PairCount gs_raster::blend(const gs_image &image, uint32_t tiles) {
    const Kernels &k = kernels();
    blend_.projected = projected_.get();
    blend_.entries = entries_.get();
    blend_.tile_begin = tile_begin_.get();
    blend_.width = view_.width;
    blend_.height = view_.height;
    blend_.tiles_x = ceil_div(view_.width, kTileWidth);
    std::copy_n(view_.background, 3, blend_.background);
    blend_.far_depths = host_.far_depths;
    blend_.image = image;
    blend_.final_transmittance = final_transmittance_.ensure(size_t(tiles) * kTilePixels);
    blend_.stop_index = stop_index_.ensure(size_t(tiles) * kTilePixels);
    std::atomic<int64_t> pairs{0}, useful{0};
    parallel_for(tiles, host_.threads, [&](size_t t, int) {
        if (cancelled(host_.cancel))
            return;
        const PairCount found = k.blend(blend_, view_.outputs, uint32_t(t));
        pairs += found.evaluated;
        useful += found.useful;
    });
    blend_.image = {}; // the caller's arrays may be gone by the backward call
    blend_.far_depths = nullptr;
    return {pairs, useful};
}

gs_status gs_raster::forward(const gs_splats &splats, const gs_view &view, const gs_host &host, const gs_image &image) {
    valid_ = false;
    stats = {};
    view_ = view;
    host_ = host;
    host_.threads = threads_of(host.threads);
    splat_count_ = splats.count;
    Timer timer;

    const int64_t visible = project(splats, image.radii);
    if (cancelled(host.cancel))
        return GS_CANCELLED;
    stats.project_ms = timer.lap_ms();

    const int tiles_x = ceil_div(view.width, kTileWidth);
    const int tiles_y = ceil_div(view.height, kTileHeight);
    const uint32_t tiles = uint32_t(tiles_x) * uint32_t(tiles_y);
    const BinArgs bins = {projected_.get(), visible_.get(), spans_.get(), view.width, view.height,
                          tiles_x,          host.disable,   host.cancel,  host.tiles};
    if (const gs_status s = bin(bins, tiles, host_.threads))
        return s;
    if (cancelled(host.cancel))
        return GS_CANCELLED;
    stats.bin_ms = timer.lap_ms();

    sort(tiles);
    if (cancelled(host.cancel))
        return GS_CANCELLED;
    stats.sort_ms = timer.lap_ms();

    const PairCount pairs = blend(image, tiles);
    host_.cancel = nullptr;
    host_.tiles = nullptr;
    host_.far_depths = nullptr;
    if (cancelled(host.cancel))
        return GS_CANCELLED;
    stats.blend_ms = timer.lap_ms();
    stats.visible = visible;
    stats.entries = int64_t(entry_count_);
    stats.forward_pairs = pairs.evaluated;
    stats.useful_pairs = pairs.useful;
    stats.workspace_bytes = workspace_bytes();
    valid_ = true;
    return GS_OK;
}

gs_status gs_raster::backward(const gs_splats &splats, const gs_image_grads &image_grads, const gs_splat_grads &grads,
                              const volatile int32_t *cancel) {
    if (!valid_ || splats.count != splat_count_ || sh_rest_of(view_.sh_degree) > splats.sh_rest)
        return GS_BAD_ARGUMENT;
    if (view_.orthographic)
        return GS_UNSUPPORTED;
    const Kernels &k = kernels();
    const int threads = host_.threads;
    Timer timer;
    const uint32_t tiles = uint32_t(blend_.tiles_x) * uint32_t(ceil_div(blend_.height, kTileHeight));
    const BlendBackwardArgs args = {&blend_, image_grads, moments_.ensure(entry_count_),
                                    !(host_.disable & GS_NO_ZERO_TILE)};
    std::atomic<int64_t> pairs{0};
    parallel_for(tiles, threads, [&](size_t t, int) {
        if (!cancelled(cancel))
            pairs += k.blend_backward(args, view_.outputs, uint32_t(t));
    });
    if (cancelled(cancel))
        return GS_CANCELLED;
    stats.backward_pairs = pairs;
    stats.blend_backward_ms = timer.lap_ms();

    const int64_t chunks = chunks_of(splats.count);
    ProjectBackwardArgs project = {project_args(splats), spans_.get(), moment_begin_.get(),
                                   moments_.get(),       grads,        nullptr};
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
    const LossGrid grid(args.width, args.height);
    const int threads = threads_of(args.threads), tiles = grid.tiles();
    const size_t scratch = grid.scratch_floats();
    float *scratches = loss_scratch_.ensure(scratch * size_t(std::min(threads, tiles)));
    const LossArgs loss = {&args, loss_partial_.ensure(size_t(tiles) * kLossSums), v_image};
    parallel_for(size_t(tiles), threads,
                 [&](size_t t, int worker) { k.image_loss(loss, int(t), scratches + scratch * size_t(worker)); });
    double sums[kLossSums] = {};
    for (int t = 0; t < tiles; ++t)
        for (int i = 0; i < kLossSums; ++i)
            sums[i] += loss.partial[kLossSums * t + i];
    const double n = 3.0 * args.width * args.height;
    result.l1 = sums[0] / n;
    result.ssim = sums[1] / n;
    result.mse = sums[2] / n;
    for (int c = 0; c < 3; ++c)
        result.v_log_gain[c] = sums[3 + c];
    const double w = double(args.ssim_weight);
    result.loss = (1.0 - w) * result.l1 + w * (1.0 - result.ssim);
    return GS_OK;
}

gs_status gs_raster::projected(const ScreenValues &out) const {
    if (!valid_)
        return GS_BAD_ARGUMENT;
    out.clear(size_t(splat_count_));
    for (int64_t c = 0; c < chunks_of(splat_count_); ++c)
        for (int32_t i = 0; i < visible_.get()[c]; ++i) {
            const Projected &p = projected_.get()[c * kChunk + i];
            out.put(p.id, p);
        }
    return GS_OK;
}

int64_t gs_raster::workspace_bytes() const {
    size_t bytes = projected_.bytes() + depth_keys_.bytes() + visible_.bytes() + spans_.bytes() +
                   list_of_chunk_.bytes() + moment_begin_.bytes() + tile_cursor_.bytes() + tile_begin_.bytes() +
                   entries_.bytes() + moments_.bytes() + final_transmittance_.bytes() + stop_index_.bytes() +
                   viewmat_partial_.bytes() + loss_scratch_.bytes() + loss_partial_.bytes();
    for (const auto &list : instances_)
        bytes += list->capacity * sizeof(Instance);
    for (const TileSort &sort : sorts_)
        bytes += sort.bytes();
    return int64_t(bytes);
}
