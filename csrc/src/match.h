// Feature matching between two photos: interface and sizes shared by driver and kernels.
#pragma once

#include "types.h"

namespace gs {

// Rows of the first photo compared at a time.
constexpr int kMatchRows = 6;
// Rows of the second photo are padded to two vectors of any instruction set.
constexpr int kMatchColumns = 32;
// Closeness of a missing descriptor, far below that of any two descriptors.
constexpr int32_t kNoCloseness = -(1 << 30);

void match_descriptors(const gs_descriptors &first, const gs_descriptors &second, double max_distance, double max_ratio,
                       int32_t *matches);

} // namespace gs
