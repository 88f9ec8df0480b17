// A tensor in training, for the targets of Adam.
#pragma once

#include "bytes.h"
#include "gscore.h"

#include <cmath>

namespace fuzz {

struct AdamState {
    size_t n, width;
    std::vector<float> param, grad, moment1, moment2;
    std::vector<uint8_t> visible, pending;
    std::vector<double> factors = std::vector<double>(GS_ADAM_PENDING_SIZE);

    AdamState(size_t rows, size_t columns, Noise &noise)
        : n(rows), width(columns), param(n * width), grad(n * width), moment1(n * width), moment2(n * width),
          visible(n), pending(n) {
        for (float &v : param)
            v = noise(-1, 1);
    }
    gs_adam_tensor view(int mode, float lr, int64_t step) {
        return {param.data(),
                grad.data(),
                moment1.data(),
                moment2.data(),
                int32_t(width),
                mode,
                lr,
                step,
                mode == GS_ADAM_ALL ? nullptr : visible.data(),
                mode == GS_ADAM_ALL ? nullptr : pending.data(),
                mode == GS_ADAM_ALL ? nullptr : factors.data()};
    }
};

inline bool all_finite(const std::vector<float> &values) {
    for (const float v : values)
        if (!std::isfinite(v))
            return false;
    return true;
}

inline bool equal(const AdamState &a, const AdamState &b) {
    const auto same = [](const auto &x, const auto &y) {
        return x.empty() || std::memcmp(x.data(), y.data(), x.size() * sizeof x[0]) == 0;
    };
    return same(a.param, b.param) && same(a.moment1, b.moment1) && same(a.moment2, b.moment2) &&
           same(a.visible, b.visible) && same(a.pending, b.pending) && same(a.factors, b.factors);
}

} // namespace fuzz
