// Splats in training on a device: creation, growth, clamps, noise, Morton order.
#include "model.h"

#include <algorithm>
#include <cmath>

using namespace gs;

namespace {

// Limits of gscore/engine/cpu/sanitize.py, in camera extents; the others are in clamp_rows.comp.
constexpr double kMostMean = 1e6, kMostScale = 1e3, kMostSpread = 5;
constexpr size_t kFloat = sizeof(float);

} // namespace

gs_gpu_model::gs_gpu_model(gs_gpu *of, const gs_splats &in, const gs_splats *before, int32_t counted)
    : gpu(of), splats{of, {}, in.count + (before ? before->count : 0), in.sh_rest, 1},
      frozen(before ? before->count : 0), counter_count(counted) {
    check_size(splats.count, in.sh_rest);
    Device &device = gpu->device;
    try {
        each_table([&](const Table &t, int32_t) {
            device.ensure(*t.buffer, t.bytes(rows()));
            device.begin();
            device.fill(*t.buffer, t.buffer->bytes, 0);
            device.finish(nullptr);
        });
        if (before)
            gpu->write_rows(*before, splats, 0);
        gpu->write_rows(in, splats, size_t(frozen));
    } catch (...) {
        free_all();
        throw;
    }
}

gs_gpu_model::~gs_gpu_model() { free_all(); }

void gs_gpu_model::free_all() {
    gpu->release(splats);
    free_transit();
    for (DeviceBuffer *b : {&moment1, &moment2, &accumulated, &counters, &noise_})
        gpu->device.free(*b);
}

// Shaders number the floats of a table.
void gs_gpu_model::check_size(int64_t count, int32_t sh_rest) {
    const int64_t most = kMostIndex / int64_t(4 * planes_of(sh_rest));
    if (count > most)
        throw_failure(GS_TOO_MANY, "a device trains at most %lld splats with %d SH coefficients, got %lld",
                      (long long)most, 1 + sh_rest, (long long)count);
}

gs_gpu_model::Table gs_gpu_model::table(int32_t number) {
    switch (number) {
    case GS_GPU_VALUES:
        return {&splats.model, planes(), 4, 0};
    case GS_GPU_MOMENT1:
        return {&moment1, planes(), 4, 0};
    case GS_GPU_MOMENT2:
        return {&moment2, planes(), 4, 0};
    case GS_GPU_ACCUMULATED:
        return {&accumulated, planes() - GS_PLANE_SH, 4, 4 * GS_PLANE_SH};
    default:
        return {&counters, size_t(counter_count), 1, 0};
    }
}

// Calls f(table, number) for the tables that exist.
template <class F> void gs_gpu_model::each_table(F f) {
    for (const int32_t number : {GS_GPU_VALUES, GS_GPU_MOMENT1, GS_GPU_MOMENT2, GS_GPU_ACCUMULATED, GS_GPU_COUNTERS})
        if (has_moments || number == GS_GPU_VALUES || number == GS_GPU_COUNTERS)
            f(table(number), number);
}

// Only one table exists twice at a time; what a table contains stays.
void gs_gpu_model::grow(const Table &t, size_t bytes) {
    if (t.buffer->bytes >= bytes)
        return;
    Device &device = gpu->device;
    DeviceBuffer larger;
    device.ensure(larger, bytes);
    try {
        device.begin();
        device.copy(*t.buffer, larger, t.bytes(rows()));
        device.finish(nullptr);
    } catch (...) {
        device.free(larger);
        throw;
    }
    device.free(*t.buffer);
    *t.buffer = larger;
    gpu->drawn_ = nullptr;
}

void gs_gpu_model::reserve(int64_t count) {
    const size_t total = size_t(frozen) + size_t(count);
    check_size(int64_t(total), splats.sh_rest);
    try {
        each_table([&](const Table &t, int32_t) { grow(t, t.bytes(total)); });
        gpu->device.ensure(list_, total * sizeof(uint32_t));
        gpu->device.ensure(array_, total * 4 * kFloat);
    } catch (...) {
        free_transit();
        throw;
    }
}

void gs_gpu_model::free_transit() {
    gpu->device.free(list_);
    gpu->device.free(array_);
}

void gs_gpu_model::rebuild(const int64_t *list, const uint8_t *fresh, int64_t count) {
    reserve(count);
    const size_t total = size_t(frozen) + size_t(count);
    std::vector<uint32_t> rows_of(total);
    for (size_t row = 0; row < total; ++row) {
        const size_t i = row - size_t(frozen);
        rows_of[row] =
            row < size_t(frozen) ? uint32_t(row) : uint32_t(list[i] + frozen) | (fresh && fresh[i] ? GS_FRESH : 0);
    }
    gpu->send({{&list_, rows_of.data(), total * sizeof(uint32_t)}});
    each_table([&](const Table &t, int32_t number) { rebuild(t, number, total); });
    splats.count = int64_t(total);
    gpu->drawn_ = nullptr;
    free_transit();
}

// Plane by plane and in place: in an order in which a new plane lies on none that is still to be read.
void gs_gpu_model::rebuild(const Table &t, int32_t number, size_t count) {
    Device &device = gpu->device;
    const size_t bytes = count * t.unit * kFloat;
    const uint32_t words = uint32_t(count * t.unit);
    const uint32_t flags = GS_ROWS_LISTED | (number == GS_GPU_VALUES ? 0 : GS_ROWS_FRESH);
    const Groups groups(groups_of(words, GS_GROUP));
    size_t moved = 0;
    begin();
    for (size_t i = 0; i < t.planes; ++i, moved += 5 * bytes) {
        if (moved && (moved + 5 * bytes > device.bytes_at_once() || checks_enabled())) {
            device.finish(nullptr);
            begin();
            moved = 0;
        }
        const size_t plane = count > rows() ? t.planes - 1 - i : i;
        device.dispatch(Shader::kRowsRead, push(t, uint32_t(plane * t.unit), t.unit, words, flags), groups.x, groups.y);
        device.copy(array_, *t.buffer, bytes, 0, plane * bytes);
    }
    device.finish(nullptr);
}

void gs_gpu_model::widen(int32_t sh_rest) {
    if (sh_rest <= splats.sh_rest)
        return;
    check_size(splats.count, sh_rest);
    const size_t added = planes_of(sh_rest) - planes();
    each_table([&](const Table &t, int32_t number) {
        if (number != GS_GPU_COUNTERS)
            grow(t, t.bytes(rows()) + added * rows() * 4 * kFloat);
    });
    clear_unused();
    gpu->device.begin();
    each_table([&](const Table &t, int32_t number) {
        if (number != GS_GPU_COUNTERS)
            gpu->device.fill(*t.buffer, added * rows() * 4 * kFloat, 0, t.bytes(rows()));
    });
    gpu->device.finish(nullptr);
    splats.sh_rest = sh_rest;
    gpu->drawn_ = nullptr;
}

void gs_gpu_model::drop_moments() {
    for (DeviceBuffer *b : {&moment1, &moment2, &accumulated}) {
        gpu->device.free(*b);
        gpu->device.ensure(*b, 0); // no address is null
    }
    has_moments = false;
}

void gs_gpu_model::record_clamp(double extent, uint64_t words, uint32_t run, uint32_t lost) {
    gs_clamp_push p = {};
    p.values = splats.model.address;
    p.moment1 = moment1.address;
    p.moment2 = moment2.address;
    p.accumulated = accumulated.address;
    p.counters = counters.address;
    p.state = words;
    p.run = run;
    p.lost = lost;
    p.rows = uint32_t(splats.count);
    p.frozen = uint32_t(frozen);
    p.planes = uint32_t(planes());
    p.counter_count = uint32_t(counter_count);
    p.most_mean = float(kMostMean * extent);
    p.most_scale = float(std::log(kMostScale * extent));
    p.extent = float(extent);
    p.spread = float(std::log(kMostSpread * extent));
    const Groups groups(groups_of(splats.count - frozen, GS_GROUP));
    gpu->device.dispatch(Shader::kClampRows, p, groups.x, groups.y);
}

int64_t gs_gpu_model::clamp(double extent) {
    uint32_t words[2] = {1, 0}; // run, lost
    gpu->device.ensure(list_, sizeof words);
    const gs_gpu::Transfers wanted = {{&list_, words, sizeof words}};
    gpu->device.begin();
    gpu->device.update(list_, words, sizeof words);
    record_clamp(extent, list_.address, 0, 1);
    gpu->record_fetch(wanted);
    gpu->device.finish(nullptr);
    gpu->read_fetched(wanted);
    return words[1];
}

void gs_gpu_model::record_noise(float weight, const gs_random &random, uint64_t words, uint32_t skip) {
    gs_noise_push p = {};
    p.values = splats.model.address;
    p.state = words;
    p.skip = skip;
    p.rows = uint32_t(splats.count);
    p.frozen = uint32_t(frozen);
    const gs_noise noise = {uint32_t(random.seed), uint32_t(random.seed >> 32), random.step, random.stream, weight};
    gpu->device.ensure(noise_, sizeof noise);
    gpu->device.update(noise_, &noise, sizeof noise);
    p.block = noise_.address;
    const Groups groups(groups_of(splats.count - frozen, GS_GROUP));
    gpu->device.dispatch(Shader::kNoise, p, groups.x, groups.y);
}

void gs_gpu_model::noise(float weight, const gs_random &random) {
    const uint32_t skip = 0;
    gpu->device.ensure(list_, sizeof skip);
    gpu->device.begin();
    gpu->device.update(list_, &skip, sizeof skip);
    record_noise(weight, random, list_.address, 0);
    gpu->device.finish(nullptr);
}

void gs_gpu_model::morton_order(const int64_t *list, int64_t count, const float low[3], const float high[3],
                                uint32_t *order) {
    Device &device = gpu->device;
    const size_t bytes = size_t(count) * sizeof(uint32_t);
    gpu->drawn_ = nullptr; // its buffers are used
    gpu->cancel_ = nullptr;
    gpu->ensure_splats(size_t(count));
    device.ensure(list_, list ? bytes : 0);
    std::vector<uint32_t> rows_of(list ? size_t(count) : 0);
    for (size_t i = 0; i < rows_of.size(); ++i)
        rows_of[i] = uint32_t(list[i]);
    gpu->send({{&list_, rows_of.data(), rows_of.size() * sizeof(uint32_t)}});
    gs_morton_push p = {};
    p.values = splats.model.address;
    p.list = list_.address;
    p.keys = gpu->visible_keys_[0].address;
    p.order = gpu->visible_rows_[0].address;
    p.count = uint32_t(count);
    p.begin = uint32_t(frozen);
    p.listed = list != nullptr;
    for (int k = 0; k < 3; ++k) {
        (&p.low_x)[k] = low[k];
        (&p.scale_x)[k] = float(1023 / std::max(double(high[k]) - double(low[k]), 1e-30));
    }
    const Groups groups(groups_of(count, GS_GROUP));
    gpu->begin();
    device.update(gpu->frame_buffer_, &gpu->frame_, sizeof gpu->frame_);
    device.update(gpu->sums_, &p.count, sizeof p.count);
    device.dispatch(Shader::kMorton, p, groups.x, groups.y);
    device.dispatch(Shader::kArguments, gpu->push(), 1); // the count is the first sum
    gpu->sort(gpu->visible_keys_, gpu->visible_rows_, GS_COUNT_VISIBLE, GS_ARGS_VISIBLE_BLOCKS, 32, size_t(count),
              &gs_gpu_stats::sort_ms);
    gpu->submit();
    gpu->fetch({{&gpu->visible_rows_[0], order, bytes}});
}
