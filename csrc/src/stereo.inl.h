// Stereo kernel, a plane sweep: scores of a band of rows, plane after plane, and their highest peaks.
//
// A window of the reference is compared with the warped source by zero-mean normalised cross-correlation. The three
// window sums are computed from column sums, which add one row and subtract another per row, and restart in each band,
// so that rounding does not accumulate. Grey values are relative to the middle of their range, which keeps the sums
// small.
#pragma once

#include "simd.h"
#include "stereo.h"

namespace gs::GS_NAMESPACE {

constexpr float kGreyMiddle = 128.0f;

// Positions of a row of the reference in a source, at one plane, as lines in homogeneous coordinates.
struct StereoRow {
    float u, v, w, du, dv, dw;

    StereoRow(const gs_stereo_warp &warp, float y, float inverse_depth) {
        const float *const r = warp.rotation, *const t = warp.translation;
        const float along[3] = {r[0], r[3], r[6]};
        float first[3];
        for (int i = 0; i < 3; ++i)
            first[i] = 0.5f * along[i] + y * r[3 * i + 1] + r[3 * i + 2] + inverse_depth * t[i];
        u = first[0], v = first[1], w = first[2];
        du = along[0], dv = along[1], dw = along[2];
    }
};

// Grey values of a source, and their penalty: 0, or outside the source a penalty above any score.
struct StereoSample {
    Vec grey, penalty;
};

GS_INLINE StereoSample stereo_sample(const StereoSource &source, const StereoRow &row, Vec x, float rim) {
    const Vec w = fma(x, row.dw, set1(row.w));
    const Vec per = quotient(set1(1.0f), max(w, set1(1e-12f)));
    // Pixel coordinates with integers at pixel centres.
    const Vec u = fma(fma(x, row.du, set1(row.u)), per, set1(-0.5f));
    const Vec v = fma(fma(x, row.dv, set1(row.v)), per, set1(-0.5f));
    const Vec right = set1(float(source.width - 1)), bottom = set1(float(source.height - 1));
    const Mask inside = both(both(ge(u, set1(rim)), ge(right - rim, u)), both(ge(v, set1(rim)), ge(bottom - rim, v)));
    // max and min return their second operand if the first is NaN.
    const Vec cu = min(max(u, Vec{}), right), cv = min(max(v, Vec{}), bottom);
    const IVec column = to_int(cu), line = to_int(cv);
    const IVec quad = gather(source.quads, line * source.width + column);
    const Vec fu = cu - to_float(column), fv = cv - to_float(line);
    const Vec a = to_float(quad & 255), b = to_float((quad >> 8) & 255);
    const Vec c = to_float((quad >> 16) & 255), d = to_float((quad >> 24) & 255);
    const Vec upper = fma(fu, b - a, a), lower = fma(fu, d - c, c);
    const Mask seen = both(inside, gt(w, set1(1e-12f)));
    return {fma(fv, lower - upper, upper) - kGreyMiddle, select(seen, Vec{}, set1(-4.0f))};
}

class StereoSweep {
  public:
    StereoSweep(const StereoArgs &a, int band, float *scratch)
        : a_(a), in_(*a.args), layout_(in_.width, in_.radius), stride_(layout_.stride), top_(band * kStereoRows),
          rows_(in_.height - top_ < kStereoRows ? in_.height - top_ : kStereoRows),
          step_((in_.nearest - in_.farthest) / float(in_.planes - 1)), count_(float(layout_.window * layout_.window)),
          floor_(count_ * in_.noise * in_.noise) {
        std::memset(scratch, 0, layout_.scratch_floats() * sizeof(float));
        const auto take = [&](int rows) {
            float *const at = scratch + kStereoMargin;
            scratch += rows * stride_;
            return at;
        };
        reference_ = take(layout_.reference_rows());
        ring_ = take(layout_.window);
        penalty_ = take(layout_.window);
        for (float *&sums : columns_)
            sums = take(1);
        for (float *&map : maps_)
            map = take(kStereoRows);
    }

    void run() {
        read_reference();
        measure_reference();
        fill(kBefore, kOutside);
        fill(kLast, kOutside);
        fill(kBest, kNoScore);
        fill(kIndex, kNoScore);
        fill(kSecondBest, kNoScore);
        for (int plane = 0; plane < in_.planes; ++plane) {
            fill(kFirst, kNoScore);
            fill(kSecond, kNoScore);
            for (int s = 0; s < in_.source_count; ++s)
                compare(a_.sources[s], in_.farthest + step_ * float(plane));
            update_peaks(float(plane - 1));
        }
        fill(kFirst, kOutside);
        fill(kSecond, kOutside);
        update_peaks(float(in_.planes - 1));
        for (int y = 0; y < rows_; ++y)
            write(y);
    }

  private:
    // Maps of the band's pixels: mean of the window and factor of its covariances; the two best scores of the plane;
    // the scores of the two previous planes; the highest peak, its plane and neighbours; the second best peak.
    enum Map { kMean, kScale, kFirst, kSecond, kBefore, kLast, kBest, kIndex, kLeft, kRight, kSecondBest };
    static_assert(kSecondBest + 1 == StereoBand::kMaps);

    float *row(int map, int y) const { return maps_[map] + int64_t(y) * stride_; }
    // A row of the reference, counted from the first one in the band's windows; zeros above that.
    float *reference(int y) const { return reference_ + int64_t(layout_.window + y) * stride_; }
    float *slot(float *ring, int y) const { return ring + int64_t(y % layout_.window) * stride_; }
    int entering() const { return rows_ + 2 * layout_.radius; }

    void fill(int map, float value) {
        for (int y = 0; y < rows_; ++y)
            for (int x = 0; x < in_.width; x += kLanes)
                store(row(map, y) + x, set1(value));
    }

    void read_reference() {
        for (int y = 0; y < entering(); ++y) {
            const int line = top_ - layout_.radius + y;
            if (line < 0 || line >= in_.height)
                continue;
            const uint8_t *const grey = in_.grey + int64_t(line) * in_.width;
            for (int x = 0; x < in_.width; ++x)
                reference(y)[x] = float(grey[x]) - kGreyMiddle;
        }
    }

    // Window sums from column sums.
    Vec along(int sums, int x) const {
        const float *const at = columns_[sums] + x;
        Vec total = load(at);
        for (int k = 1; k <= layout_.radius; ++k)
            total += load(at - k) + load(at + k);
        return total;
    }

    void clear_columns() {
        for (float *const sums : columns_)
            std::memset(sums - kStereoMargin, 0, size_t(stride_) * sizeof(float));
    }

    void measure_reference() {
        clear_columns();
        for (int y = 0; y < entering(); ++y) {
            const float *const added_row = reference(y), *const removed_row = reference(y - layout_.window);
            for (int x = 0; x < in_.width; x += kLanes) {
                const Vec now = load(added_row + x), old = load(removed_row + x);
                store(columns_[0] + x, load(columns_[0] + x) + (now - old));
                store(columns_[1] + x, load(columns_[1] + x) + (now * now - old * old));
            }
            const int line = y - 2 * layout_.radius;
            for (int x = 0; line >= 0 && x < in_.width; x += kLanes) {
                const Vec mean = along(0, x) * (1.0f / count_);
                const Vec spread = max(fnma(mean * count_, mean, along(1, x)), Vec{});
                store(row(kMean, line) + x, mean);
                store(row(kScale, line) + x, quotient(set1(1.0f), sqrt(spread + floor_)));
                write_row(a_.found.contrast, line, x, sqrt(spread * (1.0f / count_)));
            }
        }
    }

    void write_row(float *picture, int line, int x, Vec value) const {
        float *const out = picture + int64_t(top_ + line) * in_.width;
        for (int i = 0; i < kLanes && x + i < in_.width; ++i)
            out[x + i] = value[i];
    }

    // Merges the scores of a source at a plane into the best so far.
    void compare(const StereoSource &source, float inverse_depth) {
        clear_columns();
        std::memset(ring_ - kStereoMargin, 0, size_t(layout_.window) * size_t(stride_) * sizeof(float));
        for (int y = 0; y < entering(); ++y) {
            enter(source, y, inverse_depth);
            if (y >= 2 * layout_.radius)
                score(y - 2 * layout_.radius, slot(penalty_, y - layout_.radius));
        }
    }

    // Replaces a row of the source that has left the windows.
    void enter(const StereoSource &source, int y, float inverse_depth) {
        const StereoRow line(source.warp, float(top_ - layout_.radius + y) + 0.5f, inverse_depth);
        const float *const added_row = reference(y), *const removed_row = reference(y - layout_.window);
        float *const ring = slot(ring_, y), *const penalty = slot(penalty_, y);
        float *const sums = columns_[0], *const squares = columns_[1], *const products = columns_[2];
        const float rim = float(layout_.radius);
        for (int x = 0; x < in_.width; x += kLanes) {
            const Vec old = load(ring + x);
            const StereoSample sample = stereo_sample(source, line, iota() + float(x), rim);
            const Vec now = sample.grey;
            store(ring + x, now);
            store(penalty + x, sample.penalty);
            store(sums + x, load(sums + x) + (now - old));
            store(squares + x, load(squares + x) + (now * now - old * old));
            store(products + x, load(products + x) + (now * load(added_row + x) - old * load(removed_row + x)));
        }
    }

    void score(int y, const float *penalty) {
        const float *const mean = row(kMean, y), *const scale = row(kScale, y);
        float *const first = row(kFirst, y), *const second = row(kSecond, y);
        for (int x = 0; x < in_.width; x += kLanes) {
            const Vec sum = along(0, x);
            const Vec spread = max(fnma(sum * (1.0f / count_), sum, along(1, x)), Vec{});
            const Vec covariance = fnma(load(mean + x), sum, along(2, x));
            const Vec similarity = quotient(covariance * load(scale + x), sqrt(spread + floor_));
            const Vec value = max(similarity + load(penalty + x), set1(kNoScore));
            const Vec top = load(first + x);
            store(first + x, max(top, value));
            store(second + x, max(load(second + x), min(top, value)));
        }
    }

    // Updates the peaks with plane `index`, once the score of the plane after it is known.
    void update_peaks(float index) {
        for (int y = 0; y < rows_; ++y)
            for (int x = 0; x < in_.width; x += kLanes)
                update_peaks(index, y, x);
    }

    void update_peaks(float index, int y, int x) {
        const Vec first = load(row(kFirst, y) + x);
        const Vec now = in_.best == 1 ? first : 0.5f * (first + load(row(kSecond, y) + x));
        const Vec before = load(row(kBefore, y) + x), last = load(row(kLast, y) + x);
        const Vec best = load(row(kBest, y) + x), at = load(row(kIndex, y) + x);
        const Vec second_best = load(row(kSecondBest, y) + x);
        store(row(kBefore, y) + x, last);
        store(row(kLast, y) + x, now);
        const Mask peak = both(ge(last, before), gt(last, now));
        const Mask higher = both(peak, gt(last, best));
        // The second best is a peak far from the highest one, or the former highest one below a far, higher peak.
        const Mask far = gt(set1(index) - at, set1(kStereoNear));
        const Vec lower = select(higher, best, last);
        store(row(kSecondBest, y) + x, select(both(peak, far), max(second_best, lower), second_best));
        store(row(kBest, y) + x, select(higher, last, best));
        store(row(kIndex, y) + x, select(higher, set1(index), at));
        store(row(kLeft, y) + x, select(higher, before, load(row(kLeft, y) + x)));
        store(row(kRight, y) + x, select(higher, now, load(row(kRight, y) + x)));
    }

    // The peak between planes: the top of the parabola through it and its neighbours.
    void write(int y) const {
        const int line = top_ + y;
        const bool in_rows = layout_.radius <= line && line < in_.height - layout_.radius;
        for (int x = 0; x < in_.width; x += kLanes) {
            const Vec best = load(row(kBest, y) + x), at = load(row(kIndex, y) + x);
            const Vec left = load(row(kLeft, y) + x), right = load(row(kRight, y) + x);
            const Vec bend = max(2.0f * best - left - right, set1(1e-12f));
            const Vec offset = min(max(quotient(0.5f * (right - left), bend), set1(-0.5f)), set1(0.5f));
            const Vec column = iota() + float(x);
            const Mask in_row =
                both(ge(column, set1(float(layout_.radius))), gt(set1(float(in_.width - layout_.radius)), column));
            // The first and last plane are not peaks: beyond them the score may be higher.
            const Mask within = both(gt(at, Vec{}), gt(set1(float(in_.planes - 1)), at));
            const Mask known = both(both(in_row, within), gt(set1(in_rows ? 1.0f : 0.0f), Vec{}));
            write_row(a_.found.inverse_depth, y, x, keep(known, fma(at + offset, step_, set1(in_.farthest))));
            // The parabola, or rounding, may exceed the maximum of a correlation.
            const Vec top = min(fma(0.25f * (right - left), offset, best), set1(1.0f));
            const Vec second_best = min(load(row(kSecondBest, y) + x), set1(1.0f));
            write_row(a_.found.score, y, x, select(known, top, set1(kNoScore)));
            write_row(a_.found.second_best, y, x, select(known, second_best, set1(kNoScore)));
        }
    }

    const StereoArgs &a_;
    const gs_stereo_sweep_args &in_;
    const StereoBand layout_;
    const int64_t stride_;
    const int top_, rows_;
    const float step_, count_, floor_;
    float *reference_;
    // The last rows of the source, as many as a window has, and their penalties.
    float *ring_, *penalty_;
    float *columns_[3];
    float *maps_[StereoBand::kMaps];
};

static void stereo_sweep(const StereoArgs &a, int band, float *scratch) { StereoSweep(a, band, scratch).run(); }

} // namespace gs::GS_NAMESPACE
