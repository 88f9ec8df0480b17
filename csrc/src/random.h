// Counter-based random numbers by seed, step and row (Philox 4x32-10), uniform and normal.
#pragma once

#include "gscore/random.h"

namespace gs {

constexpr int64_t kRandomBlock = 256;

// Words of the rows of a block: counters, then random numbers.
struct RandomWords {
    uint32_t w[4][kRandomBlock];
};

void philox(const uint32_t counter[4], const uint32_t key[2], uint32_t words[4]);
void random_uniform(const gs_random &random, float *out);
void random_normal(const gs_random &random, float *out);

} // namespace gs
