// Thread count of a call.
#pragma once

namespace gs {

// GSCORE_THREADS, or where that is not set, empty or 0 the cores this process may use; 0 where it is set to anything but
// a whole number up to GS_THREADS_MAX.
int default_threads();

// Threads to use where `wanted` were asked for; 0: all.
inline int threads_of(int wanted) { return wanted > 0 ? wanted : default_threads(); }

} // namespace gs
