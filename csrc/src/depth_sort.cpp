// A stable radix sort over the bits in which the depths differ. Ranges of splats are counted and moved independently,
// with a cursor for each range and bucket: where a splat goes does not depend on their number.
#include "depth_sort.h"

#include "parallel.h"

#include <algorithm>
#include <bit>
#include <cstring>

namespace gs {

namespace {

constexpr int kBitsMax = 13;                  // buckets whose cursors the nearer caches hold
constexpr size_t kRangeMin = size_t(1) << 15; // splats worth the wait for another thread

} // namespace

template <class Each, class Put>
void DepthSort::pass(int ranges, int shift, int bits, int threads, const Each &each, const Put &put) {
    const uint32_t buckets = 1u << bits, mask = buckets - 1;
    uint32_t *const cursor = cursor_.ensure(size_t(ranges) * buckets);
    parallel_for(size_t(ranges), threads, [&](size_t r, int) {
        uint32_t *const count = cursor + r * buckets;
        std::memset(count, 0, buckets * sizeof(uint32_t));
        each(r, [=](uint32_t key, uint32_t) { ++count[key >> shift & mask]; });
    });
    uint32_t running = 0;
    for (uint32_t b = 0; b < buckets; ++b)
        for (int r = 0; r < ranges; ++r) {
            uint32_t &at = cursor[size_t(r) * buckets + b];
            const uint32_t n = at;
            at = running;
            running += n;
        }
    parallel_for(size_t(ranges), threads, [&](size_t r, int) {
        uint32_t *const at = cursor + r * buckets;
        each(r, [=](uint32_t key, uint32_t slot) { put(at[key >> shift & mask]++, key, slot); });
    });
}

const uint32_t *DepthSort::run(const uint32_t *keys, const int32_t *visible, const KeyRange *key_range, int64_t chunks,
                               size_t count, int threads) {
    uint32_t low = UINT32_MAX, high = 0;
    for (int64_t c = 0; c < chunks; ++c) {
        low = std::min(low, key_range[c].low);
        high = std::max(high, key_range[c].high);
    }
    const int ranges = int(std::clamp<size_t>(count / kRangeMin, 1, size_t(threads)));
    const int bits_all = high > low ? int(std::bit_width(high - low)) : 1;
    const int passes = (bits_all + kBitsMax - 1) / kBitsMax, bits = (bits_all + passes - 1) / passes;
    uint32_t *const order = order_.ensure(count);
    Item *from = passes > 1 ? items_.ensure(count) : nullptr, *to = passes > 2 ? items_to_.ensure(count) : nullptr;
    const auto chunk_by_chunk = [=](size_t r, const auto &f) {
        for (int64_t c = chunks * int64_t(r) / ranges; c < chunks * int64_t(r + 1) / ranges; ++c)
            for (int64_t slot = c * kChunk; slot < c * kChunk + visible[c]; ++slot)
                f(keys[slot] - low, uint32_t(slot));
    };
    for (int p = 0; p < passes; ++p) {
        const auto item_by_item = [=](size_t r, const auto &f) {
            for (size_t i = count * r / size_t(ranges); i < count * (r + 1) / size_t(ranges); ++i)
                f(from[i].key, from[i].slot);
        };
        const auto put_slot = [=](uint32_t at, uint32_t, uint32_t slot) { order[at] = slot; };
        Item *const target = p == 0 ? from : to;
        const auto put_item = [=](uint32_t at, uint32_t key, uint32_t slot) { target[at] = {key, slot}; };
        const int shift = p * bits;
        if (p == 0 && passes == 1)
            pass(ranges, shift, bits, threads, chunk_by_chunk, put_slot);
        else if (p == 0)
            pass(ranges, shift, bits, threads, chunk_by_chunk, put_item);
        else if (p + 1 == passes)
            pass(ranges, shift, bits, threads, item_by_item, put_slot);
        else
            pass(ranges, shift, bits, threads, item_by_item, put_item);
        if (p > 0)
            std::swap(from, to);
    }
    return order;
}

} // namespace gs
