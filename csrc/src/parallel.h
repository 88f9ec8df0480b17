// A thread pool with one verb: parallel_for.
#pragma once

#include <cstddef>
#include <functional>

namespace gs {

// Calls body(index, worker) for every index in [0, count), on up to `threads` threads (this one included), each index
// once, in no particular order. `worker` is below `threads` and unique among concurrent calls. `body` must not throw.
// Subnormal floats count as zero inside; the caller's floating-point state is restored.
void parallel_for(size_t count, int threads, const std::function<void(size_t, int)> &body);

// GSCORE_THREADS where set to a positive number, else the cores this process may use.
int default_threads();

// Threads to use where `wanted` were asked for; 0: all.
inline int threads_of(int wanted) { return wanted > 0 ? wanted : default_threads(); }

} // namespace gs
