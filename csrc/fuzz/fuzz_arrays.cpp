// gs_add_screen_gradients, gs_exp2, gs_pack_rows and gs_unpack_rows on any bits: nothing is written beyond the arrays, and results
// are as the header states.
#include "scene.h"

using fuzz::Bytes;
using fuzz::Noise;
using fuzz::Output;

namespace {

// An array of noise with a few hostile numbers.
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

// Equality in which NaN equals any NaN.
bool same(float a, float b) { return a == b || (std::isnan(a) && std::isnan(b)); }

// The library flushes subnormal numbers to zero.
float flush(float v) { return std::fabs(v) < std::numeric_limits<float>::min() ? 0.0f : v; }

float length(float x, float y) { return std::sqrt(flush(flush(x * x) + flush(y * y))); }

void screen_gradients(size_t n, Bytes &in, Noise &noise) {
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
        REQUIRE(gs_add_screen_gradients(int64_t(n), v.data(), radii.data(), sums[k].data(), counts[k].data(), scale_x,
                                        scale_y, 1 + 2 * k) == GS_OK);
        REQUIRE(sums[k].guards_hold() && counts[k].guards_hold());
    }
    REQUIRE(sums[0].same_bits(sums[1]) && counts[0].same_bits(counts[1]));
    for (size_t i = 0; i < n; ++i) {
        const float x = flush(flush(v[2 * i]) * flush(scale_x)), y = flush(flush(v[2 * i + 1]) * flush(scale_y));
        const bool taken = radii[i] > 0;
        REQUIRE(counts[0][i] == (taken ? 6.0f : 5.0f));
        REQUIRE(same(sums[0][i], flush(flush(before[i]) + (taken ? length(x, y) : 0.0f))));
    }
    const gs_status status =
        gs_add_screen_gradients(int64_t(n) - in.byte() % 3 * int64_t(n + 1), v.data(), radii.data(), sums[0].data(),
                                counts[0].data(), 1, 1, int(in.byte()) - 9);
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

// Packs and unpacks rows of two tables with any bits; then with some row indices out of range.
void packing(size_t n, Bytes &in, Noise &noise) {
    const int32_t widths[2] = {1 + in.byte() % 5, 1 + in.byte() % 48};
    const size_t across = size_t(1 + widths[0] + widths[1]);
    std::vector<float> tables[2];
    Output there[2] = {Output(n * size_t(widths[0])), Output(n * size_t(widths[1]))};
    for (int k = 0; k < 2; ++k) {
        tables[k] = numbers(n * size_t(widths[k]), in, noise);
        std::fill_n(there[k].data(), n * size_t(widths[k]), 3.0f);
    }
    std::vector<int64_t> rows; // each with probability 1/2, without duplicates
    for (size_t i = 0; i < n; ++i)
        if (noise(0, 1) > 0.5f)
            rows.push_back(int64_t(i));
    const int64_t count = int64_t(rows.size());
    Output packed(rows.size() * across);
    std::vector<int32_t> marks(n, 0);
    const bool adds = in.byte() % 2;
    std::vector<float> halves = tables[0];
    const gs_row_table from[2] = {{halves.data(), widths[0], 0, 2.0f}, {tables[1].data(), widths[1], 0, 1.0f}};
    const gs_row_table to[2] = {{there[0].data(), widths[0], adds, 1.0f}, {there[1].data(), widths[1], 0, 1.0f}};
    REQUIRE(gs_pack_rows(from, 2, int64_t(n), rows.data(), packed.data(), count, 1 + in.byte() % 3) == GS_OK);
    REQUIRE(packed.guards_hold());
    REQUIRE(gs_unpack_rows(to, 2, int64_t(n), packed.data(), marks.data(), count, 1 + in.byte() % 3) == GS_OK);
    REQUIRE(there[0].guards_hold() && there[1].guards_hold());
    std::vector<bool> moved(n, false);
    for (const int64_t row : rows)
        moved[size_t(row)] = true;
    for (size_t i = 0; i < n; ++i)
        REQUIRE(marks[i] == moved[i]);
    for (size_t i = 0; i < n; ++i)
        for (int k = 0; k < 2; ++k)
            for (size_t j = i * size_t(widths[k]); j < (i + 1) * size_t(widths[k]); ++j) {
                const float halved = flush(flush(tables[k][j]) / 2) + (adds ? 3.0f : 0.0f);
                const float wanted = !moved[i] ? 3.0f : k ? tables[k][j] : halved;
                REQUIRE(same(flush(there[size_t(k)][j]), flush(wanted)));
            }
    if (rows.empty())
        return;
    const int32_t bad = in.byte() % 2 ? -1 - int32_t(in.byte()) : int32_t(n + in.word() % 1000);
    const size_t at = in.byte() % rows.size();
    std::memcpy(packed.data() + at * across, &bad, sizeof bad);
    rows[at] = bad;
    REQUIRE(gs_pack_rows(from, 2, int64_t(n), rows.data(), packed.data(), count, 0) == GS_BAD_ARGUMENT);
    REQUIRE(gs_unpack_rows(to, 2, int64_t(n), packed.data(), nullptr, count, 0) == GS_BAD_ARGUMENT);
    REQUIRE(std::strlen(gs_last_error()) > 0 && there[0].guards_hold() && packed.guards_hold());
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    fuzz::use_isa(in.byte());
    Noise noise(in.word());
    const uint8_t few = in.byte();
    screen_gradients(few < 250 ? few : 8190 + (few - 250), in, noise); // about a chunk of the library
    powers(in.byte(), in, noise);
    const uint8_t some = in.byte();
    packing(some < 250 ? some : 4090 + 4 * (some - 250), in, noise); // about two chunks
    return 0;
}
