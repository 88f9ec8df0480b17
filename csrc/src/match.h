// Feature matching between two photos: interface and sizes shared by driver and kernels.
#pragma once

#include "types.h"

namespace gs {

// Rows of the first photo that are compared at once.
constexpr int kMatchRows = 6;
// Rows of the second photo come in vectors of any instruction set, two at a time.
constexpr int kMatchColumns = 32;
// Closeness without a descriptor; that of any two descriptors is far above.
constexpr int32_t kNoCloseness = -(1 << 30);

void match_descriptors(const gs_descriptors &first, const gs_descriptors &second, double max_distance, double max_ratio,
                       int32_t *matches);

} // namespace gs
