// Loss sizes: constants of the fused L1 + SSIM loss, shared by driver and kernels.
#pragma once

#include "types.h"

namespace gs {

constexpr int kWindow = 11;
constexpr int kReach = kWindow / 2;
// Rows that are filtered together, equal to the reach of the window, so that each stage is one group later.
constexpr int kLossGroup = kReach;
// Groups of rows that the windows over a group of rows touch.
constexpr int kLossRing = 3;
// Floats next to a tile, or between two of its stages, for the reach of the window along a row.
constexpr int kLossMargin = 16;
// Maps of SSIM, and the derivatives with respect to them for its gradient.
constexpr int kLossMaps = 4, kLossDerivatives = 3;
// Sums of a tile: L1, SSIM, squares, and by channel the derivative in ln gain.
constexpr int kLossSums = 6;

// The tiles a picture is cut into: a thread takes one at once. Sums are per tile, so they are part of the numeric
// definition. An even number of bands, so that two threads have the same to do; wide strips, for what lies beside a tile
// is computed twice, but not wider than the rows in use fit into the second cache.
struct LossGrid {
    int bands, strips; // tiles from top to bottom, and from left to right
    int rows, columns; // of a tile, px

    LossGrid(int width, int height) {
        rows = ceil_div(ceil_div(height, 2 * ceil_div(height, 192)), kLossGroup) * kLossGroup;
        bands = ceil_div(height, rows);
        columns = ceil_div(width, ceil_div(width, 512));
        strips = ceil_div(width, columns);
    }
    int tiles() const { return bands * strips; }
    // Floats of a row: the tile, two margins at both sides and what vectors hang over.
    size_t stride() const { return size_t(ceil_div(3 * columns, 16) * 16 + 5 * kLossMargin); }
    // Floats that a thread needs.
    size_t scratch_floats() const {
        const int rows_of_gain = 2; // it, side by side, and its sums
        return size_t(((2 + kLossDerivatives) * kLossRing + kLossMaps) * kLossGroup + rows_of_gain) * stride();
    }
};

} // namespace gs
