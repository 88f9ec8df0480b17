// Fused L1 + SSIM loss of one band of rows, and its gradient (Wang et al. 2004; zero padding as in 3DGS).
// Gaussian windows are separable: rows are filtered once into a ring of 11 and combined downwards.
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

static void loss_forward(const LossArgs &a, int band, float *scratch) {
    const gs_loss_args &in = *a.args;
    const int w = in.width, h = in.height, stride = loss_stride(w);
    const int first = band * kLossBand, end = first + kLossBand < h ? first + kLossBand : h;
    constexpr int kMaps = 4;
    float *rows[kMaps]; // x, y, x^2 + y^2, d^2 with margins
    for (int k = 0; k < kMaps; ++k)
        rows[k] = scratch + size_t(k) * size_t(stride) + kLossMargin;
    float *ring = scratch + size_t(kMaps) * size_t(stride);
    const float pad[kMaps] = {-kShift, -kShift, 2.0f * kShift * kShift, 0.0f};
    const auto fill = [&](int k, int begin, int stop) {
        for (int i = begin; i < stop; ++i)
            rows[k][i] = pad[k];
    };
    for (int k = 0; k < kMaps; ++k)
        fill(k, -kLossMargin, stride - kLossMargin);
    // Vectors that hang over the end of a row count only with the lanes inside.
    const int last = (w - 1) / kLanes * kLanes;
    const Mask last_lanes = gt(set1(float(w - last)), iota());
    const auto inside = [&](int i, Vec v) { return i < last ? v : keep(last_lanes, v); };
    double l1 = 0, ssim = 0, mse = 0;
    for (int channel = 0; channel < 3; ++channel) {
        for (int row = first - kReach; row < end + kReach; ++row) {
            if (row < 0 || row >= h) {
                for (int k = 0; k < kMaps; ++k)
                    fill(k, 0, w);
            } else {
                read_row(in, row, channel, rows[0], rows[1]);
                Vec row_l1 = {}, row_mse = {};
                for (int i = 0; i < w; i += kLanes) {
                    const Vec x = load(rows[0] + i), y = load(rows[1] + i), d = x - y;
                    const Vec d2 = d * d;
                    store(rows[2] + i, fma(x, x, y * y));
                    store(rows[3] + i, d2);
                    row_l1 += inside(i, max(d, -d));
                    row_mse += inside(i, d2);
                }
                for (int k = 2; k < kMaps; ++k)
                    fill(k, w, last + kLanes);
                if (row >= first && row < end) {
                    l1 += lane_total(row_l1);
                    mse += lane_total(row_mse);
                }
            }
            const int slot = (row - (first - kReach)) % kWindow;
            for (int k = 0; k < kMaps; ++k)
                filter_row(rows[k], ring + size_t(k * kWindow + slot) * size_t(stride), w);
            const int y = row - kReach;
            if (y < first)
                continue;
            const float *in_order[kMaps][kWindow];
            for (int k = 0; k < kMaps; ++k)
                for (int j = 0; j < kWindow; ++j)
                    in_order[k][j] = ring + size_t(k * kWindow + (slot + 1 + j) % kWindow) * size_t(stride);
            float *planes = a.planes + (size_t(channel) * size_t(h) + size_t(y)) * size_t(stride);
            const size_t plane = 3 * size_t(h) * size_t(stride);
            Vec row_ssim = {};
            for (int i = 0; i < w; i += kLanes) {
                const Vec mx = filter_column(in_order[0], i), my = filter_column(in_order[1], i);
                const Vec diff = mx - my;
                const Vec spread = filter_column(in_order[2], i) - fma(mx, mx, my * my);
                const Vec v = max(fnma(diff, diff, filter_column(in_order[3], i)), Vec{});
                const Vec ux = mx + kShift, uy = my + kShift;
                const Vec inv_b1 = 1.0f / (fma(ux, ux, uy * uy) + kC1);
                const Vec inv_b2 = 1.0f / (max(spread, Vec{}) + kC2);
                const Vec v_share = v * inv_b2, diff_share = diff * diff * inv_b1;
                const Vec luminance = 1.0f - diff_share, contrast = 1.0f - v_share;
                row_ssim += inside(i, luminance * contrast);
                if (!a.v_image)
                    continue;
                const Vec v_sum = luminance * v_share * inv_b2; // with respect to E[x^2 + y^2]
                store(planes + i, 2.0f * (contrast * inv_b1 * (ux * diff_share - diff) +
                                          luminance * inv_b2 * diff - v_sum * mx));
                store(planes + plane + i, v_sum);
                store(planes + 2 * plane + i, -luminance * inv_b2);
            }
            ssim += lane_total(row_ssim);
        }
    }
    a.partial[3 * band] = l1;
    a.partial[3 * band + 1] = ssim;
    a.partial[3 * band + 2] = mse;
}

static void loss_backward(const LossArgs &a, int band, float *scratch) {
    const gs_loss_args &in = *a.args;
    const int w = in.width, h = in.height, stride = loss_stride(w);
    const int first = band * kLossBand, end = first + kLossBand < h ? first + kLossBand : h;
    constexpr int kMaps = 3;
    float *x = scratch + kLossMargin, *y = x + stride, *padded = y + stride, *out = padded + stride;
    float *ring = scratch + 4 * size_t(stride);
    std::memset(scratch, 0, 4 * size_t(stride) * sizeof(float));
    const double n = 3.0 * double(w) * double(h);
    const float l1_weight = float((1.0 - double(in.ssim_weight)) / n), ssim_weight = float(double(in.ssim_weight) / n);
    const size_t plane = 3 * size_t(h) * size_t(stride);
    for (int channel = 0; channel < 3; ++channel)
        for (int row = first - kReach; row < end + kReach; ++row) {
            const int slot = (row - (first - kReach)) % kWindow;
            for (int k = 0; k < kMaps; ++k) {
                float *filtered = ring + size_t(k * kWindow + slot) * size_t(stride);
                if (row < 0 || row >= h) {
                    std::memset(filtered, 0, size_t(stride) * sizeof(float));
                    continue;
                }
                const float *map = a.planes + size_t(k) * plane + (size_t(channel) * size_t(h) + size_t(row)) * size_t(stride);
                std::memcpy(padded, map, size_t(w) * sizeof(float));
                filter_row(padded, filtered, w);
            }
            const int at = row - kReach;
            if (at < first)
                continue;
            const float *in_order[kMaps][kWindow];
            for (int k = 0; k < kMaps; ++k)
                for (int j = 0; j < kWindow; ++j)
                    in_order[k][j] = ring + size_t(k * kWindow + (slot + 1 + j) % kWindow) * size_t(stride);
            read_row(in, at, channel, x, y);
            for (int i = 0; i < w; i += kLanes) {
                const Vec vx = load(x + i), vy = load(y + i);
                const Vec g = filter_column(in_order[0], i) + 2.0f * (vx * filter_column(in_order[1], i) +
                                                                      (vx - vy) * filter_column(in_order[2], i));
                const Vec sign = keep(gt(vx, vy), set1(l1_weight)) - keep(gt(vy, vx), set1(l1_weight));
                store(out + i, fnma(set1(ssim_weight), g, sign));
            }
            const size_t begin = size_t(at) * size_t(w);
            float *v = a.v_image + 3 * begin + channel;
            if (in.mask_mode == GS_MASK_IGNORE)
                for (int i = 0; i < w; ++i)
                    v[3 * i] = out[i] * (float(in.mask[begin + size_t(i)]) * (1.0f / 255.0f));
            else
                for (int i = 0; i < w; ++i)
                    v[3 * i] = out[i];
        }
}

} // namespace gs::GS_NAMESPACE
