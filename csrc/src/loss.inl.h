// Fused L1 + SSIM loss of one band of rows, and its gradient (Wang et al. 2004; zero padding as in 3DGS).
// Gaussian windows are separable: rows are filtered once into a ring of 11 and combined downwards. The gradient filters
// the derivatives once more, and follows the loss ten rows behind, from a second ring: nothing as large as the image is
// written but the gradient itself.
// SSIM is computed from d = x - y: with D = E[d] and V = Var(d),
//   SSIM = (1 - D^2 / (mx^2 + my^2 + C1)) (1 - V / (sx^2 + sy^2 + C2)),
// the usual formula rearranged. Its variances would cancel in bright flat regions; here the small quantities D and V are
// computed from small numbers. Values are also shifted by -0.5, which leaves variances unchanged.
#pragma once

#include "loss.h"
#include "simd.h"

namespace gs::GS_NAMESPACE {

constexpr int kReach = kWindow / 2;
constexpr float kShift = 0.5f;
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;

// Weights of the centre and of the taps 1..5 px away: exp(-d^2 / (2 * 1.5^2)), normalised to sum 1 over 11 taps.
constexpr float kTap[kReach + 1] = {0.26601172486179436f,  0.21300553771125370f, 0.10936068950970002f,
                                    0.036000773310661005f, 0.007598758135239183f, 0.0010283801057925797f};

// dst[i] = sum over k of tap[|k|] * src[i + k]; src is readable from -kReach to n + kReach + kLanes.
static inline void filter_row(const float *src, float *dst, int n) {
    for (int i = 0; i < n; i += kLanes) {
        Vec s = kTap[0] * load(src + i);
        for (int k = 1; k <= kReach; ++k)
            s = fma(set1(kTap[k]), load(src + i - k) + load(src + i + k), s);
        store(dst + i, s);
    }
}

// The same down the columns: rows[0..10] are the ring in order.
static inline Vec filter_column(const float *const *rows, int i) {
    Vec s = kTap[0] * load(rows[kReach] + i);
    for (int k = 1; k <= kReach; ++k)
        s = fma(set1(kTap[k]), load(rows[kReach - k] + i) + load(rows[kReach + k] + i), s);
    return s;
}

// x and y of one row and channel as they enter the loss, shifted; the margins hold the padding value.
static inline void read_row(const gs_loss_args &a, int row, int channel, float *x, float *y) {
    const size_t begin = size_t(row) * size_t(a.width);
    const float *image = a.image + 3 * begin + channel;
    const uint8_t *target = a.target + 3 * begin + channel;
    constexpr float kByte = 1.0f / 255.0f;
    const float background = a.background[channel];
    for (int i = 0; i < a.width; ++i) {
        x[i] = image[3 * i];
        y[i] = float(target[3 * i]) * kByte;
    }
    if (a.mask_mode != GS_MASK_NONE) {
        const uint8_t *mask = a.mask + begin;
        for (int i = 0; i < a.width; ++i) {
            const float m = float(mask[i]) * kByte;
            if (a.mask_mode == GS_MASK_COMPOSITE) {
                y[i] = y[i] * m + background * (1.0f - m);
            } else {
                x[i] *= m;
                y[i] *= m;
            }
        }
    }
    for (int i = 0; i < a.width; ++i) {
        x[i] -= kShift;
        y[i] -= kShift;
    }
}

static inline double lane_total(Vec v) {
    double sum = 0;
    for (int l = 0; l < kLanes; ++l)
        sum += double(v[l]);
    return sum;
}

static void image_loss(const LossArgs &a, int band, float *scratch) {
    const gs_loss_args &in = *a.args;
    const int w = in.width, h = in.height, stride = loss_stride(w);
    const int first = band * kLossBand, end = first + kLossBand < h ? first + kLossBand : h;
    const bool gradient = a.v_image != nullptr;
    constexpr int kMaps = 4;        // x, y, x^2 + y^2, d^2
    constexpr int kDerivatives = 3; // with respect to E[x], E[x^2 + y^2], E[d^2]
    static_assert(kLossRows == (2 + kMaps + kDerivatives) * kWindow + (kMaps - 2) + kDerivatives + 1);
    float *next_row = scratch + kLossMargin;
    const auto take_rows = [&](int count) {
        float *const p = next_row;
        next_row += size_t(count) * size_t(stride);
        return p;
    };
    // Rings of rows: what entered the loss, its filtered maps, filtered derivatives. Then single rows.
    float *const values[2] = {take_rows(kWindow), take_rows(kWindow)};
    float *const filtered = take_rows(kMaps * kWindow), *const filtered_back = take_rows(kDerivatives * kWindow);
    float *const squares = take_rows(1), *const distances = take_rows(1);
    float *derivatives[kDerivatives];
    for (float *&row : derivatives)
        row = take_rows(1);
    float *const out = take_rows(1);

    const auto fill = [](float *row, int begin, int stop, float value) {
        for (int i = begin; i < stop; ++i)
            row[i] = value;
    };
    // Everything beyond the picture's sides is padding, and stays so.
    for (int k = 0; k < kWindow; ++k)
        for (float *ring : values)
            fill(ring + size_t(k) * size_t(stride), -kLossMargin, stride - kLossMargin, -kShift);
    fill(squares, -kLossMargin, stride - kLossMargin, 2.0f * kShift * kShift);
    fill(distances, -kLossMargin, stride - kLossMargin, 0.0f);
    for (float *row : derivatives)
        fill(row, -kLossMargin, stride - kLossMargin, 0.0f);
    // Vectors that hang over the end of a row count only with the lanes inside.
    const int last = (w - 1) / kLanes * kLanes;
    const Mask last_lanes = gt(set1(float(w - last)), iota());
    const auto inside = [&](int i, Vec v) { return i < last ? v : keep(last_lanes, v); };
    const double n = 3.0 * double(w) * double(h);
    const float l1_weight = float((1.0 - double(in.ssim_weight)) / n), ssim_weight = float(double(in.ssim_weight) / n);
    // Rows that the first and the last row of the band need besides.
    const int reach = gradient ? 2 * kReach : kReach;
    double l1 = 0, ssim = 0, mse = 0;
    for (int channel = 0; channel < 3; ++channel)
        for (int row = first - reach; row < end + reach; ++row) {
            const auto ring_row = [&](float *ring, int r) {
                return ring + size_t((r - (first - reach)) % kWindow) * size_t(stride);
            };
            const auto in_order = [&](float *ring, int newest, const float *rows[kWindow]) {
                for (int j = 0; j < kWindow; ++j)
                    rows[j] = ring_row(ring, newest - (kWindow - 1) + j);
            };
            const auto map_ring = [&](int k) { return filtered + size_t(k * kWindow) * size_t(stride); };
            const auto back_ring = [&](int k) { return filtered_back + size_t(k * kWindow) * size_t(stride); };

            float *const x = ring_row(values[0], row), *const y = ring_row(values[1], row);
            if (row < 0 || row >= h) {
                fill(x, 0, w, -kShift);
                fill(y, 0, w, -kShift);
            } else {
                read_row(in, row, channel, x, y);
            }
            Vec row_l1 = {}, row_mse = {};
            for (int i = 0; i < w; i += kLanes) {
                const Vec vx = load(x + i), vy = load(y + i), d = vx - vy;
                const Vec d2 = d * d;
                store(squares + i, fma(vx, vx, vy * vy)); // beyond the side: of padding, which it remains
                store(distances + i, d2);
                row_l1 += inside(i, max(d, -d));
                row_mse += inside(i, d2);
            }
            if (row >= first && row < end) {
                l1 += lane_total(row_l1);
                mse += lane_total(row_mse);
            }
            const float *const maps[kMaps] = {x, y, squares, distances};
            for (int k = 0; k < kMaps; ++k)
                filter_row(maps[k], ring_row(map_ring(k), row), w);

            const int at = row - kReach;
            if (at < first - reach + kReach)
                continue;
            if (at < 0 || at >= h) {
                for (int k = 0; k < kDerivatives; ++k)
                    fill(ring_row(back_ring(k), at), 0, last + kLanes, 0.0f);
            } else {
                const float *window[kMaps][kWindow];
                for (int k = 0; k < kMaps; ++k)
                    in_order(map_ring(k), row, window[k]);
                Vec row_ssim = {};
                for (int i = 0; i < w; i += kLanes) {
                    const Vec mx = filter_column(window[0], i), my = filter_column(window[1], i);
                    const Vec diff = mx - my;
                    const Vec spread = filter_column(window[2], i) - fma(mx, mx, my * my);
                    const Vec v = max(fnma(diff, diff, filter_column(window[3], i)), Vec{});
                    const Vec ux = mx + kShift, uy = my + kShift;
                    const Vec inv_b1 = 1.0f / (fma(ux, ux, uy * uy) + kC1);
                    const Vec inv_b2 = 1.0f / (max(spread, Vec{}) + kC2);
                    const Vec v_share = v * inv_b2, diff_share = diff * diff * inv_b1;
                    const Vec luminance = 1.0f - diff_share, contrast = 1.0f - v_share;
                    row_ssim += inside(i, luminance * contrast);
                    if (!gradient)
                        continue;
                    const Vec v_sum = luminance * v_share * inv_b2; // with respect to E[x^2 + y^2]
                    const Vec v_mean = 2.0f * (contrast * inv_b1 * (ux * diff_share - diff) +
                                               luminance * inv_b2 * diff - v_sum * mx);
                    store(derivatives[0] + i, inside(i, v_mean));
                    store(derivatives[1] + i, inside(i, v_sum));
                    store(derivatives[2] + i, inside(i, -luminance * inv_b2));
                }
                if (at >= first && at < end)
                    ssim += lane_total(row_ssim);
                if (gradient)
                    for (int k = 0; k < kDerivatives; ++k)
                        filter_row(derivatives[k], ring_row(back_ring(k), at), w);
            }

            const int target = at - kReach;
            if (!gradient || target < first)
                continue;
            const float *window[kDerivatives][kWindow];
            for (int k = 0; k < kDerivatives; ++k)
                in_order(back_ring(k), at, window[k]);
            const float *const x_there = ring_row(values[0], target), *const y_there = ring_row(values[1], target);
            for (int i = 0; i < w; i += kLanes) {
                const Vec vx = load(x_there + i), vy = load(y_there + i);
                const Vec g = filter_column(window[0], i) + 2.0f * (vx * filter_column(window[1], i) +
                                                                    (vx - vy) * filter_column(window[2], i));
                const Vec sign = keep(gt(vx, vy), set1(l1_weight)) - keep(gt(vy, vx), set1(l1_weight));
                store(out + i, fnma(set1(ssim_weight), g, sign));
            }
            const size_t begin = size_t(target) * size_t(w);
            float *v = a.v_image + 3 * begin + channel;
            if (in.mask_mode == GS_MASK_IGNORE)
                for (int i = 0; i < w; ++i)
                    v[3 * i] = out[i] * (float(in.mask[begin + size_t(i)]) * (1.0f / 255.0f));
            else
                for (int i = 0; i < w; ++i)
                    v[3 * i] = out[i];
        }
    a.partial[3 * band] = l1;
    a.partial[3 * band + 1] = ssim;
    a.partial[3 * band + 2] = mse;
}

} // namespace gs::GS_NAMESPACE
