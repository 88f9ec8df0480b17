// Blur of a photo: the convolution of a picture with a Gaussian, in two passes along lines.
#pragma once

#include "gscore/loss.h"

#include <array>
#include <vector>

namespace gs {

// A weight of the pixel at (x + dx, y + dy).
struct BlurTap {
    int32_t dx, dy;
    float weight;
};

// Taps of both passes of a blur, in their order; each set is even and its weights add up to 1.
std::array<std::vector<BlurTap>, 2> blur_taps(const float covariance[3]);

void blur_image(const gs_blur_args &, float *out);

} // namespace gs
