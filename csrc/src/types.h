// Integer sizes that all parts of the library share: rounded-up quotients, chunks of rows.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace gs {

template <class Int> constexpr Int ceil_div(Int a, std::type_identity_t<Int> b) { return (a + b - 1) / b; }

// Rows of splats are processed in chunks of this many; part of the numeric definition of sums, so it never depends on threads.
constexpr int64_t kChunk = 1024;
constexpr int64_t chunks_of(int64_t rows) { return ceil_div(rows, kChunk); }

} // namespace gs
