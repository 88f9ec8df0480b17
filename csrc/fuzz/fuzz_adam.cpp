// Adam on hostile gradients and rates: nothing crashes, bad rows are counted and left out, others move as without them.
#include "bytes.h"
#include "gscore.h"

#include <cmath>

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

namespace {

struct State {
    size_t n, width;
    std::vector<float> param, grad, moment1, moment2;
    std::vector<uint8_t> seen, lag;
    std::vector<double> drift = std::vector<double>(GS_ADAM_LAGS);

    State(size_t rows, size_t columns, Noise &noise)
        : n(rows), width(columns), param(n * width), grad(n * width), moment1(n * width), moment2(n * width), seen(n),
          lag(n) {
        for (float &v : param)
            v = noise(-1, 1);
    }
    gs_adam_tensor view(int mode, float lr, int64_t step) {
        return {param.data(), grad.data(), moment1.data(), moment2.data(), int32_t(width), mode, lr, step,
                mode == GS_ADAM_ALL ? nullptr : seen.data(), mode == GS_ADAM_ALL ? nullptr : lag.data(),
                mode == GS_ADAM_ALL ? nullptr : drift.data()};
    }
};

bool finite(const std::vector<float> &values) {
    for (const float v : values)
        if (!std::isfinite(v))
            return false;
    return true;
}

bool equal(const State &a, const State &b) {
    const auto same = [](const auto &x, const auto &y) {
        return std::memcmp(x.data(), y.data(), x.size() * sizeof x[0]) == 0;
    };
    return same(a.param, b.param) && same(a.moment1, b.moment1) && same(a.moment2, b.moment2) && same(a.seen, b.seen) &&
           same(a.lag, b.lag) && same(a.drift, b.drift);
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Noise noise(in.word());
    const size_t n = 1 + in.byte() * (in.byte() % 8 == 0 ? 19u : 1u);
    State all(n, 1 + in.byte() % 4, noise), late(n, 1 + in.byte() % 45, noise);
    std::vector<int32_t> radii(n);
    const float rate = 0.01f;
    for (int64_t step = 1; step <= 12; ++step) {
        for (State *s : {&all, &late})
            for (float &g : s->grad)
                g = noise(-1, 1);
        for (size_t i = 0; i < n; ++i) {
            radii[i] = noise(0, 1) < 0.5f;
            if (!radii[i]) // as the rasterizer leaves rows that it culled
                std::fill_n(late.grad.begin() + long(i * late.width), late.width, 0.0f);
        }
        std::vector<bool> broken(n);
        for (int k = in.byte() % 4; k > 0; --k) {
            const size_t at = in.byte() | size_t(in.byte()) << 8;
            all.grad[at % all.grad.size()] = in.hostile();
        }
        for (size_t i = 0; i < all.grad.size(); ++i)
            if (!std::isfinite(all.grad[i]))
                broken[i / all.width] = true;
        int64_t expected = 0, bad = -1, again = -1;
        for (const bool b : broken)
            expected += b;
        State all2 = all, late2 = late;
        const int mode = in.byte() % 3 == 0 ? GS_ADAM_WAIT : GS_ADAM_SEEN;
        gs_adam_tensor one[] = {all.view(GS_ADAM_ALL, rate, step), late.view(mode, rate, step)};
        gs_adam_tensor two[] = {all2.view(GS_ADAM_ALL, rate, step), late2.view(mode, rate, step)};
        const gs_adam first = {int64_t(n), 2, one, radii.data(), 1}, second = {int64_t(n), 2, two, radii.data(), 3};
        REQUIRE(gs_adam_step(&first, &bad) == GS_OK);
        REQUIRE(gs_adam_step(&second, &again) == GS_OK);
        REQUIRE(bad == again && bad == expected);
        REQUIRE(equal(all, all2) && equal(late, late2));
        for (const State *s : {&all, &late})
            REQUIRE(finite(s->param) && finite(s->moment1) && finite(s->moment2));
    }
    gs_adam_tensor wrong = all.view(int(in.byte()) - 3, in.hostile(), int64_t(in.byte()) - 2);
    wrong.width = int32_t(in.byte() % 2 ? all.width : 0);
    const gs_adam odd = {int64_t(n), 1, &wrong, radii.data(), int(in.byte()) - 3};
    const gs_status status = gs_adam_step(&odd, nullptr);
    REQUIRE(status == GS_OK || (status == GS_BAD_ARGUMENT && std::strlen(gs_last_error()) > 0));
    return 0;
}
