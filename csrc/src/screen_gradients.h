// Screen-space gradient statistics for densification.
#pragma once

#include <cstdint>

namespace gs {

void add_screen_gradients(int64_t count, const float *v_means2d, const int32_t *radii, float *grad2d, float *views,
                          float scale_x, float scale_y, int threads);

} // namespace gs
