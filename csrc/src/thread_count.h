// Thread count of a call: GSCORE_THREADS, or the number of usable cores.
#pragma once

namespace gs {

// GSCORE_THREADS, or the number of usable cores if that is unset, empty or 0; 0 if its value is not an integer from 0
// to GS_THREADS_MAX.
int default_threads();

// Number of threads of a call with the option `requested`; 0: all.
inline int threads_of(int requested) { return requested > 0 ? requested : default_threads(); }

} // namespace gs
