// Adam on hostile gradients and rates: no crash, bad rows are counted and skipped, others are unaffected by them.
#include "adam_state.h"

using fuzz::AdamState;
using fuzz::all_finite;
using fuzz::Bytes;
using fuzz::Noise;

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Noise noise(in.word());
    // Sometimes more rows than a chunk of the library, but in narrow tensors, to stay fast.
    const uint8_t few = in.byte(), steps = 1 + in.byte() % 6;
    const bool many = few >= 248;
    const size_t n = many ? 1020 + (few - 248) * 16u : 1 + few % 80;
    AdamState all(n, 1 + in.byte() % 4, noise), late(n, 1 + in.byte() % (many ? 5 : 45), noise);
    for (uint8_t &pending : late.pending) // as after many steps; some rows have the maximum
        pending = noise(0, 1) < 0.8f ? uint8_t(noise(0, 9)) : uint8_t(GS_ADAM_PENDING_SIZE - 1 - int(noise(0, 3)));
    for (size_t k = 1; k < late.factors.size(); ++k)
        late.factors[k] = late.factors[k - 1] + noise(0, 0.01f);
    const int64_t start = in.byte() % 2 ? 1 : 1 + int64_t(in.word() % 1000000);
    std::vector<int32_t> radii(n);
    const float rate = 0.01f;
    for (int64_t step = start; step < start + steps; ++step) {
        for (AdamState *s : {&all, &late})
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
        AdamState all2 = all, late2 = late;
        const int mode = in.byte() % 3 == 0 ? GS_ADAM_WAIT : GS_ADAM_VISIBLE;
        gs_adam_tensor one[] = {all.view(GS_ADAM_ALL, rate, step), late.view(mode, rate, step)};
        gs_adam_tensor two[] = {all2.view(GS_ADAM_ALL, rate, step), late2.view(mode, rate, step)};
        const gs_adam first = {int64_t(n), 2, one, radii.data(), 1}, second = {int64_t(n), 2, two, radii.data(), 3};
        REQUIRE(gs_adam_step(&first, &bad) == GS_OK);
        REQUIRE(gs_adam_step(&second, &again) == GS_OK);
        REQUIRE(bad == again && bad == expected);
        REQUIRE(equal(all, all2) && equal(late, late2));
        for (const AdamState *s : {&all, &late})
            REQUIRE(all_finite(s->param) && all_finite(s->moment1) && all_finite(s->moment2));
    }
    gs_adam_tensor wrong = all.view(int(in.byte()) - 3, in.hostile(), int64_t(in.byte()) - 2);
    wrong.width = int32_t(in.byte() % 2 ? all.width : 0);
    const gs_adam odd = {int64_t(n), 1, &wrong, radii.data(), int(in.byte()) - 3};
    const gs_status status = gs_adam_step(&odd, nullptr);
    REQUIRE(status == GS_OK || (status == GS_BAD_ARGUMENT && std::strlen(gs_last_error()) > 0));
    return 0;
}
