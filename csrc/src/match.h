// Feature matching between two photos: interface and sizes shared by driver and kernels.
#pragma once

#include "gscore/matching.h"
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

// Nearest descriptors of the other photo. The closeness is twice the dot product minus the other's squared length,
// which decreases with the squared distance.
struct Nearest {
    int32_t *closeness, *second; // [padded], at least kNoCloseness
    int32_t *row;                // [padded]
};

// Descriptors of a photo, padded with zeros whose squared length excludes them.
struct MatchSide {
    int64_t padded;
    const int16_t *values;          // [padded, GS_DESCRIPTOR_SIZE]
    const int32_t *squared_lengths; // [padded]
    Nearest nearest;
};

struct MatchArgs {
    MatchSide first, second;
    int32_t *packed; // [second.padded * GS_DESCRIPTOR_SIZE / 2]
};

} // namespace gs
