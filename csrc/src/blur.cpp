// Blur of a photo: both passes over the rows of a picture, and their adjoint.
// Weights beyond the picture are left out and the rest add up to 1: a pass adds, then divides by the sum of its weights,
// which depends on the place. As taps are even, its adjoint divides first and then adds the same taps.
#include "blur.h"

#include "buffer.h"
#include "parallel.h"
#include "thread_count.h"

#include <algorithm>

namespace gs {

namespace {

// A pass over a picture of this size.
struct Pass {
    const std::vector<BlurTap> &taps;
    int width, height;

    // Calls add(tap, begin, end) for the taps that are in the picture for columns from begin to end of row y.
    template <class Add> void for_taps(int y, Add add) const {
        for (const BlurTap &tap : taps) {
            const int begin = std::max(0, -tap.dx), end = std::min(width, width - tap.dx);
            if (0 <= y + tap.dy && y + tap.dy < height && begin < end)
                add(tap, begin, end);
        }
    }
    // Row y of the weighted sums.
    void add(int y, const float *in, float *row) const {
        std::fill(row, row + 3 * width, 0.0f);
        for_taps(y, [&](const BlurTap &tap, int begin, int end) {
            const float *const from = in + 3 * (size_t(y + tap.dy) * size_t(width) + size_t(begin + tap.dx));
            float *const to = row + 3 * begin;
            for (int i = 0; i < 3 * (end - begin); ++i)
                to[i] += tap.weight * from[i];
        });
    }
    // A row divided by the sums of its weights; `sums`: scratch of a row.
    void divide(int y, const float *row, float *out, float *sums) const {
        std::fill(sums, sums + width, 0.0f);
        for_taps(y, [&](const BlurTap &tap, int begin, int end) {
            for (int x = begin; x < end; ++x)
                sums[x] += tap.weight;
        });
        for (int x = 0; x < width; ++x)
            for (int c = 0; c < 3; ++c)
                out[3 * x + c] = row[3 * x + c] / sums[x];
    }
};

} // namespace

void blur_image(const gs_blur_args &a, float *out) {
    const int threads = threads_of(a.threads);
    const size_t row = 3 * size_t(a.width), floats = row * size_t(a.height);
    const auto taps = blur_taps(a.covariance);
    const Pass first = {taps[0], a.width, a.height}, second = {taps[1], a.width, a.height};
    Buffer<float> buffer, more, scratch;
    float *const between = buffer.ensure(floats), *const sums = scratch.ensure(size_t(a.width) * size_t(threads));
    const auto for_rows = [&](auto body) {
        parallel_for(size_t(a.height), threads,
                     [&](size_t y, int worker) { body(int(y), y * row, sums + size_t(worker) * size_t(a.width)); });
    };
    const auto forward = [&](const Pass &pass, const float *in, float *to) {
        for_rows([&](int y, size_t at, float *weights) {
            pass.add(y, in, to + at);
            pass.divide(y, to + at, to + at, weights);
        });
    };
    const auto backward = [&](const Pass &pass, const float *in, float *divided, float *to) {
        for_rows([&](int y, size_t at, float *weights) { pass.divide(y, in + at, divided + at, weights); });
        for_rows([&](int y, size_t at, float *) { pass.add(y, divided, to + at); });
    };
    if (a.adjoint) {
        backward(second, a.image, between, more.ensure(floats));
        backward(first, more.get(), between, out);
    } else {
        forward(first, a.image, between);
        forward(second, between, out);
    }
}

} // namespace gs
