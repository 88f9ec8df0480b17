// C API of random numbers: checks arguments and calls the generator.
#include "api.h"
#include "random.h"

using namespace gs;

namespace {

gs_status check_random(const gs_random *random, const float *out) {
    if (!random)
        return fail(GS_BAD_ARGUMENT, "random is null");
    if (const gs_status s = check_splat_count(random->count, "random.count"))
        return s;
    if (const gs_status s = check_threads(random->threads))
        return s;
    if (random->count > 0 && !out)
        return fail(GS_BAD_ARGUMENT, "the array of random numbers is null");
    return GS_OK;
}

} // namespace

gs_status gs_philox(const uint32_t counter[4], const uint32_t key[2], uint32_t words[4]) {
    if (!counter || !key || !words)
        return fail(GS_BAD_ARGUMENT, "gs_philox: an array is null");
    return guarded("gs_philox", [&] {
        philox(counter, key, words);
        return GS_OK;
    });
}

gs_status gs_random_uniform(const gs_random *random, float *out) {
    if (const gs_status s = check_random(random, out))
        return s;
    return guarded("gs_random_uniform", [&] {
        random_uniform(*random, out);
        return GS_OK;
    });
}

gs_status gs_random_normal(const gs_random *random, float *out) {
    if (const gs_status s = check_random(random, out))
        return s;
    return guarded("gs_random_normal", [&] {
        random_normal(*random, out);
        return GS_OK;
    });
}
