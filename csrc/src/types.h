// Integer sizes that all parts of the library share: rounded-up quotients, chunks of rows.
#pragma once

#include <cstddef>
#include <cstdint>

namespace gs {

constexpr int ceil_div(int a, int b) { return (a + b - 1) / b; }

// Rows of splats are processed in chunks of this many; part of the numeric definition of sums, so it never depends on threads.
constexpr int64_t kChunk = 1024;
constexpr int64_t chunks_of(int64_t rows) { return (rows + kChunk - 1) / kChunk; }

} // namespace gs
