// gs_add_pull and gs_exp2 on any bits: nothing is written beyond the arrays, and what is written is what was promised.
#include "scene.h"

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

namespace {

// An array of noise, a few numbers of it replaced by hostile ones.
std::vector<float> numbers(size_t count, Bytes &in, Noise &noise) {
    std::vector<float> found(count);
    for (float &v : found)
        v = noise(-2, 2);
    for (int k = in.byte() % 8; k > 0 && count; --k) {
        const size_t at = in.byte() | size_t(in.byte()) << 8;
        found[at % count] = in.hostile();
    }
    return found;
}

// Equal, NaN to NaN of any bits.
bool same(float a, float b) { return a == b || (std::isnan(a) && std::isnan(b)); }

// The library takes subnormal numbers for zero.
float flush(float v) { return std::fabs(v) < std::numeric_limits<float>::min() ? 0.0f : v; }

float length(float x, float y) { return std::sqrt(flush(flush(x * x) + flush(y * y))); }

void pull(size_t n, Bytes &in, Noise &noise) {
    const std::vector<float> v = numbers(2 * n, in, noise), before = numbers(n, in, noise);
    std::vector<int32_t> radii(n);
    for (int32_t &r : radii)
        r = int32_t(noise(-3, 3));
    if (n)
        radii[in.byte() % n] = int32_t(in.word());
    const float scale_x = in.hostile(), scale_y = in.hostile();
    Output sums[2] = {Output(n), Output(n)}, counts[2] = {Output(n), Output(n)};
    for (int k = 0; k < 2; ++k) {
        if (n)
            std::memcpy(sums[k].data(), before.data(), n * sizeof(float));
        std::fill_n(counts[k].data(), n, 5.0f);
        REQUIRE(gs_add_pull(int64_t(n), v.data(), radii.data(), sums[k].data(), counts[k].data(), scale_x, scale_y,
                            1 + 2 * k) == GS_OK);
        REQUIRE(sums[k].guards_hold() && counts[k].guards_hold());
    }
    REQUIRE(sums[0].same_bits(sums[1]) && counts[0].same_bits(counts[1]));
    for (size_t i = 0; i < n; ++i) {
        const float x = flush(flush(v[2 * i]) * flush(scale_x)), y = flush(flush(v[2 * i + 1]) * flush(scale_y));
        const bool taken = radii[i] > 0;
        REQUIRE(counts[0][i] == (taken ? 6.0f : 5.0f));
        REQUIRE(same(sums[0][i], flush(flush(before[i]) + (taken ? length(x, y) : 0.0f))));
    }
    const gs_status status = gs_add_pull(int64_t(n) - in.byte() % 3 * int64_t(n + 1), v.data(), radii.data(),
                                         sums[0].data(), counts[0].data(), 1, 1, int(in.byte()) - 9);
    REQUIRE(status == GS_OK || (status == GS_BAD_ARGUMENT && std::strlen(gs_last_error()) > 0));
}

void powers(size_t n, Bytes &in, Noise &noise) {
    std::vector<float> x = numbers(n, in, noise);
    const float reach = float(1 + in.byte() % 64);
    for (float &v : x)
        v *= reach;
    Output y(n);
    REQUIRE(gs_exp2(x.data(), y.data(), int64_t(n)) == GS_OK);
    REQUIRE(y.guards_hold() && y.all_written());
    for (size_t i = 0; i < n; ++i)
        if (x[i] >= -126 && x[i] <= 127) {
            const double wanted = std::exp2(double(x[i]));
            REQUIRE(std::fabs(double(y[i]) - wanted) <= 3e-7 * wanted);
        }
    REQUIRE(gs_exp2(nullptr, y.data(), 1) == GS_BAD_ARGUMENT && gs_exp2(x.data(), y.data(), -1) == GS_BAD_ARGUMENT);
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    fuzz::use_isa(in.byte());
    Noise noise(in.word());
    const uint8_t few = in.byte();
    pull(few < 250 ? few : 8190 + (few - 250), in, noise); // about a chunk of the library
    powers(in.byte(), in, noise);
    return 0;
}
