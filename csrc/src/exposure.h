// Exposure of a photo: sRGB values of light times gain^2.4.
#pragma once

#include "../shared/constants.h"

#include <cmath>

namespace gs {

// Two lines that meet: values below `dark` are multiplied by `steep`, others by `gain` with `offset` added. The first
// is the linear part of the curve, 12.92 L; the second is exact where value and result are above that part. The
// exposure is continuous and monotonic, and black stays black.
struct ExposureCurve {
    float gain, offset, steep, dark;
};

inline ExposureCurve exposure_curve(float gain) {
    const double g = double(gain), o = double(GS_EXPOSURE_OFFSET), rise = double(GS_EXPOSURE_POWER) - 1;
    const double steep = g * std::pow(g, rise);
    const double dark = gain == 1.0f ? o / rise : o * (g - 1) / (steep - g);
    return {gain, float(o * (g - 1)), float(steep), float(dark)};
}

} // namespace gs
