/* Matches between the features of photos. */
#pragma once

#include "base.h"

/* Descriptors of a photo's features, such as SIFT's. */
#define GS_DESCRIPTOR_SIZE 128
#define GS_DESCRIPTORS_MAX 1048576
typedef struct gs_descriptors {
    int32_t count;         /* 0 to GS_DESCRIPTORS_MAX */
    const uint8_t *values; /* [count, GS_DESCRIPTOR_SIZE] */
} gs_descriptors;

/* Match the features of two photos: mutual nearest neighbours at most `max_distance` apart, and nearer than `max_ratio`
 * times the second nearest (Lowe 2004), if there is one. Exact. matches [first.count] are rows of `second`, or -1.
 * Single-threaded: callers match several pairs of photos in parallel. */
GS_API gs_status gs_match_descriptors(const gs_descriptors *first, const gs_descriptors *second, double max_distance,
                                      double max_ratio, int32_t *matches);
