// Thread count of a call: GSCORE_THREADS, or the number of usable cores.
#include "thread_count.h"

#include "gscore/base.h"

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <thread>

#if defined(__linux__)
#include <sched.h>
#endif

namespace gs {
namespace {

int cores() {
#if defined(__linux__)
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) == 0 && CPU_COUNT(&set) > 0)
        return CPU_COUNT(&set);
#endif
    return int(std::clamp(std::thread::hardware_concurrency(), 1u, unsigned(GS_THREADS_MAX)));
}

// Parses `text` as a number from 0 to GS_THREADS_MAX; -1: invalid.
int number(const char *text) {
    int n = 0;
    for (; *text; ++text) {
        if (*text < '0' || *text > '9')
            return -1;
        n = 10 * n + (*text - '0');
        if (n > GS_THREADS_MAX)
            return -1;
    }
    return n;
}

// Read once, because a host may change its environment while another thread reads it; without a lock, which a fork at
// the wrong moment would leave locked.
std::atomic<int> found{0};

} // namespace

int default_threads() {
    if (const int known = found.load())
        return known;
    const char *const text = std::getenv("GSCORE_THREADS");
    const int wanted = text ? number(text) : 0;
    if (wanted < 0)
        return 0;
    const int threads = wanted > 0 ? wanted : cores();
    found.store(threads);
    return threads;
}

} // namespace gs
