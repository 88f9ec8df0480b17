// Drawing splats: buffers, submissions, blending.
#include "gpu.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>

using namespace gs;

namespace {

// Bytes that a draw fetches at once, with its last submission; more are fetched in chunks, and all where steps need the
// memory.
constexpr size_t kFetchBytes = size_t(256) << 20;
// Bytes that take as long as blending a pixel, and an entry at all pixels of its tile; most are done after a few of them.
constexpr size_t kPixelBytes = 64, kEntryBytes = 256, kWeightBytes = 1024;
// Pixels of a picture, so that their RGB values have 32-bit indices in shaders.
constexpr int64_t kMostPixels = kMostIndex / 3;
// Entries whose records and sums, three of each, have 32-bit indices in shaders.
constexpr size_t kMostEntries = size_t(kMostIndex) / 3;
static_assert(GS_MOMENT_QUADS <= 3);

class Timer {
  public:
    double milliseconds() const {
        return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin_).count();
    }

  private:
    std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

} // namespace

void gs_gpu::each_buffer(const std::function<void(DeviceBuffer &)> &f) {
    DeviceBuffer *const all[] = {&frame_buffer_,    &records_,         &keys_,
                                 &tile_counts_,     &radii_,           &sums_,
                                 &counters_,        &visible_keys_[0], &visible_keys_[1],
                                 &visible_rows_[0], &visible_rows_[1], &offsets_,
                                 &entry_rows_,      &entry_keys_[0],   &entry_keys_[1],
                                 &entry_slots_[0],  &entry_slots_[1],  &tile_ranges_,
                                 &tiles_,           &far_depths_,      &rgb_,
                                 &alpha_,           &inverse_depth_,   &depth_,
                                 &median_depth_,    &shares_,          &entry_sums_,
                                 &row_sums_,        &transmittances_,  &stops_,
                                 &row_entries_,     &moments_,         &v_rgb_,
                                 &v_alpha_,         &v_inverse_depth_, &step_buffer_,
                                 &gradients_,       &v_means2d_,       &camera_parts_,
                                 &camera_,          &photo_,           &mask_,
                                 &v_alpha_more_,    &step_state_};
    for (DeviceBuffer *b : all)
        f(*b);
}

gs_gpu::~gs_gpu() {
    each_buffer([&](DeviceBuffer &b) { device.free(b); });
    for (StepSlot &slot : slots_) {
        device.free(slot.upload);
        device.free(slot.download);
    }
    step_loss_.free(device);
    device.free(upload_);
    device.free(download_);
}

void gs_gpu::release(gs_gpu_splats &splats) {
    if (drawn_ == &splats)
        drawn_ = nullptr;
    device.free(splats.model);
}

void gs_gpu::ensure_splats(size_t count) {
    device.ensure(frame_buffer_, sizeof(gs_frame));
    device.ensure(counters_, GS_COUNTERS * kWord);
    device.ensure(step_buffer_, sizeof(gs_step));
    frame_.step_block = step_buffer_.address;
    device.ensure(records_, count * 64);
    for (DeviceBuffer *b : {&keys_, &tile_counts_, &radii_, &visible_keys_[0], &visible_keys_[1], &visible_rows_[0],
                            &visible_rows_[1], &offsets_, &row_entries_})
        device.ensure(*b, count * kWord);
    // Of the workgroups of the projection, or the digits of a sort; and a total.
    device.ensure(sums_, std::max<size_t>(groups_of(int64_t(count), GS_GROUP),
                                          size_t(GS_DIGITS) * groups_of(int64_t(count), GS_BLOCK)) *
                                 kWord +
                             kWord);
    frame_.records = records_.address;
    frame_.keys = keys_.address;
    frame_.tile_counts = tile_counts_.address;
    frame_.radii = radii_.address;
    frame_.counters = counters_.address;
    frame_.visible_keys = visible_keys_[0].address;
    frame_.visible_rows = visible_rows_[0].address;
    frame_.offsets = offsets_.address;
    frame_.row_entries = row_entries_.address;
    frame_.sums = sums_.address;
}

void gs_gpu::ensure_entries(size_t count, size_t scratch) {
    if (count > kMostEntries)
        throw_failure(GS_TOO_MANY,
                      "the splats cover too many tiles: more than %zu entries; use a smaller image or "
                      "fewer screen-filling splats",
                      kMostEntries);
    size_t capacity = kMostEntries;
    for (DeviceBuffer *b : {&entry_rows_, &entry_keys_[0], &entry_keys_[1], &entry_slots_[0], &entry_slots_[1]}) {
        device.ensure(*b, count * kWord);
        capacity = std::min(capacity, b->bytes / kWord);
    }
    device.ensure(sums_, size_t(GS_DIGITS) * groups_of(int64_t(capacity), GS_BLOCK) * kWord + kWord);
    if (frame_.view.outputs & GS_GPU_GRADIENTS) {
        device.ensure(moments_, std::max(count * GS_MOMENT_QUADS * 4 * sizeof(float), scratch));
        capacity = std::min(capacity, moments_.bytes / (GS_MOMENT_QUADS * 4 * sizeof(float)));
    }
    frame_.moments = moments_.address;
    frame_.entry_capacity = uint32_t(capacity);
    frame_.entry_rows = entry_rows_.address;
    frame_.sums = sums_.address;
}

void gs_gpu::ensure_picture(const gs_view &view, const gs_host &host) {
    const size_t pixels = size_t(view.width) * size_t(view.height);
    const uint32_t tiles_x = groups_of(view.width, GS_TILE), tiles_y = groups_of(view.height, GS_TILE);
    frame_.tiles_x = tiles_x;
    frame_.tiles_y = tiles_y;
    device.ensure(tile_ranges_, size_t(tiles_x) * tiles_y * 2 * kWord);
    frame_.tile_ranges = tile_ranges_.address;
    const struct {
        DeviceBuffer &buffer;
        uint64_t &address;
        size_t floats;
    } pictures[] = {
        {rgb_, frame_.rgb, 3 * pixels},
        {alpha_, frame_.alpha, pixels},
        {inverse_depth_, frame_.inverse_depth, view.outputs & GS_OUT_INVERSE_DEPTH ? pixels : 0},
        {depth_, frame_.depth, view.outputs & GS_OUT_DEPTH ? pixels : 0},
        {median_depth_, frame_.median_depth, view.outputs & GS_OUT_MEDIAN_DEPTH ? pixels : 0},
        {far_depths_, frame_.far_depths, host.far_depths ? pixels : 0},
        {transmittances_, frame_.transmittances, view.outputs & GS_GPU_GRADIENTS ? pixels : 0},
        {stops_, frame_.stops, view.outputs & GS_GPU_GRADIENTS ? pixels : 0},
    };
    for (const auto &p : pictures) {
        device.ensure(p.buffer, p.floats * sizeof(float));
        p.address = p.buffer.address;
    }
    frame_.has_far = host.far_depths != nullptr;
    if (host.far_depths)
        send({{&far_depths_, const_cast<float *>(host.far_depths), pixels * sizeof(float)}});
    std::vector<uint32_t> drawn = choose_tiles(host.tiles);
    if (host.tiles)
        send({{&tiles_, drawn.data(), drawn.size() * kWord}});
}

std::vector<uint32_t> gs_gpu::choose_tiles(const uint8_t *tiles) {
    const uint32_t tiles_x = frame_.tiles_x, tiles_y = frame_.tiles_y;
    std::vector<uint32_t> drawn(tiles ? size_t(tiles_x) * tiles_y : 0);
    device.ensure(tiles_, drawn.size() * kWord);
    frame_.tiles = tiles_.address;
    frame_.has_tiles = tiles != nullptr;
    frame_.tile_x0 = tiles ? tiles_x : 0;
    frame_.tile_y0 = tiles ? tiles_y : 0;
    frame_.tile_x1 = tiles ? 0 : tiles_x;
    frame_.tile_y1 = tiles ? 0 : tiles_y;
    for (size_t at = 0; at < drawn.size(); ++at) {
        const uint32_t x = uint32_t(at % tiles_x), y = uint32_t(at / tiles_x);
        if ((drawn[at] = tiles[at])) {
            frame_.tile_x0 = std::min(frame_.tile_x0, x);
            frame_.tile_y0 = std::min(frame_.tile_y0, y);
            frame_.tile_x1 = std::max(frame_.tile_x1, x + 1);
            frame_.tile_y1 = std::max(frame_.tile_y1, y + 1);
        }
    }
    return drawn;
}

gs_push gs_gpu::push(uint32_t word0, uint32_t word1, uint32_t word2) const {
    gs_push p = {};
    p.block = frame_buffer_.address;
    // No address is null, because drivers may read ahead of a condition.
    p.keys_in = p.values_in = p.keys_out = p.values_out = counters_.address;
    p.word0 = word0;
    p.word1 = word1;
    p.word2 = word2;
    return p;
}

void gs_gpu::begin() {
    device.begin();
    device.timestamp(0);
    laps_.clear();
    paced_bytes_ = 0;
}

void gs_gpu::lap(double gs_gpu_stats::*time) {
    if (device.is_step())
        return;
    laps_.push_back(time);
    device.timestamp(uint32_t(laps_.size()));
}

void gs_gpu::submit() {
    const gs_status status = device.finish(cancel_);
    for (uint32_t i = 0; i < laps_.size(); ++i)
        stats.*laps_[i] += device.milliseconds(i, i + 1);
    if (status)
        throw_failure(status, "cancelled");
}

size_t gs_gpu::most_entries() const { return device.is_step() ? frame_.entry_capacity : size_t(stats.entries); }

size_t gs_gpu::blend_bytes(size_t of_entry) const {
    return size_t(frame_.view.width) * size_t(frame_.view.height) * kPixelBytes + most_entries() * of_entry;
}

void gs_gpu::record_blend(double gs_gpu_stats::*time) {
    gs_push p = push();
    p.values_in = entry_slots_[sorted_entries_].address;
    record_rows(blend_bytes(kEntryBytes), time, [&](uint32_t row, uint32_t rows) {
        p.word0 = row;
        device.dispatch(Shader::kBlend, p, frame_.tiles_x, rows);
    });
}

void gs_gpu::record_poison() {
    each_buffer([&](DeviceBuffer &b) {
        if (&b != &far_depths_ && &b != &tiles_ && &b != &step_state_ && b.bytes)
            device.fill(b, b.bytes, kPoison);
    });
}

gs_gpu::Transfers gs_gpu::pictures(const gs_image &image) {
    const size_t bytes = size_t(frame_.view.width) * size_t(frame_.view.height) * sizeof(float);
    const uint32_t outputs = frame_.view.outputs;
    return {{&rgb_, image.rgb, 3 * bytes},
            {&alpha_, image.alpha, bytes},
            {&inverse_depth_, image.inverse_depth, outputs & GS_OUT_INVERSE_DEPTH ? bytes : 0},
            {&depth_, image.depth, outputs & GS_OUT_DEPTH ? bytes : 0},
            {&median_depth_, image.median_depth, outputs & GS_OUT_MEDIAN_DEPTH ? bytes : 0},
            {&radii_, image.radii, image.radii ? size_t(frame_.count) * kWord : 0}};
}

void gs_gpu::draw(const gs_gpu_splats &splats, const gs_view &view, const gs_host &host, const gs_image &image) {
    const Timer timer;
    if (int64_t(view.width) * view.height > kMostPixels)
        throw_failure(GS_BAD_ARGUMENT, "a graphics card draws at most %lld pixels, got %d x %d", (long long)kMostPixels,
                      view.width, view.height);
    require_no_pause();
    drawn_ = nullptr;
    stats = {};
    cancel_ = host.cancel;
    const bool damage = device.inject_fault();
    frame_.view = view;
    frame_.count = uint32_t(splats.count);
    frame_.raw = uint32_t(splats.raw);
    frame_.model = splats.model.address;
    frame_.drop_rate = 0;
    ensure_splats(size_t(splats.count));
    ensure_picture(view, host);
    lists();
    const Transfers wanted = pictures(image);
    size_t total = 0;
    for (const Transfer &t : wanted)
        total += t.bytes;
    const bool whole = total <= (step_state_.bytes ? kChunkBytes : kFetchBytes);
    begin();
    record_blend(&gs_gpu_stats::blend_ms);
    lap(&gs_gpu_stats::blend_ms);
    record_fetch(whole ? wanted : Transfers{});
    lap(&gs_gpu_stats::download_ms);
    submit();
    const Timer copying;
    whole ? read_fetched(wanted) : fetch(wanted);
    stats.download_ms += copying.milliseconds();
    if (damage) { // the highest bit of the mantissa
        uint32_t bits;
        std::memcpy(&bits, image.rgb, sizeof bits);
        bits ^= 0x00400000u;
        std::memcpy(image.rgb, &bits, sizeof bits);
    }
    stats.device_bytes = int64_t(device.bytes_in_use());
    stats.total_ms = timer.milliseconds();
    drawn_ = &splats;
}

void gs_gpu::weights(const gs_gpu_splats &splats, const float *shares, float *sums) {
    if (drawn_ != &splats)
        throw_failure(GS_BAD_ARGUMENT, "gs_gpu_weights: these splats were not drawn last");
    const size_t floats = 3 * size_t(frame_.view.width) * size_t(frame_.view.height), rows = 3 * size_t(frame_.count);
    device.ensure(shares_, floats * sizeof(float));
    device.ensure(entry_sums_, 3 * size_t(frame_.entry_capacity) * sizeof(float));
    device.ensure(row_sums_, rows * sizeof(float));
    frame_.shares = shares_.address;
    frame_.entry_sums = entry_sums_.address;
    frame_.row_sums = row_sums_.address;
    send({{&shares_, const_cast<float *>(shares), floats * sizeof(float)}});
    cancel_ = nullptr;
    begin();
    device.update(frame_buffer_, &frame_, sizeof frame_);
    gs_push p = push();
    p.values_in = entry_slots_[sorted_entries_].address;
    record_rows(blend_bytes(kWeightBytes), nullptr, [&](uint32_t row, uint32_t count) {
        p.word0 = row;
        device.dispatch(Shader::kWeights, p, frame_.tiles_x, count);
    });
    pace(size_t(stats.entries) * 3 * sizeof(float) + rows * sizeof(float));
    device.fill(row_sums_, rows * sizeof(float), 0);
    device.dispatch(Shader::kRowSums, push(), counters_, GS_ARGS_VISIBLE_BLOCKS);
    submit();
    fetch({{&row_sums_, sums, rows * sizeof(float)}});
}

void gs_gpu::projected(const ScreenValues &out) {
    if (!drawn_)
        throw_failure(GS_BAD_ARGUMENT, "gs_gpu_projected: no draw has succeeded");
    const size_t count = size_t(frame_.count);
    std::vector<uint32_t> keys(count);
    std::vector<Projected> records(count); // ellipse.glsl has the same first 13 fields
    fetch({{&keys_, keys.data(), count * kWord}, {&records_, records.data(), count * sizeof(Projected)}});
    out.clear(count);
    for (size_t i = 0; i < count; ++i)
        if (keys[i] != GS_NO_KEY)
            out.put(i, records[i]);
}

void gs_gpu::test(int kernel, const uint32_t *a, const uint32_t *b, uint32_t *out, int64_t count) {
    drawn_ = nullptr;
    const size_t bytes = size_t(count) * kWord;
    ensure_splats(size_t(count));
    send({{&visible_keys_[0], const_cast<uint32_t *>(a), bytes}});
    if (kernel != GS_GPU_TEST_SORT) {
        send({{&visible_rows_[0], const_cast<uint32_t *>(b), b ? bytes : 0}});
        gs_push p = push(uint32_t(kernel), uint32_t(count));
        p.keys_in = visible_keys_[0].address;
        p.values_in = visible_rows_[0].address;
        p.keys_out = visible_keys_[1].address;
        const Groups groups(groups_of(count, GS_GROUP));
        device.begin();
        device.update(frame_buffer_, &frame_, sizeof frame_);
        device.dispatch(Shader::kTest, p, groups.x, groups.y);
        device.finish(nullptr);
        fetch({{&visible_keys_[1], out, bytes}});
        return;
    }
    std::vector<uint32_t> rows(static_cast<size_t>(count));
    for (size_t i = 0; i < rows.size(); ++i)
        rows[i] = uint32_t(i);
    uint32_t visible = uint32_t(count);
    send({{&visible_rows_[0], rows.data(), bytes}, {&sums_, &visible, kWord}});
    cancel_ = nullptr;
    begin();
    device.update(frame_buffer_, &frame_, sizeof frame_);
    device.dispatch(Shader::kArguments, push(), 1); // the count is the first sum
    sort(visible_keys_, visible_rows_, GS_COUNT_VISIBLE, GS_ARGS_VISIBLE_BLOCKS, 32, size_t(count),
         &gs_gpu_stats::sort_ms);
    submit();
    fetch({{&visible_rows_[0], out, bytes}});
}
