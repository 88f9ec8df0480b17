// Tests of matching in the C interface without Python, for sanitizers and other machines: each instruction set against
// all distances one by one, and refusals.
#include "check.h"

#include <algorithm>
#include <cmath>

namespace {

using Values = std::vector<uint8_t>;
constexpr size_t kSize = GS_DESCRIPTOR_SIZE;

gs_descriptors view(const Values &values) { return {int32_t(values.size() / kSize), values.data()}; }

// Few distinct values, so that distances repeat.
Values random_values(uint32_t seed, size_t count, uint32_t largest) {
    Values values(count * kSize);
    for (uint8_t &value : values) {
        seed = seed * 1664525u + 1013904223u;
        value = uint8_t((seed >> 8) % (largest + 1));
    }
    return values;
}

int64_t squared_distance(const Values &a, size_t i, const Values &b, size_t j) {
    int64_t sum = 0;
    for (size_t k = 0; k < kSize; ++k) {
        const int64_t difference = int64_t(a[i * kSize + k]) - b[j * kSize + k];
        sum += difference * difference;
    }
    return sum;
}

int32_t nearest(const Values &a, size_t i, const Values &b, double most, double ratio) {
    int64_t best = INT64_MAX, second = INT64_MAX;
    int32_t found = -1;
    for (size_t j = 0; j < b.size() / kSize; ++j) {
        const int64_t d = squared_distance(a, i, b, j);
        if (d < best)
            second = best, best = d, found = int32_t(j);
        else if (d < second)
            second = d;
    }
    const bool distinct = second == INT64_MAX || double(best) < ratio * ratio * double(second);
    return found >= 0 && double(best) <= most * most && distinct ? found : -1;
}

void all_distances_say_the_same() {
    int32_t matched = 0;
    for (const size_t rows : {0u, 1u, 5u, 6u, 7u, 50u})
        for (const size_t columns : {0u, 1u, 31u, 32u, 33u, 70u})
            for (const uint32_t largest : {0u, 1u, 255u}) {
                Values first = random_values(7, rows, largest), second = random_values(9, columns, largest);
                for (size_t i = 0; i < std::min(rows, columns) / 2; ++i) // some matches, far apart
                    std::copy_n(&first[i * kSize], kSize, &second[(columns - 1 - i) * kSize]);
                const gs_descriptors a = view(first), b = view(second);
                std::vector<int32_t> found(rows, -7);
                CHECK(gs_match_descriptors(&a, &b, 900.0, 0.9, found.data()) == GS_OK);
                for (size_t i = 0; i < rows; ++i) {
                    const int32_t there = nearest(first, i, second, 900.0, 0.9);
                    const bool both = there >= 0 && nearest(second, size_t(there), first, 900.0, 0.9) == int32_t(i);
                    CHECK(found[i] == (both ? there : -1));
                    matched += both;
                }
            }
    CHECK(matched > 100);
}

void what_is_no_descriptor_is_refused() {
    const Values values(2 * kSize);
    const gs_descriptors good = view(values), none = {};
    std::vector<int32_t> out(2);
    const auto refused = [&](const gs_descriptors *a, const gs_descriptors *b, double most, double ratio, int32_t *to) {
        CHECK(gs_match_descriptors(a, b, most, ratio, to) == GS_BAD_ARGUMENT);
        CHECK(std::strlen(gs_last_error()) > 0);
    };
    refused(nullptr, &good, 1, 1, out.data());
    refused(&good, nullptr, 1, 1, out.data());
    refused(&good, &good, 1, 1, nullptr);
    for (const double bad : {-1.0, std::nan("")}) {
        refused(&good, &good, bad, 1, out.data());
        refused(&good, &good, 1, bad, out.data());
    }
    refused(&good, &good, 1, 1.01, out.data());
    for (const gs_descriptors bad : {gs_descriptors{-1, values.data()}, gs_descriptors{2, nullptr},
                                     gs_descriptors{GS_DESCRIPTORS_MAX + 1, values.data()}}) {
        refused(&bad, &good, 1, 1, out.data());
        refused(&good, &bad, 1, 1, out.data());
    }
    CHECK(gs_match_descriptors(&none, &none, 1, 1, nullptr) == GS_OK);
}

} // namespace

int main() {
    return on_every_isa([] {
        all_distances_say_the_same();
        what_is_no_descriptor_is_refused();
    });
}
