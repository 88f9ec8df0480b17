// Sizes of the fused loss, shared by its driver and its kernels.
#pragma once

#include "types.h"

namespace gs {

constexpr int kWindow = 11;
// Rows a thread takes at once; sums are per band, so it is part of the numeric definition.
constexpr int kLossBand = 64;
// Floats before a row and after it: the window's reach and a vector's overhang.
constexpr int kLossMargin = 16;

constexpr int loss_stride(int width) { return (width + 15) / 16 * 16 + 3 * kLossMargin; }
// Rows of a thread's rings and single rows.
constexpr int kLossRows = 9 * kWindow + 6;
constexpr size_t loss_scratch_floats(int width) { return size_t(kLossRows) * size_t(loss_stride(width)); }
constexpr int loss_bands(int height) { return (height + kLossBand - 1) / kLossBand; }

} // namespace gs
