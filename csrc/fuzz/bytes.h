// Bytes of a fuzzer as numbers, and output arrays with guard words.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <vector>

// Aborts, so that the fuzzer keeps the input; also in builds without assertions.
#define REQUIRE(condition)                                                                                             \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);                                       \
            std::abort();                                                                                              \
        }                                                                                                              \
    } while (0)

namespace fuzz {

class Bytes {
  public:
    Bytes(const uint8_t *data, size_t size) : data_(data), left_(size) {}

    bool empty() const { return left_ == 0; }

    // Zeros after the end.
    uint8_t byte() {
        if (!left_)
            return 0;
        --left_;
        return *data_++;
    }

    uint32_t word() {
        uint32_t w = 0;
        for (int i = 0; i < 4; ++i)
            w |= uint32_t(byte()) << (8 * i);
        return w;
    }

    // A number from a table of hostile ones, with random bits, or around zero.
    float hostile() {
        using L = std::numeric_limits<float>;
        static const float table[] = {0.0f,           -0.0f,      1.0f,      -1.0f,    L::quiet_NaN(),  L::infinity(),
                                      -L::infinity(), L::max(),   -L::max(), L::min(), L::denorm_min(), 1e-40f,
                                      1e-20f,         1e-8f,      1e8f,      -1e8f,    1e20f,           -1e20f,
                                      16.0f,          1.0f / 255, 0.01f,     88.0f,    -88.0f,          104.0f,
                                      -104.0f,        40.0f,      -40.0f,    1e30f};
        const uint8_t kind = byte();
        if (kind < 128)
            return table[kind % (sizeof table / sizeof table[0])];
        if (kind < 192) {
            const uint32_t bits = word();
            float value;
            std::memcpy(&value, &bits, sizeof value);
            return value;
        }
        return (float(byte()) - 128) / 16;
    }

  private:
    const uint8_t *data_;
    size_t left_;
};

// Uniform numbers that depend only on a seed; the standard library's distributions differ between machines.
class Noise {
  public:
    explicit Noise(uint32_t seed) : state_(seed * 2654435761u + 12345u) {}
    float operator()(float low, float high) {
        state_ = state_ * 1664525u + 1013904223u;
        return low + (high - low) * float(state_ >> 8) / float(1 << 24);
    }

  private:
    uint32_t state_;
};

// An output array between guard words, filled with a NaN that no arithmetic produces.
class Output {
  public:
    explicit Output(size_t size) : words_(size + 2 * kGuard, kUntouched) {}
    float *data() { return reinterpret_cast<float *>(words_.data() + kGuard); }
    size_t size() const { return words_.size() - 2 * kGuard; }
    float operator[](size_t i) const {
        float v;
        std::memcpy(&v, &words_[kGuard + i], sizeof v);
        return v;
    }
    bool written(size_t i) const { return words_[kGuard + i] != kUntouched; }
    bool all_written() const {
        for (size_t i = 0; i < size(); ++i)
            if (!written(i))
                return false;
        return true;
    }
    bool guards_hold() const {
        for (size_t i = 0; i < kGuard; ++i)
            if (words_[i] != kUntouched || words_[words_.size() - 1 - i] != kUntouched)
                return false;
        return true;
    }
    bool same_bits(const Output &other) const { return words_ == other.words_; }

  private:
    static constexpr size_t kGuard = 16;
    static constexpr uint32_t kUntouched = 0x7fedcba9u;
    std::vector<uint32_t> words_;
};

} // namespace fuzz
