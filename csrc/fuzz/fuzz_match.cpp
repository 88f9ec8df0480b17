// Matching of any descriptors: every row and nothing beyond is written, and matches are mutual and within the limits.
#include "bytes.h"
#include "gscore.h"

#include <cmath>

using fuzz::Bytes;
using fuzz::Noise;

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Bytes in(data, size);
    Noise noise(in.word());
    const int32_t counts[2] = {in.byte() % 80, in.byte() % 80};
    const float largest = in.byte() % 2 ? 255.99f : 2.0f;
    std::vector<uint8_t> values[2];
    for (int k = 0; k < 2; ++k) {
        values[k].resize(size_t(counts[k]) * GS_DESCRIPTOR_SIZE);
        for (uint8_t &value : values[k])
            value = uint8_t(noise(0, largest));
    }
    for (int k = in.byte(); k > 0 && counts[0] && counts[1]; --k) // numbers of the fuzzer's own, on both sides
        for (std::vector<uint8_t> &side : values)
            side[in.word() % side.size()] = in.byte();
    const bool hostile = in.byte() % 8 == 0;
    const double most = hostile ? double(in.hostile()) : 40.0 * in.byte(), ratio = hostile ? double(in.hostile()) : 0.9;
    const gs_descriptors first = {counts[0], values[0].data()}, second = {counts[1], values[1].data()};
    std::vector<int32_t> matches(size_t(counts[0]) + 2, -777);
    const gs_status status = gs_match_descriptors(&first, &second, most, ratio, matches.data() + 1);
    const bool wrong = !(most >= 0) || !(ratio >= 0 && ratio <= 1);
    REQUIRE(status == (wrong ? GS_BAD_ARGUMENT : GS_OK));
    REQUIRE(matches.front() == -777 && matches.back() == -777);
    std::vector<bool> taken(values[1].size() / GS_DESCRIPTOR_SIZE);
    for (int32_t i = 0; status == GS_OK && i < counts[0]; ++i) {
        const int32_t j = matches[size_t(i) + 1];
        REQUIRE(j >= -1 && j < counts[1]);
        if (j < 0)
            continue;
        REQUIRE(!taken[size_t(j)]);
        taken[size_t(j)] = true;
        double squared = 0;
        for (int k = 0; k < GS_DESCRIPTOR_SIZE; ++k) {
            const double d = double(values[0][size_t(i) * GS_DESCRIPTOR_SIZE + size_t(k)]) -
                             double(values[1][size_t(j) * GS_DESCRIPTOR_SIZE + size_t(k)]);
            squared += d * d;
        }
        REQUIRE(std::sqrt(squared) <= most * (1 + 1e-12));
    }
    return 0;
}
