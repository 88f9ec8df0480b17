// exp2 kernel: the exponential of the blend loops, for tests and measurements.
#pragma once

#include "simd.h"

namespace gs::GS_NAMESPACE {

static void exp2_array(const float *x, float *y, int64_t count) {
    for (int64_t i = 0; i < count; i += kLanes) {
        const size_t size = size_t(count - i < kLanes ? count - i : kLanes) * sizeof(float);
        Vec in = {}, out;
        std::memcpy(&in, x + i, size);
        exp2_above<1>(-126.0f, &in, &out);
        std::memcpy(y + i, &out, size);
    }
}

} // namespace gs::GS_NAMESPACE
