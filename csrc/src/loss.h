// Loss sizes: constants of the fused L1 + SSIM loss, shared by driver and kernels.
#pragma once

#include "gscore/loss.h"
#include "types.h"

namespace gs {

constexpr int kReach = GS_SSIM_WINDOW / 2;
// Rows filtered together, equal to the radius of the window, so that each stage is one group later.
constexpr int kLossGroup = kReach;
// Groups of rows covered by the windows over a group of rows.
constexpr int kLossRing = 3;
// Margin of a tile, and between two of its stages, for the radius of the window along a row, floats.
constexpr int kLossMargin = 16;
// Maps of SSIM, and the derivatives with respect to them for its gradient.
constexpr int kLossMaps = 4, kLossDerivatives = 3;
// Sums of a tile: L1, SSIM, squares, and by channel the derivative in ln gain.
constexpr int kLossSums = 6;

// The tiles of a picture, one thread per tile. Sums are per tile, so the grid is part of the numeric definition. An
// even number of bands balances two threads; strips are wide, because the margins of a tile are computed twice, but the
// rows in use must fit into the L2 cache.
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
    // Floats of a row: the tile, two margins on both sides and padding for vectors.
    size_t stride() const { return size_t(ceil_div(3 * columns, 16) * 16 + 5 * kLossMargin); }
    // Scratch floats per thread.
    size_t scratch_floats() const {
        const int rows_of_gradient = 2; // the mask, and sums of the derivatives in ln gain
        return size_t(((2 + kLossDerivatives) * kLossRing + kLossMaps) * kLossGroup + rows_of_gradient) * stride();
    }
};

struct LossArgs {
    const gs_loss_args *args;
    double *partial; // [tiles * kLossSums] sums of l1, ssim, mse and, by channel, of the derivative in ln gain
    float *v_image;  // null: no gradient
};

} // namespace gs
