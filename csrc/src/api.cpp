// C API: library, instruction sets and threads.
#include "api.h"

#include "cpu_dispatch.h"
#include "thread_count.h"

#include <cstdlib>

namespace gs {

namespace {

gs_status fail_default_threads() {
    const char *const text = std::getenv("GSCORE_THREADS");
    return fail(GS_BAD_ARGUMENT,
                "the environment variable GSCORE_THREADS must be a whole number from 0 (all cores) to %d, got '%.40s'",
                GS_THREADS_MAX, text ? text : "");
}

} // namespace

gs_status check_threads(int32_t threads) {
    if (threads < 0 || threads > GS_THREADS_MAX)
        return fail(GS_BAD_ARGUMENT, "threads must be 0 (all) to %d, got %d", GS_THREADS_MAX, threads);
    if (threads_of(threads) == 0)
        return fail_default_threads();
    return GS_OK;
}

} // namespace gs

using namespace gs;

int32_t gs_abi_version(void) { return GS_ABI_VERSION; }
const char *gs_last_error(void) { return last_failure(); }
const char *gs_isas(void) { return available_kernels(); }
const char *gs_isa(void) { return kernels().name; }

int32_t gs_default_threads(void) {
    const int threads = default_threads();
    if (threads == 0)
        fail_default_threads();
    return threads;
}

gs_status gs_set_isa(const char *name) {
    return guarded("gs_set_isa", [&] {
        if (use_kernels(name))
            return GS_OK;
        return fail(GS_UNSUPPORTED, "instruction set %.40s is not available here; there are: %s",
                    name ? name : "(null)", available_kernels());
    });
}
