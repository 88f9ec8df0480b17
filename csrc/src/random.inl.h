// Counter-based random numbers of one block of rows: Philox 4x32-10 (Salmon et al. 2011), and the normal distribution
// by float operations that a shader repeats; plain loops that the compiler vectorises, without a contracted product.
#pragma once

#include "../shared/constants.h"
#include "random.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace gs::GS_NAMESPACE {

static constexpr float kAtanh[] = {GS_ATANH}, kSin[] = {GS_SIN}, kCos[] = {GS_COS};
static constexpr float kUlp = 0x1p-24f; // step of uniform numbers

// One round of all rows of a block (Salmon et al. 2011, section 3.3).
static void mix(RandomWords &words, int64_t count, uint32_t key0, uint32_t key1) {
    auto &[w0, w1, w2, w3] = words.w;
    for (int64_t i = 0; i < count; ++i) {
        const uint64_t a = uint64_t(GS_PHILOX_M0) * w0[i], b = uint64_t(GS_PHILOX_M1) * w2[i];
        w0[i] = uint32_t(b >> 32) ^ w1[i] ^ key0;
        w1[i] = uint32_t(b);
        w2[i] = uint32_t(a >> 32) ^ w3[i] ^ key1;
        w3[i] = uint32_t(a);
    }
}

static void encrypt(RandomWords &words, int64_t count, uint32_t key0, uint32_t key1) {
    for (int round = 0; round < GS_PHILOX_ROUNDS; ++round) {
        mix(words, count, key0, key1);
        key0 += GS_PHILOX_W0;
        key1 += GS_PHILOX_W1;
    }
}

// sqrt(-2 ln u): u = m 2^e with m in [sqrt(1/2), sqrt(2)), and ln m = 2 atanh s by its series, s = (m - 1) / (m + 1).
static float radius(uint32_t word) {
    const uint32_t bits = std::bit_cast<uint32_t>(float(int32_t((word >> 8) + 1)));
    const uint32_t above = bits - 0x3f3504f3u; // bits of sqrt(1/2)
    const float e = float(int32_t(above) >> 23), m = std::bit_cast<float>((above & 0x7fffffu) + 0x3f3504f3u);
    const float s = (m - 1.0f) / (m + 1.0f), t = s * s;
    const float series = ((kAtanh[0] * t + kAtanh[1]) * t + kAtanh[2]) * t + kAtanh[3];
    const float log = (e - 24.0f) * GS_LN2 + (2.0f * s + s * t * series);
    return std::sqrt(std::max(-2.0f * log, 0.0f));
}

// cos and sin of pi / 2 f by their series, and the quadrant's turn.
static void turn(uint32_t word, float &x, float &y) {
    const float f = float(int32_t((word >> 6) & 0xffffffu) - 0x800000) * kUlp, t = f * f;
    const float s = f * ((((kSin[0] * t + kSin[1]) * t + kSin[2]) * t + kSin[3]) * t + kSin[4]);
    const float c = (((kCos[0] * t + kCos[1]) * t + kCos[2]) * t + kCos[3]) * t + kCos[4];
    const bool odd = word & 0x40000000u, back = word & 0x80000000u;
    const float u = odd ? -s : c, v = odd ? c : s;
    x = back ? -u : u;
    y = back ? -v : v;
}

static void to_uniform(const RandomWords &words, int64_t count, float *out) {
    for (int64_t i = 0; i < count; ++i)
        out[i] = float(int32_t(words.w[0][i] >> 8)) * kUlp;
}

static void to_normal(const RandomWords &words, int64_t count, float *out) {
    float r[2][kRandomBlock], x[2][kRandomBlock], y[2][kRandomBlock];
    for (int pair = 0; pair < 2; ++pair)
        for (int64_t i = 0; i < count; ++i) {
            r[pair][i] = radius(words.w[2 * pair][i]);
            turn(words.w[2 * pair + 1][i], x[pair][i], y[pair][i]);
        }
    for (int64_t i = 0; i < count; ++i) {
        float *row = out + 3 * i;
        row[0] = r[0][i] * x[0][i];
        row[1] = r[0][i] * y[0][i];
        row[2] = r[1][i] * x[1][i];
    }
}

} // namespace gs::GS_NAMESPACE
