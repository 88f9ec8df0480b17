// Loss kernel: fused L1 + SSIM of one tile and its gradient (Wang et al. 2004; zero padding as in 3DGS).
// Gaussian windows are separable: maps are stored in ring buffers of rows and filtered vertically, five rows at a time,
// which reads each row three times instead of eleven, then horizontally. The gradient filters the derivatives again,
// five rows later, in its own ring buffers, so only the gradient itself has the size of the image. Rows are interleaved
// RGB, so a tap along them is three floats wide. SSIM is computed from d = x - y: with D = E[d] and V = Var(d),
//   SSIM = (1 - D^2 / (mx^2 + my^2 + C1)) (1 - V / (sx^2 + sy^2 + C2)),
// the usual formula rearranged. The usual variances would cancel in bright flat regions; here the small quantities D
// and V are computed from small numbers. Values are also shifted by -0.5, which does not change variances.
#pragma once

#include "exposure.h"
#include "loss.h"
#include "simd.h"

#include <initializer_list>

namespace gs::GS_NAMESPACE {

constexpr float kShift = 0.5f;
constexpr float kTap[kReach + 1] = {GS_SSIM_TAPS};

// Ring buffer of rows, as many as the windows cover.
struct LossRing {
    float *rows;
    size_t stride;

    float *row(int group, int j) const { return rows + size_t(group % kLossRing * kLossGroup + j) * stride; }
};

// The rows of a ring covered by the windows over the rows of `group - 1`, in order.
struct LossWindow {
    const float *row[kLossRing * kLossGroup];

    LossWindow(const LossRing &ring, int group) {
        for (int j = 0; j < kLossRing * kLossGroup; ++j)
            row[j] = ring.row(group - 2 + j / kLossGroup, j % kLossGroup);
    }
};

// Filters `maps` values down the columns: value(k, v) sets those of row k of the window; row j of the group gets
// out[map * kLossGroup + j].
template <int maps, class F> static inline void filter_down(Vec *out, F value) {
    Vec sums[maps * kLossGroup] = {};
#pragma GCC unroll 15
    for (int k = 0; k < kLossRing * kLossGroup; ++k) {
        Vec v[maps];
        value(k, v);
#pragma GCC unroll 5
        for (int j = 0; j < kLossGroup; ++j) {
            const int tap = k - kReach - j;
            if (-kReach <= tap && tap <= kReach)
                for (int m = 0; m < maps; ++m)
                    sums[m * kLossGroup + j] = fma(set1(kTap[tap < 0 ? -tap : tap]), v[m], sums[m * kLossGroup + j]);
        }
    }
    for (int i = 0; i < maps * kLossGroup; ++i)
        out[i] = sums[i];
}

// Filters along a row around the float one margin behind `row`.
static inline Vec filter_along(const float *row) {
    const float *const centre = row + kLossMargin;
    Vec s = kTap[0] * load(centre);
#pragma GCC unroll 5
    for (int k = 1; k <= kReach; ++k)
        s = fma(set1(kTap[k]), load(centre - 3 * k) + load(centre + 3 * k), s);
    return s;
}

// The mask of `pixels` pixels, for each float of them.
static inline void read_mask(const uint8_t *mask, int pixels, float *weight) {
    for (int i = 0; i < pixels; ++i)
        weight[3 * i] = weight[3 * i + 1] = weight[3 * i + 2] = float(mask[i]) * (1.0f / 255.0f);
}

// Pixels [begin, end) of a row; the image is shifted by -`shift`, the photo by -kShift. `mask`: see read_mask.
static inline void read_row(const gs_loss_args &a, const float *mask, int row, int begin, int end, float shift,
                            float *x, float *y) {
    const size_t at = 3 * (size_t(row) * size_t(a.width) + size_t(begin));
    const float *image = a.image + at;
    const uint8_t *target = a.target + at;
    constexpr float kByte = 1.0f / 255.0f;
    const int n = 3 * (end - begin);
    if (a.mask_mode == GS_MASK_NONE)
        for (int i = 0; i < n; ++i) {
            x[i] = image[i] - shift;
            y[i] = float(target[i]) * kByte - kShift;
        }
    else if (a.mask_mode == GS_MASK_IGNORE)
        for (int i = 0; i < n; ++i) {
            x[i] = image[i] * mask[i] - shift;
            y[i] = float(target[i]) * kByte * mask[i] - kShift;
        }
    else
        for (int i = 0; i < n; ++i) {
            x[i] = image[i] - shift;
            y[i] = float(target[i]) * kByte * mask[i] + a.background[i % 3] * (1.0f - mask[i]) - kShift;
        }
}

static inline void fill(float *row, int begin, int end, float value) {
    for (int i = begin; i < end; ++i)
        row[i] = value;
}

static inline double lane_total(Vec v) {
    double sum = 0;
    for (int l = 0; l < kLanes; ++l)
        sum += double(v[l]);
    return sum;
}

// SSIM of x and y from E[x], E[y], E[x^2 + y^2] and E[d^2], and its derivatives.
struct Similarity {
    Vec value;
    Vec by_mean, by_squares, by_distances; // with respect to E[x], E[x^2 + y^2], E[d^2]

    Similarity(Vec mx, Vec my, Vec squares, Vec distances) {
        const Vec diff = mx - my;
        const Vec spread = squares - fma(mx, mx, my * my);
        const Vec v = max(fnma(diff, diff, distances), Vec{});
        const Vec ux = mx + kShift, uy = my + kShift;
        const Vec inv_b1 = quotient(set1(1.0f), fma(ux, ux, uy * uy) + GS_SSIM_C1);
        const Vec inv_b2 = quotient(set1(1.0f), max(spread, Vec{}) + GS_SSIM_C2);
        const Vec v_share = v * inv_b2, diff_share = diff * diff * inv_b1;
        const Vec luminance = 1.0f - diff_share, contrast = 1.0f - v_share;
        value = luminance * contrast;
        by_squares = luminance * v_share * inv_b2;
        by_mean = 2.0f * (contrast * inv_b1 * (ux * diff_share - diff) + luminance * inv_b2 * diff - by_squares * mx);
        by_distances = -luminance * inv_b2;
    }
};

// Pipeline of a tile in three stages, each a group of rows behind the previous one.
class LossTile {
  public:
    LossTile(const LossArgs &a, int tile, float *scratch) : a_(a), in_(*a.args), w_(in_.width), h_(in_.height) {
        const LossGrid grid(w_, h_);
        top_ = tile / grid.strips * grid.rows;
        bottom_ = top_ + grid.rows < h_ ? top_ + grid.rows : h_;
        left_ = tile % grid.strips * grid.columns;
        right_ = left_ + grid.columns < w_ ? left_ + grid.columns : w_;
        n_ = 3 * (right_ - left_);
        last_ = (n_ - 1) / kLanes * kLanes;
        last_lanes_ = gt(set1(float(n_ - last_)), iota());
        stride_ = grid.stride();
        const auto take_ring = [&] {
            float *const rows = scratch;
            scratch += size_t(kLossRing * kLossGroup) * stride_;
            return LossRing{rows, stride_};
        };
        x_ = take_ring();
        y_ = take_ring();
        for (LossRing &ring : derivatives_)
            ring = take_ring();
        down_ = scratch;
        scratch += size_t(kLossMaps * kLossGroup) * stride_;
        weight_ = scratch;
        if (!in_.gain)
            return;
        by_gain_ = weight_ + stride_;
        for (int i = 0; i < 3 * kLanes; ++i) {
            const ExposureCurve curve = exposure_curve(in_.gain[i % 3]);
            gain_[i] = curve.gain;
            offset_[i] = curve.offset;
            steep_[i] = curve.steep;
            dark_[i] = curve.dark;
        }
        fill(by_gain_, 0, int(stride_), 0.0f);
    }

    void run(double *sums) {
        // Everything beyond the picture is padding and stays zero.
        fill(x_.rows, 0, kLossRing * kLossGroup * int(stride_), -kShift);
        fill(y_.rows, 0, kLossRing * kLossGroup * int(stride_), -kShift);
        const bool gradient = a_.v_image != nullptr;
        const int around = gradient ? 2 : 1; // groups needed above and below the tile
        const int groups = ceil_div(bottom_ - top_, kLossGroup) + 2 * around;
        for (int group = 0; group < groups; ++group) {
            const int row = top_ + (group - around) * kLossGroup;
            take_in(group, row);
            if (group >= 2)
                compare(group, row - kLossGroup);
            if (group >= 4 && gradient)
                write_gradient(group, row - 2 * kLossGroup);
        }
        sums[0] = l1_;
        sums[1] = ssim_;
        sums[2] = mse_;
        sums[3] = sums[4] = sums[5] = 0;
        for (int i = 0; in_.gain && gradient && i < n_; ++i)
            sums[3 + i % 3] += double(by_gain_[i]);
    }

  private:
    size_t pixel(int row, int column) const { return size_t(row) * size_t(w_) + size_t(column); }
    static int next_channels(int c) { return c < 2 * kLanes ? c + kLanes : 0; }
    bool counts(int row) const { return top_ <= row && row < bottom_; }
    bool in_picture(int row) const { return 0 <= row && row < h_; }
    // `v`, at float `i` of the tile's row, without lanes beyond its end.
    Vec inside(int i, Vec v) const { return i < last_ ? v : keep(last_lanes_, v); }
    float *down(int map, int j) const { return down_ + size_t(map * kLossGroup + j) * stride_; }
    // Floats of a row needed for SSIM, and of a derivative needed for the gradient.
    int entering() const { return 2 * kLossMargin + n_ + 2 * 3 * kReach; }
    int compared() const { return kLossMargin + n_ + 3 * kReach; }

    // Reads the rows from `begin` on.
    void take_in(int group, int begin) {
        const int from = left_ < 2 * kReach ? 0 : left_ - 2 * kReach;
        const int to = w_ - right_ < 2 * kReach ? w_ : right_ + 2 * kReach;
        const int at = 2 * kLossMargin + 3 * (from - left_);
        for (int j = 0; j < kLossGroup; ++j) {
            const int row = begin + j;
            float *const x = x_.row(group, j), *const y = y_.row(group, j);
            if (in_picture(row)) {
                if (in_.mask_mode != GS_MASK_NONE)
                    read_mask(in_.mask + pixel(row, from), to - from, weight_);
                read_row(in_, weight_, row, from, to, in_.gain ? 0.0f : kShift, x + at, y + at);
                if (in_.gain)
                    expose(x + at, y + at, 3 * (to - from));
            } else {
                fill(x, at, at + 3 * (to - from), -kShift);
                fill(y, at, at + 3 * (to - from), -kShift);
            }
            if (counts(row))
                add_differences(x + 2 * kLossMargin, y + 2 * kLossMargin);
        }
    }

    // Exposes `n` floats of a row of the image, shifts them, and clamps them to white where the photo is white. A mask
    // has multiplied them, and multiplies the offset and the limit of the curve.
    void expose(float *x, const float *y, int n) {
        const Vec white = set1(1.0f - kShift);
        const bool masked = in_.mask_mode == GS_MASK_IGNORE;
        for (int i = 0, c = 0; i < n; i += kLanes, c = next_channels(c)) {
            const Vec v = load(x + i), weight = masked ? load(weight_ + i) : set1(1.0f);
            const Vec bright = fma(v, load(gain_ + c), load(offset_ + c) * weight);
            const Vec exposed = select(gt(load(dark_ + c) * weight, v), v * load(steep_ + c), bright) - kShift;
            store(x + i, select(both(ge(load(y + i), white), gt(exposed, white)), white, exposed));
        }
        fill(x, n, ceil_div(n, kLanes) * kLanes, -kShift); // padding
    }

    void add_differences(const float *x, const float *y) {
        Vec l1 = {}, mse = {};
        for (int i = 0; i < n_; i += kLanes) {
            const Vec d = inside(i, load(x + i) - load(y + i));
            l1 += max(d, -d);
            mse += d * d;
        }
        l1_ += lane_total(l1);
        mse_ += lane_total(mse);
    }

    // SSIM of the rows from `begin` on, and its derivatives.
    void compare(int group, int begin) {
        const LossWindow x(x_, group), y(y_, group);
        for (int i = 0; i < entering(); i += kLanes) {
            Vec sums[2 * kLossGroup];
            filter_down<2>(sums, [&](int k, Vec *v) {
                v[0] = load(x.row[k] + i);
                v[1] = load(y.row[k] + i);
            });
            for (int j = 0; j < 2 * kLossGroup; ++j)
                store(down(0, j) + i, sums[j]);
            filter_down<2>(sums, [&](int k, Vec *v) {
                const Vec vx = load(x.row[k] + i), vy = load(y.row[k] + i), d = vx - vy;
                v[0] = fma(vx, vx, vy * vy);
                v[1] = d * d;
            });
            for (int j = 0; j < 2 * kLossGroup; ++j)
                store(down(2, j) + i, sums[j]);
        }
        const int picture_begin = kLossMargin - 3 * left_, picture_end = kLossMargin + 3 * (w_ - left_);
        for (int j = 0; j < kLossGroup; ++j) {
            float *const by_mean = derivatives_[0].row(group, j), *const by_squares = derivatives_[1].row(group, j);
            float *const by_distances = derivatives_[2].row(group, j);
            const int row = begin + j;
            Vec sum = {};
            for (int i = 0; i < compared(); i += kLanes) {
                const Similarity found(filter_along(down(0, j) + i), filter_along(down(1, j) + i),
                                       filter_along(down(2, j) + i), filter_along(down(3, j) + i));
                const int at = i - kLossMargin;
                if (0 <= at && at < n_)
                    sum += inside(at, found.value);
                store(by_mean + i, found.by_mean);
                store(by_squares + i, found.by_squares);
                store(by_distances + i, found.by_distances);
            }
            if (counts(row))
                ssim_ += lane_total(sum);
            for (const LossRing &ring : derivatives_) { // padding has none
                fill(ring.row(group, j), 0, in_picture(row) ? picture_begin : int(stride_), 0.0f);
                fill(ring.row(group, j), picture_end, int(stride_), 0.0f);
            }
        }
    }

    // The gradient of the rows from `begin` on.
    void write_gradient(int group, int begin) {
        for (int m = 0; m < kLossDerivatives; ++m) {
            const LossWindow window(derivatives_[m], group);
            for (int i = 0; i < compared(); i += kLanes) {
                Vec sums[kLossGroup];
                filter_down<1>(sums, [&](int k, Vec *v) { v[0] = load(window.row[k] + i); });
                for (int j = 0; j < kLossGroup; ++j)
                    store(down(m, j) + i, sums[j]);
            }
        }
        const double values = 3.0 * double(w_) * double(h_);
        const Vec l1_weight = set1(float((1.0 - double(in_.ssim_weight)) / values));
        const Vec ssim_weight = set1(float(double(in_.ssim_weight) / values));
        for (int j = 0; j < kLossGroup; ++j) {
            if (!counts(begin + j))
                continue;
            const float *const xs = x_.row(group - 2, j) + 2 * kLossMargin;
            const float *const ys = y_.row(group - 2, j) + 2 * kLossMargin;
            static_assert(kLossDerivatives < kLossMaps);
            float *const out = down(kLossDerivatives, j);
            for (int i = 0; i < n_; i += kLanes) {
                const Vec x = load(xs + i), y = load(ys + i);
                const Vec v = filter_along(down(0, j) + i) +
                              2.0f * (x * filter_along(down(1, j) + i) + (x - y) * filter_along(down(2, j) + i));
                const Vec sign = keep(gt(x, y), l1_weight) - keep(gt(y, x), l1_weight);
                store(out + i, fnma(ssim_weight, v, sign));
            }
            const size_t at = pixel(begin + j, left_);
            const bool masked = in_.mask_mode == GS_MASK_IGNORE;
            if (masked)
                read_mask(in_.mask + at, n_ / 3, weight_);
            if (in_.gain)
                chain_gain(xs, ys, masked, out);
            for (int i = 0; masked && i < n_; ++i)
                out[i] *= weight_[i];
            std::memcpy(a_.v_image + 3 * at, out, size_t(n_) * sizeof(float));
        }
    }

    // Converts a row's gradient from x to the image, but for the mask, and accumulates that of ln gain: x plus the
    // offset of the curve, or times its power in the dark. `masked`: x has been multiplied by `weight_`.
    void chain_gain(const float *xs, const float *ys, bool masked, float *v) {
        const Vec white = set1(1.0f - kShift);
        for (int i = 0, c = 0; i < n_; i += kLanes, c = next_channels(c)) {
            const Vec x = load(xs + i), gradient = load(v + i), steep = load(steep_ + c);
            const Vec weight = masked ? load(weight_ + i) : set1(1.0f);
            const Vec used = gradient - keep(both(ge(x, white), ge(load(ys + i), white)), gradient);
            const Vec value = x + kShift;
            const Mask bright = ge(value, load(dark_ + c) * steep * weight);
            const Vec by_gain = select(bright, fma(set1(GS_EXPOSURE_OFFSET), weight, value), GS_EXPOSURE_POWER * value);
            store(by_gain_ + i, fma(inside(i, used), by_gain, load(by_gain_ + i)));
            store(v + i, used * select(bright, load(gain_ + c), steep));
        }
    }

    const LossArgs &a_;
    const gs_loss_args &in_;
    const int w_, h_;
    int top_, bottom_, left_, right_;
    int n_;    // floats of a row of the tile
    int last_; // start of its last vector
    Mask last_lanes_;
    size_t stride_;
    // Inputs of the loss, two margins before the tile, and derivatives, one margin before it.
    LossRing x_, y_, derivatives_[kLossDerivatives];
    float *down_;    // a group of rows of each map, filtered vertically
    float *weight_;  // the mask for each float of a row
    float *by_gain_; // sums over rows of the gradient in the logarithm of the gain
    // The curve (exposure.h) for the floats of three vectors, after which the channels repeat.
    float gain_[3 * kLanes], offset_[3 * kLanes], steep_[3 * kLanes], dark_[3 * kLanes];
    double l1_ = 0, ssim_ = 0, mse_ = 0;
};

static void image_loss(const LossArgs &a, int tile, float *scratch) {
    LossTile(a, tile, scratch).run(a.partial + kLossSums * tile);
}

} // namespace gs::GS_NAMESPACE
