// Lazy Adam kernel (Kingma and Ba 2015): rows skip steps without gradient and catch up later.
//
// A row without gradient for k steps after step t moves, at its j-th step, by
//   lr sqrt(1 - beta2^(t+j)) / (1 - beta1^(t+j)) (beta1 / sqrt(beta2))^j m / (sqrt(v) + eps),
// with m and v of step t: the sum over j is m / (sqrt(v) + eps) times a factor common to all rows of a tensor,
// tabulated by k. Only eps, which should shrink with the bias correction and grow with j, is approximated. eps is
// 1e-15, far below the roots of second moments: 1 / (sqrt(v) + eps) is computed as 1 / sqrt(v + eps^2), which differs
// only for gradients that small, and needs neither a division nor a root.
#pragma once

#include "adam.h"
#include "raster_types.h"
#include "simd.h"

#include <cmath>

namespace gs::GS_NAMESPACE {

// The first n < kLanes floats, zeros behind.
static inline Vec load_part(const float *p, int n) {
#if defined(GS_ISA_AVX512)
    return _mm512_maskz_loadu_ps(__mmask16((1u << n) - 1), p);
#else
    Vec v = {};
    for (int i = 0; i < n; ++i)
        v[i] = p[i];
    return v;
#endif
}

static inline void store_part(float *p, Vec v, int n) {
#if defined(GS_ISA_AVX512)
    _mm512_mask_storeu_ps(p, __mmask16((1u << n) - 1), v);
#else
    for (int i = 0; i < n; ++i)
        p[i] = v[i];
#endif
}

// 1 / sqrt(x) for normal positive x, relative error below 3e-7.
static inline Vec inverse_root(Vec x) {
#if defined(GS_ISA_AVX512)
    const Vec y = _mm512_rsqrt14_ps(x);
#elif defined(GS_ISA_AVX2)
    const Vec y = _mm256_rsqrt_ps(x);
#endif
#if defined(GS_ISA_AVX512) || defined(GS_ISA_AVX2)
    const Vec half = 0.5f * y; // one step of Newton: y (3 - x y^2) / 2
    return fma(half, fnma(x * y, y, set1(1.0f)), y);
#else
    return 1.0f / sqrt(x);
#endif
}

struct Move {
    Vec param, moment1, moment2;
};

// Calls body(i, n) for the vectors of `size` floats; the last one may have n < kLanes floats.
template <class Body> static inline void vectors(int64_t size, Body body) {
    int64_t i = 0;
    for (; i + kLanes <= size; i += kLanes)
        body(i, kLanes);
    if (i < size)
        body(i, int(size - i));
}

template <class Body> static inline void update(const gs_adam_tensor &t, int64_t begin, int64_t size, Body body) {
    float *const param = t.param + begin, *const m = t.moment1 + begin, *const v = t.moment2 + begin;
    vectors(size, [&](int64_t i, int n) {
        if (n == kLanes) {
            Move x = {load(param + i), load(m + i), load(v + i)};
            body(x, i, n);
            store(param + i, x.param);
            store(m + i, x.moment1);
            store(v + i, x.moment2);
        } else {
            Move x = {load_part(param + i, n), load_part(m + i, n), load_part(v + i, n)};
            body(x, i, n);
            store_part(param + i, x.param, n);
            store_part(m + i, x.moment1, n);
            store_part(v + i, x.moment2, n);
        }
    });
}

static inline Vec caught_up(const AdamTensor &a, const Move &x, int pending) {
    return x.param - a.factors[pending] * (x.moment1 * inverse_root(x.moment2 + a.eps2));
}

static inline void catch_up(const AdamTensor &a, Move &x, int pending) {
    x.param = caught_up(a, x, pending);
    x.moment1 *= a.decay1[pending];
    x.moment2 *= a.decay2[pending];
}

static inline void adam(const AdamTensor &a, Move &x, Vec g) {
    g = min(max(g, set1(-kGradientMax)), set1(kGradientMax));
    x.moment1 = fma(set1(a.beta1), x.moment1, a.gain1 * g);
    x.moment2 = fma(set1(a.beta2), x.moment2, a.gain2 * (g * g));
    x.param = fnma(a.rate * x.moment1, inverse_root(x.moment2 + a.eps2), x.param);
}

// NaN in some lane where a value is not finite, else zero.
static inline Vec poison(const float *p, int64_t size) {
    Vec sum = {};
    vectors(size, [&](int64_t i, int n) { sum += (n == kLanes ? load(p + i) : load_part(p + i, n)) * 0.0f; });
    return sum;
}

static inline bool finite(Vec poison) { return bits(ge(poison, Vec{})) == (1ull << kLanes) - 1; }

static inline bool finite(const float *p, int64_t size) { return finite(poison(p, size)); }

static inline void zero_row(const AdamArgs &a, int64_t row) {
    for (int i = 0; i < a.count; ++i) {
        const gs_adam_tensor &t = a.tensors[i].t;
        std::memset(t.grad + row * t.width, 0, size_t(t.width) * sizeof(float));
    }
}

// Zeroes the gradients of rows with a value that is not finite; returns their number.
static int64_t zero_bad_rows(const AdamArgs &a, int64_t begin, int64_t end) {
    Vec sum = {};
    for (int i = 0; i < a.count; ++i) {
        const gs_adam_tensor &t = a.tensors[i].t;
        if (t.mode == GS_ADAM_ALL)
            sum += poison(t.grad + begin * t.width, (end - begin) * t.width);
    }
    if (finite(sum))
        return 0;
    int64_t bad = 0;
    for (int64_t row = begin; row < end; ++row)
        for (int i = 0; i < a.count; ++i) {
            const gs_adam_tensor &t = a.tensors[i].t;
            if (t.mode != GS_ADAM_ALL || finite(t.grad + row * t.width, t.width))
                continue;
            zero_row(a, row);
            ++bad;
            break;
        }
    return bad;
}

// Rows processed at a time, so that data read twice is still in the L1 cache.
constexpr int64_t kRows = 64;

// Steps rows [begin, end), all with `pending` pending steps; their gradients become zero.
static int64_t move_rows(const AdamTensor &a, int64_t begin, int64_t end, int pending) {
    const gs_adam_tensor &t = a.t;
    const int64_t first = begin * t.width, size = (end - begin) * t.width;
    float *const grad = t.grad + first;
    int64_t bad = 0;
    if (!finite(grad, size))
        for (int64_t row = begin; row < end; ++row)
            if (!finite(t.grad + row * t.width, t.width)) {
                std::memset(t.grad + row * t.width, 0, size_t(t.width) * sizeof(float));
                ++bad;
            }
    update(t, first, size, [&](Move &x, int64_t i, int n) {
        if (pending)
            catch_up(a, x, pending);
        adam(a, x, n == kLanes ? load(grad + i) : load_part(grad + i, n));
    });
    std::memset(grad, 0, size_t(size) * sizeof(float));
    std::memset(t.visible + begin, 0, size_t(end - begin));
    std::memset(t.pending + begin, 0, size_t(end - begin));
    return bad;
}

static int64_t move_visible_rows(const AdamTensor &a, int64_t begin, int64_t end) {
    const gs_adam_tensor &t = a.t;
    const auto moves = [&](int64_t row) { return t.visible[row] || t.pending[row] == kMaxPending; };
    int64_t bad = 0;
    for (int64_t row = begin; row < end;) {
        if (!moves(row)) {
            ++t.pending[row++];
            continue;
        }
        const int pending = t.pending[row];
        int64_t last = row + 1;
        while (last < end && moves(last) && t.pending[last] == pending)
            ++last;
        bad += move_rows(a, row, last, pending);
        row = last;
    }
    return bad;
}

static int64_t adam_step(const AdamArgs &a, int64_t chunk) {
    const int64_t chunk_end = chunk * kChunk + kChunk < a.rows ? chunk * kChunk + kChunk : a.rows;
    int64_t bad = 0;
    for (int64_t begin = chunk * kChunk; begin < chunk_end; begin += kRows) {
        const int64_t end = begin + kRows < chunk_end ? begin + kRows : chunk_end;
        bad += zero_bad_rows(a, begin, end);
        for (int i = 0; i < a.count; ++i) {
            const AdamTensor &tensor = a.tensors[i];
            const gs_adam_tensor &t = tensor.t;
            if (t.mode == GS_ADAM_ALL) {
                const float *const grad = t.grad + begin * t.width;
                update(t, begin * t.width, (end - begin) * t.width, [&](Move &x, int64_t at, int n) {
                    adam(tensor, x, n == kLanes ? load(grad + at) : load_part(grad + at, n));
                });
                continue;
            }
            for (int64_t row = begin; row < end; ++row)
                t.visible[row] |= uint8_t(!a.radii || a.radii[row] > 0);
            if (t.mode == GS_ADAM_VISIBLE)
                bad += move_visible_rows(tensor, begin, end);
        }
    }
    return bad;
}

// Conservative mask of the splats [begin, begin + kLanes) that may be visible, a superset of those that `project`
// draws. The rows of the Jacobian have a norm of at most f / z sqrt(1 + ratio^2), so the largest scale bounds the
// splat on screen: alpha falls to 1/255 at sqrt(2 ln 255) deviations, farther out if an activated opacity exceeds 1.
static inline uint32_t may_be_visible(const CatchUpArgs &a, int64_t begin, int lanes) {
    const gs_splats &in = *a.splats;
    const gs_view &c = *a.view;
    Vec mean[3], largest = set1(-3e38f);
    alignas(64) float columns[7][kLanes] = {};
    for (int l = 0; l < lanes; ++l) {
        for (int k = 0; k < 3; ++k) {
            columns[k][l] = in.means[3 * (begin + l) + k];
            const float scale = in.scales[3 * (begin + l) + k];
            columns[3 + k][l] = in.raw ? scale : std::fabs(scale); // a negative one draws like a positive one
        }
        columns[6][l] = in.raw ? 1.0f : in.opacities[begin + l];
    }
    for (int k = 0; k < 3; ++k) {
        mean[k] = load(columns[k]);
        largest = max(largest, load(columns[3 + k]));
    }
    if (in.raw)
        largest = exp(largest);
    const Vec above_one = log2(max(load(columns[6]), set1(1.0f)));
    const Vec deviations = 1.004f * sqrt((above_one - GS_LOG2_ALPHA_MIN) * (1.0f / GS_HALF_LOG2E));
    const float *w = c.viewmat;
    Vec cam[3];
    for (int i = 0; i < 3; ++i)
        cam[i] = fma(set1(w[4 * i]), mean[0],
                     fma(set1(w[4 * i + 1]), mean[1], fma(set1(w[4 * i + 2]), mean[2], set1(w[4 * i + 3]))));
    const Vec inverse_z = 1.0f / cam[2];
    uint32_t inside = bits(both(gt(cam[2], set1(c.near_plane)), ge(set1(c.far_plane), cam[2])));
    const float focal[2] = {c.fx, c.fy}, center[2] = {c.cx, c.cy}, side[2] = {float(c.width), float(c.height)};
    for (int i = 0; i < 2; ++i) {
        const float edge = (1.0f + GS_JACOBIAN_MARGIN) * (std::fabs(center[i]) + side[i]) / focal[i];
        const Vec deviation = (std::sqrt(1.0f + edge * edge) * focal[i]) * largest * inverse_z;
        const Vec reach = deviations * sqrt(fma(deviation, deviation, set1(c.eps2d))) + 1.0f;
        const Vec at = fma(set1(focal[i]), cam[i] * inverse_z, set1(center[i]));
        // Inverted comparisons, so that NaN counts as visible.
        inside &= ~(bits(gt(Vec{}, at + reach)) | bits(gt(at - reach, set1(side[i]))));
    }
    return inside & ((1u << lanes) - 1);
}

static void adam_catch_up(const CatchUpArgs &a, int64_t chunk) {
    const AdamTensor &tensor = *a.tensor;
    const gs_adam_tensor &t = tensor.t;
    const int64_t rows = a.splats->count;
    const int64_t begin = chunk * kChunk, end = begin + kChunk < rows ? begin + kChunk : rows;
    for (int64_t first = begin; first < end; first += kLanes) {
        const int lanes = end - first < kLanes ? int(end - first) : kLanes;
        uint32_t late = 0;
        for (int l = 0; l < lanes; ++l)
            late |= uint32_t(t.pending[first + l] != 0) << l;
        if (late && a.view)
            late &= may_be_visible(a, first, lanes);
        for (int l = 0; l < lanes; ++l) {
            const int64_t row = first + l, at = row * t.width;
            const int pending = t.pending[row];
            if (a.out) {
                vectors(t.width, [&](int64_t i, int n) {
                    const Move x = {load_part(t.param + at + i, n), load_part(t.moment1 + at + i, n),
                                    load_part(t.moment2 + at + i, n)};
                    store_part(a.out + at + i, late >> l & 1 ? caught_up(tensor, x, pending) : x.param, n);
                });
            } else if (late >> l & 1) {
                update(t, at, t.width, [&](Move &x, int64_t, int) { catch_up(tensor, x, pending); });
                t.pending[row] = 0;
            }
        }
    }
}

} // namespace gs::GS_NAMESPACE
