// Thread pool: parallel_for, with subnormals off inside and the host's floating-point state restored.
#pragma once

#include <cstddef>
#include <functional>

namespace gs {

// Calls body(index, worker) for every index in [0, count), on up to `threads` threads (this one included), each index
// once, in no particular order. `worker` is below `threads` and unique among concurrent calls. `body` must not throw.
// Subnormal floats are flushed to zero inside; the caller's floating-point state is restored. A forked process may call
// it, even if its parent's threads were inside a call.
void parallel_for(size_t count, int threads, const std::function<void(size_t, int)> &body);

} // namespace gs
