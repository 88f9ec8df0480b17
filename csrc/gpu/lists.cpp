// Lists of the splats in each tile, by depth: the order of the shaders that make them.
#include "gpu.h"

#include <algorithm>
#include <bit>

using namespace gs;

namespace {

// Bytes that kernels move: of a splat in the projection, of a key in a pass of the sort, of an entry that is written.
constexpr size_t kProjectBytes = 400, kSortBytes = 28, kEmitBytes = 128;

} // namespace

void gs_gpu::pace(size_t bytes, double gs_gpu_stats::*time) {
    if (paced_bytes_ && (paced_bytes_ + bytes > device.bytes_at_once() || checks_enabled())) {
        if (device.is_step()) {
            device.submit();
            paced_bytes_ = 0;
        } else {
            if (time)
                lap(time);
            submit();
            begin();
        }
    }
    paced_bytes_ += bytes;
}

int gs_gpu::sort(DeviceBuffer *keys, DeviceBuffer *values, uint32_t counter, size_t arguments, uint32_t bits,
                 size_t most, double gs_gpu_stats::*time) {
    int from = 0;
    for (uint32_t bit = 0; bit < bits; bit += GS_DIGIT_BITS, from = 1 - from) {
        pace(most * kSortBytes, time);
        gs_push p = push(counter, bit);
        p.keys_in = keys[from].address;
        p.values_in = values[from].address;
        p.keys_out = keys[1 - from].address;
        p.values_out = values[1 - from].address;
        device.dispatch(Shader::kSortCount, p, counters_, arguments);
        device.dispatch(Shader::kScan, push(counter, GS_DIGITS, GS_BLOCK), 1);
        device.dispatch(Shader::kSortScatter, p, counters_, arguments);
    }
    return from;
}

// Projects, and lists the entries of each tile in the order of their depths.
void gs_gpu::record_lists() {
    const uint32_t group_count = groups_of(frame_.count, GS_GROUP);
    const size_t splats = frame_.count, entries = frame_.entry_capacity; // at most, for the host does not know how many
    const Groups groups(group_count);
    pace(splats * kProjectBytes, &gs_gpu_stats::project_ms);
    device.dispatch(Shader::kProject, push(), groups.x, groups.y);
    device.dispatch(Shader::kScan, push(0, 0, group_count), 1);
    device.dispatch(Shader::kCompact, push(), groups.x, groups.y);
    device.dispatch(Shader::kArguments, push(0, 0, group_count), 1);
    lap(&gs_gpu_stats::project_ms);
    static_assert(32 / GS_DIGIT_BITS % 2 == 0, "the sorted splats are in the first pair of buffers");
    sort(visible_keys_, visible_rows_, GS_COUNT_VISIBLE, GS_ARGS_VISIBLE_BLOCKS, 32, splats, &gs_gpu_stats::sort_ms);
    device.dispatch(Shader::kTileSums, push(), counters_, GS_ARGS_VISIBLE_BLOCKS);
    device.dispatch(Shader::kScan, push(GS_COUNT_VISIBLE, 1, GS_BLOCK), 1);
    device.dispatch(Shader::kOffsets, push(), counters_, GS_ARGS_VISIBLE_BLOCKS);
    device.dispatch(Shader::kArguments, push(1), 1);
    lap(&gs_gpu_stats::sort_ms);
    pace(entries * kEmitBytes, &gs_gpu_stats::bin_ms);
    device.fill(tile_ranges_, size_t(frame_.tiles_x) * frame_.tiles_y * 2 * kWord, 0);
    gs_push p = push();
    p.keys_out = entry_keys_[0].address;
    p.values_out = entry_slots_[0].address;
    device.dispatch(Shader::kEmit, p, counters_, GS_ARGS_ENTRIES);
    sorted_entries_ =
        sort(entry_keys_, entry_slots_, GS_COUNT_ENTRIES, GS_ARGS_ENTRY_BLOCKS,
             uint32_t(std::bit_width(frame_.tiles_x * frame_.tiles_y - 1)), entries, &gs_gpu_stats::bin_ms);
    p = push();
    p.keys_in = entry_keys_[sorted_entries_].address;
    device.dispatch(Shader::kRanges, p, counters_, GS_ARGS_ENTRIES);
    lap(&gs_gpu_stats::bin_ms);
}

// Makes the lists of all tiles. Most often the entries fit into the buffers of an earlier draw; else they are made larger,
// once.
void gs_gpu::lists() {
    uint32_t counters[GS_COUNTERS] = {};
    size_t entries = std::max<size_t>(size_t(frame_.count) * 4, 1 << 12);
    do {
        ensure_entries(entries);
        const Transfers wanted = {{&counters_, counters, sizeof counters}};
        begin();
        if (checks_enabled())
            record_poison();
        device.update(frame_buffer_, &frame_, sizeof frame_);
        record_lists();
        record_fetch(wanted);
        submit();
        read_fetched(wanted);
        entries = counters[GS_COUNT_OVERFLOW];
    } while (entries);
    stats.visible = counters[GS_COUNT_VISIBLE];
    stats.entries = counters[GS_COUNT_ENTRIES];
}
