// Counter-based random numbers: counters of rows, and blocks of rows to threads.
#include "random.h"

#include "cpu_dispatch.h"
#include "parallel.h"
#include "thread_count.h"

#include <algorithm>

namespace gs {

namespace {

constexpr int64_t kRows = 4096; // of a task

// Words of `count` rows from `first` on.
void draw(const gs_random &random, int64_t first, int64_t count, RandomWords &words) {
    for (int64_t i = 0; i < count; ++i) {
        words.w[0][i] = uint32_t(random.rows ? random.rows[first + i] : first + i);
        words.w[1][i] = random.step;
        words.w[2][i] = random.stream;
        words.w[3][i] = 0;
    }
    kernels().philox(words, count, uint32_t(random.seed), uint32_t(random.seed >> 32));
}

// Calls body(first, count, words) for all blocks of rows.
template <class Body> void for_blocks(const gs_random &random, Body body) {
    const size_t tasks = size_t((random.count + kRows - 1) / kRows);
    parallel_for(tasks, threads_of(random.threads), [&](size_t task, int) {
        RandomWords words;
        const int64_t end = std::min(int64_t(task + 1) * kRows, random.count);
        for (int64_t first = int64_t(task) * kRows; first < end; first += kRandomBlock) {
            const int64_t count = std::min(kRandomBlock, end - first);
            draw(random, first, count, words);
            body(first, count, words);
        }
    });
}

} // namespace

void philox(const uint32_t counter[4], const uint32_t key[2], uint32_t out[4]) {
    RandomWords words;
    for (int k = 0; k < 4; ++k)
        words.w[k][0] = counter[k];
    kernels().philox(words, 1, key[0], key[1]);
    for (int k = 0; k < 4; ++k)
        out[k] = words.w[k][0];
}

void random_uniform(const gs_random &random, float *out) {
    for_blocks(random, [&](int64_t first, int64_t count, const RandomWords &words) {
        kernels().to_uniform(words, count, out + first);
    });
}

void random_normal(const gs_random &random, float *out) {
    for_blocks(random, [&](int64_t first, int64_t count, const RandomWords &words) {
        kernels().to_normal(words, count, out + 3 * first);
    });
}

} // namespace gs
