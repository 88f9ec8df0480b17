// Thread count of a call.
#pragma once

namespace gs {

// GSCORE_THREADS, or where that is not set, empty or 0 the cores this process may use; 0 where it is set to anything but
// a whole number up to GS_THREADS_MAX.
int default_threads();

// Threads of a call with the option `requested`; 0: all.
inline int threads_of(int requested) { return requested > 0 ? requested : default_threads(); }

} // namespace gs
