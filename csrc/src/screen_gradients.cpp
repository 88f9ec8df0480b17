// Screen-space gradient statistics: sums over views, the criterion of densification.
#include "screen_gradients.h"

#include "parallel.h"
#include "thread_count.h"

#include <algorithm>
#include <cmath>

namespace gs {

namespace {

constexpr int64_t kRows = 8192;

} // namespace

void add_screen_gradients(int64_t count, const float *v_means2d, const int32_t *radii, float *grad2d, float *views,
                          float scale_x, float scale_y, int threads) {
    parallel_for(size_t((count + kRows - 1) / kRows), threads_of(threads), [&](size_t c, int) {
        const int64_t begin = int64_t(c) * kRows, end = std::min(begin + kRows, count);
        for (int64_t i = begin; i < end; ++i) {
            const float x = v_means2d[2 * i] * scale_x, y = v_means2d[2 * i + 1] * scale_y;
            const float length = std::sqrt(x * x + y * y);
            grad2d[i] += radii[i] > 0 ? length : 0.0f;
            views[i] += radii[i] > 0 ? 1.0f : 0.0f;
        }
    });
}

} // namespace gs
