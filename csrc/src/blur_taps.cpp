// Taps of a blur: a Gaussian of any direction as a line and an axis (Geusebroek et al. 2003).
// The line leads from row to row, or from column to column where the blur is wider along rows, so that it moves by at
// most one pixel across with each; between two pixels, values are interpolated.
#include "blur.h"

#include "../shared/constants.h"

#include <algorithm>
#include <cmath>

namespace gs {

namespace {

// Along the points (k, slope k), or (slope k, k) if `down`, of this variance, px^2.
std::vector<BlurTap> taps_along(float variance, float slope, bool down) {
    std::vector<BlurTap> taps;
    const auto add = [&](int along, double across, double weight) {
        if (weight > 0)
            taps.push_back(down ? BlurTap{int(across), along, float(weight)}
                                : BlurTap{along, int(across), float(weight)});
    };
    const int reach = int(std::ceil(double(GS_BLUR_REACH) * std::sqrt(double(variance))));
    const auto bell = [&](int k) { return k ? std::exp(-0.5 * k * k / double(variance)) : 1.0; };
    double total = 0;
    for (int k = -reach; k <= reach; ++k)
        total += bell(k);
    for (int k = -reach; k <= reach; ++k) {
        const double weight = bell(k) / total, across = double(slope) * k, below = std::floor(across);
        add(k, below, weight * (1 - (across - below)));
        add(k, below + 1, weight * (across - below));
    }
    return taps;
}

} // namespace

std::array<std::vector<BlurTap>, 2> blur_taps(const float covariance[3]) {
    const float xx = covariance[0], xy = covariance[1], yy = covariance[2];
    const bool down = yy > xx;
    const float longer = std::max(xx, yy), slope = longer > 0 ? xy / longer : 0.0f;
    const float rest = std::max(std::min(xx, yy) - slope * xy, 0.0f);
    return {taps_along(longer, slope, down), taps_along(rest, 0.0f, !down)};
}

} // namespace gs
