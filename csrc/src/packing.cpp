// Rows of several tables side by side in one, and back: what is sent between processes that train together.
#include "packing.h"

#include "parallel.h"
#include "thread_count.h"

#include <algorithm>
#include <atomic>
#include <cstring>

namespace gs {

namespace {

constexpr int64_t kRows = 2048;
constexpr int64_t kAhead = 8; // rows that are fetched before they are needed: their places in the tables jump

int64_t row_of(const float *packed) {
    int32_t row;
    std::memcpy(&row, packed, sizeof row);
    return row;
}

// Calls work(j) for j below width. Widths that the tables of a training mostly have are spelled out: a loop of unknown
// length, or a call of memcpy, takes longer than what it does for three numbers.
template <class Work>
inline void each_number(int64_t width, Work work) {
    switch (width) {
    case 1:
        work(0);
        break;
    case 3:
        work(0), work(1), work(2);
        break;
    case 4:
        work(0), work(1), work(2), work(3);
        break;
    default:
        for (int64_t j = 0; j < width; ++j)
            work(j);
    }
}

// Calls work(packed row, its row of the tables) for all of them, by many threads.
template <class Float, class Work>
void each_row(const gs_row_table *tables, int table_count, Float *packed, int64_t count, int threads, Work work) {
    int64_t width = 1;
    for (int k = 0; k < table_count; ++k)
        width += tables[k].width;
    parallel_for(size_t((count + kRows - 1) / kRows), threads_of(threads), [&](size_t c, int) {
        const int64_t begin = int64_t(c) * kRows, end = std::min(begin + kRows, count);
        for (int64_t i = begin; i < end; ++i) {
            if (i + kAhead < end) {
                const int64_t next = row_of(packed + (i + kAhead) * width);
                for (int k = 0; k < table_count; ++k)
                    __builtin_prefetch(tables[k].data + next * tables[k].width);
            }
            work(packed + i * width + 1, row_of(packed + i * width));
        }
    });
}

} // namespace

int64_t row_out_of_range(int64_t rows, const float *packed, int64_t count, int64_t width, int threads) {
    std::atomic<int64_t> first{count};
    parallel_for(size_t((count + kRows - 1) / kRows), threads_of(threads), [&](size_t c, int) {
        const int64_t begin = int64_t(c) * kRows, end = std::min(begin + kRows, count);
        for (int64_t i = begin; i < end; ++i) {
            const int64_t row = row_of(packed + i * width);
            if (row >= 0 && row < rows)
                continue;
            int64_t known = first.load();
            while (i < known && !first.compare_exchange_weak(known, i)) {
            }
            return;
        }
    });
    return first.load() < count ? first.load() : -1;
}

void pack_rows(const gs_row_table *tables, int table_count, float *packed, int64_t count, int threads) {
    each_row(tables, table_count, packed, count, threads, [&](float *to, int64_t row) {
        for (int k = 0; k < table_count; ++k) {
            const int64_t width = tables[k].width;
            const float *from = tables[k].data + row * width;
            each_number(width, [&](int64_t j) { to[j] = from[j]; });
            to += width;
        }
    });
}

void unpack_rows(const gs_row_table *tables, int table_count, const float *packed, int64_t count, int threads) {
    each_row(tables, table_count, packed, count, threads, [&](const float *from, int64_t row) {
        for (int k = 0; k < table_count; ++k) {
            const int64_t width = tables[k].width;
            const float divisor = tables[k].divisor;
            float *to = tables[k].data + row * width;
            if (tables[k].adds)
                each_number(width, [&](int64_t j) { to[j] += from[j] / divisor; });
            else
                each_number(width, [&](int64_t j) { to[j] = from[j] / divisor; });
            from += width;
        }
    });
}

} // namespace gs
