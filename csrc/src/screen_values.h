// Screen-space values of projected splats as arrays, for tests and tools.
#pragma once

#include "raster_types.h"

#include <algorithm>
#include <cmath>

namespace gs {

// The arrays of gs_raster_projected; any may be null.
struct ScreenValues {
    float *means2d, *depths, *conics, *colors, *opacities;

    // Zeros for `count` splats.
    void clear(size_t count) const {
        const auto fill = [&](float *p, size_t width) {
            if (p)
                std::fill_n(p, count * width, 0.0f);
        };
        fill(means2d, 2);
        fill(depths, 1);
        fill(conics, 3);
        fill(colors, 3);
        fill(opacities, 1);
    }
    void put(size_t row, const Projected &p) const {
        if (means2d) {
            means2d[2 * row] = p.mean_x;
            means2d[2 * row + 1] = p.mean_y;
        }
        if (depths)
            depths[row] = p.channel[kChannelZ];
        if (conics) {
            conics[3 * row] = p.ua * p.ua / GS_HALF_LOG2E;
            conics[3 * row + 1] = p.ua * p.ub / GS_HALF_LOG2E;
            conics[3 * row + 2] = (p.ub * p.ub + p.vc * p.vc) / GS_HALF_LOG2E;
        }
        if (colors)
            std::copy_n(p.channel, 3, colors + 3 * row);
        if (opacities)
            opacities[row] = std::exp2(p.log2_opacity);
    }
};

} // namespace gs
