/* Random numbers without state, each a function of what it is drawn for: Philox 4x32-10 (Salmon et al. 2011, "Parallel
 * random numbers: as easy as 1, 2, 3"). Integers of 32 bits and floats are enough for another device to draw the same
 * numbers. */
#pragma once

#include "base.h"

/* Where the numbers of a call lie: the key is the low and the high half of `seed`, the counter of a row is (row, step,
 * stream, 0). Numbers of different seeds, steps, streams and rows are independent. */
typedef struct gs_random {
    uint64_t seed;
    uint32_t step;
    uint32_t stream;
    const int64_t *rows; /* [count], 0 to 2^32 - 1; null: 0 to count - 1 */
    int64_t count;       /* M */
    int32_t threads;     /* 0: gs_default_threads() */
} gs_random;

/* One block of the generator, for tests. */
GS_API gs_status gs_philox(const uint32_t counter[4], const uint32_t key[2], uint32_t words[4]);
/* `out` [M]: uniform in [0, 1): the upper 24 bits of word 0, times 2^-24; every device draws the same bits. */
GS_API gs_status gs_random_uniform(const gs_random *random, float *out);
/* `out` [M, 3]: normal with mean 0 and variance 1, by Box and Muller (1958):
 *     n0 = r(w0) cos a(w1), n1 = r(w0) sin a(w1), n2 = r(w2) cos a(w3),
 *     r(w) = sqrt(-2 ln u), u = (floor(w / 2^8) + 1) / 2^24, at most 5.768,
 *     a(w) = pi / 2 (q + f), q = floor(w / 2^30), f = (floor(w / 2^6) mod 2^24) / 2^24 - 1 / 2.
 * The float32 operations, without contraction, are those of random.cpp. They are within 1e-6 of the formula; a device
 * whose division and square root are not correctly rounded is too. */
GS_API gs_status gs_random_normal(const gs_random *random, float *out);
