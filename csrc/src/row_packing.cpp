// Row packing: rows of several tables in one buffer, and back, for exchange between ranks.
#include "row_packing.h"

#include "parallel.h"
#include "thread_count.h"

#include <algorithm>
#include <atomic>
#include <cstring>

namespace gs {

namespace {

constexpr int64_t kRows = 2048;
constexpr int64_t kAhead = 8; // rows to prefetch: their addresses in the tables are random

// Calls work(j) for j below width, specialised for the common widths of a training's tables: a loop of unknown length,
// or a call of memcpy, has more overhead than work for three numbers.
template <class Work> inline void each_number(int64_t width, Work work) {
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

// Calls work(i, row) in parallel for all i below `count` whose row, row_of(i), is in range of `rows`; returns the first
// i whose row is not, or -1.
template <class RowOf, class Work>
int64_t each_row(const gs_row_table *tables, int table_count, int64_t rows, int64_t count, int threads, RowOf row_of,
                 Work work) {
    std::atomic<int64_t> first{count};
    parallel_for(size_t((count + kRows - 1) / kRows), threads_of(threads), [&](size_t c, int) {
        const int64_t begin = int64_t(c) * kRows, end = std::min(begin + kRows, count);
        for (int64_t i = begin; i < end; ++i) {
            if (i + kAhead < end) {
                const int64_t next = row_of(i + kAhead);
                if (next >= 0 && next < rows)
                    for (int k = 0; k < table_count; ++k)
                        __builtin_prefetch(tables[k].data + next * tables[k].width);
            }
            const int64_t row = row_of(i);
            if (row >= 0 && row < rows) {
                work(i, row);
                continue;
            }
            int64_t known = first.load();
            while (i < known && !first.compare_exchange_weak(known, i)) {
            }
        }
    });
    return first.load() < count ? first.load() : -1;
}

int64_t width_of(const gs_row_table *tables, int table_count) {
    int64_t width = 1;
    for (int k = 0; k < table_count; ++k)
        width += tables[k].width;
    return width;
}

} // namespace

int64_t pack_rows(const gs_row_table *tables, int table_count, int64_t rows, const int64_t *places, float *packed,
                  int64_t count, int threads) {
    const int64_t across = width_of(tables, table_count);
    const auto row_of = [&](int64_t i) { return places[i]; };
    return each_row(tables, table_count, rows, count, threads, row_of, [&](int64_t i, int64_t row) {
        float *to = packed + i * across;
        const int32_t place = int32_t(row);
        std::memcpy(to++, &place, sizeof place);
        for (int k = 0; k < table_count; ++k) {
            const int64_t width = tables[k].width;
            const float divisor = tables[k].divisor;
            float *from = tables[k].data + row * width;
            if (divisor != 1)
                each_number(width, [&](int64_t j) { from[j] /= divisor; });
            each_number(width, [&](int64_t j) { to[j] = from[j]; });
            to += width;
        }
    });
}

int64_t unpack_rows(const gs_row_table *tables, int table_count, int64_t rows, const float *packed, int32_t *marks,
                    int64_t count, int threads) {
    const int64_t across = width_of(tables, table_count);
    const auto row_of = [&](int64_t i) {
        int32_t row;
        std::memcpy(&row, packed + i * across, sizeof row);
        return int64_t(row);
    };
    return each_row(tables, table_count, rows, count, threads, row_of, [&](int64_t i, int64_t row) {
        const float *from = packed + i * across + 1;
        for (int k = 0; k < table_count; ++k) {
            const int64_t width = tables[k].width;
            float *to = tables[k].data + row * width;
            if (tables[k].adds)
                each_number(width, [&](int64_t j) { to[j] += from[j]; });
            else
                each_number(width, [&](int64_t j) { to[j] = from[j]; });
            from += width;
        }
        if (marks)
            marks[row] = 1;
    });
}

} // namespace gs
