// Tile sort: radix sort of a tile's list by depth.
// A tile's list usually fits into the L1 and L2 caches, whereas a global sort, and accesses in that order, are limited
// by memory latency. Sixteen bits of depth, relative to the depth range of the tile, distinguish almost all of its
// splats; neighbours with equal bits are sorted by insertion afterwards.
#include "tile_sort.h"

#include <algorithm>
#include <bit>
#include <cstring>

namespace gs {

namespace {

constexpr uint32_t kFew = 24;        // sorted by insertion only
constexpr uint32_t kMost = 1u << 16; // longest list with 16-bit indices
constexpr int64_t kMovesEach = 8;    // maximum moves per entry of the insertion sort

// Stable insertion sort; false: aborted after too many moves, with the entries in any order.
bool insert_each(Entry *entries, uint32_t count, int64_t moves) {
    for (uint32_t i = 1; i < count; ++i) {
        if (entries[i - 1].key <= entries[i].key)
            continue;
        const Entry e = entries[i];
        uint32_t at = i;
        for (; at > 0 && entries[at - 1].key > e.key; --at)
            entries[at] = entries[at - 1];
        entries[at] = e;
        if ((moves -= i - at) < 0)
            return false;
    }
    return true;
}

} // namespace

void TileSort::reserve(uint32_t longest) {
    copy_.ensure(std::min(longest, kMost));
    items_.ensure(std::min(longest, kMost));
    by_low_.ensure(std::min(longest, kMost));
}

void TileSort::run(Entry *entries, uint32_t count) {
    if (count <= kFew) {
        insert_each(entries, count, INT64_MAX);
        return;
    }
    if (count <= kMost) {
        Entry *const copy = copy_.get();
        std::memcpy(copy, entries, count * sizeof(Entry));
        uint32_t low = UINT32_MAX, high = 0;
        for (uint32_t i = 0; i < count; ++i) {
            low = std::min(low, copy[i].key);
            high = std::max(high, copy[i].key);
        }
        const int shift = std::max(0, int(std::bit_width(high - low)) - 16);
        // The upper half of an item is bits of the key, the lower half an index into `copy`.
        uint32_t *const items = items_.get(), *const by_low = by_low_.get();
        uint32_t low_end[256] = {}, high_end[256] = {};
        for (uint32_t i = 0; i < count; ++i) {
            const uint32_t key = (copy[i].key - low) >> shift;
            items[i] = key << 16 | i;
            ++low_end[key & 0xff];
            ++high_end[key >> 8];
        }
        for (uint32_t b = 0, lows = 0, highs = 0; b < 256; ++b) {
            low_end[b] = (lows += low_end[b]) - low_end[b];
            high_end[b] = (highs += high_end[b]) - high_end[b];
        }
        for (uint32_t i = 0; i < count; ++i)
            by_low[low_end[items[i] >> 16 & 0xff]++] = items[i];
        for (uint32_t i = 0; i < count; ++i)
            entries[high_end[by_low[i] >> 24]++] = copy[by_low[i] & 0xffff];
        if (insert_each(entries, count, kMovesEach * count))
            return;
        std::memcpy(entries, copy, count * sizeof(Entry));
    }
    std::stable_sort(entries, entries + count, [](const Entry &a, const Entry &b) { return a.key < b.key; });
}

} // namespace gs
