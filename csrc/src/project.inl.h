// Projection kernels, shared part: EWA (Zwicker et al. 2001).
// kLanes splats at a time. With W the rotation of the camera, R that of a splat and S its scales, the 2D covariance is
// M M^T + eps2d I where M = J W R S is 2 x 3. Its determinant before eps2d is the sum of M's squared 2 x 2 minors
// (Cauchy-Binet), which does not cancel for needles.
#pragma once

#include "raster_types.h"
#include "rows.h"
#include "simd.h"

namespace gs::GS_NAMESPACE {

struct Row3 {
    Vec x, y, z;
};

static inline Vec dot3(Vec ax, Vec ay, Vec az, Vec bx, Vec by, Vec bz) { return fma(ax, bx, fma(ay, by, az * bz)); }

// State of one splat per lane, for the forward and backward pass.
struct Lanes {
    Vec mean[3], quat[4], quat_length, scale[3], opacity;
    Vec see_through; // 1 - opacity, without cancellation near 1; set if raw
    Vec cam[3], inverse_z;
    Vec ratio[2];         // x / z, y / z; like the next two not set for parallel rays
    Vec ratio_clamped[2]; // clamped for the Jacobian
    Mask unclamped[2];
    Vec jac_diagonal[2]; // J = [d0 0 o0; 0 d1 o1]
    Vec jac_offset[2];
    Vec rot[3][3];       // R
    Vec world_rot[3][3]; // W R
    Vec proj[2][3];      // J W R
    Vec m[2][3];         // J W R S
    Vec minor[3];        // of columns 12, 20, 01
    Vec cov_xx, cov_xy, cov_yy, det0, det;
    Vec compensation; // opacity factor
    Mask compensated; // where it is above its floor
    Vec mean2d[2];
    Vec sigma_opacity; // after compensation
};

// Limits of x / z and y / z in J, to which they are clamped, because the linearisation degenerates far off screen.
struct Limits {
    float low[2], high[2];
    explicit Limits(const gs_view &v) {
        const float tan_x = 0.5f * float(v.width) / v.fx, tan_y = 0.5f * float(v.height) / v.fy;
        high[0] = (float(v.width) - v.cx) / v.fx + GS_JACOBIAN_MARGIN * tan_x;
        low[0] = -v.cx / v.fx - GS_JACOBIAN_MARGIN * tan_x;
        high[1] = (float(v.height) - v.cy) / v.fy + GS_JACOBIAN_MARGIN * tan_y;
        low[1] = -v.cy / v.fy - GS_JACOBIAN_MARGIN * tan_y;
    }
};

// Means in the camera frame; returns the lanes between near and far plane.
GS_INLINE Mask place(const gs_splats &in, const gs_view &view, const uint32_t *id, Lanes &s) {
    const float *w = view.viewmat;
    gather<3>(in.means, in.count, id, s.mean);
    for (int i = 0; i < 3; ++i)
        s.cam[i] = fma(set1(w[4 * i]), s.mean[0],
                       fma(set1(w[4 * i + 1]), s.mean[1], fma(set1(w[4 * i + 2]), s.mean[2], set1(w[4 * i + 3]))));
    // Comparisons with NaN are false, so an invalid row fails here or below.
    return both(gt(s.cam[2], set1(view.near_plane)), ge(set1(view.far_plane), s.cam[2]));
}

// Loads quaternions, and activated scales and opacities; returns the lanes with finite numbers.
GS_INLINE Mask read_shape(const gs_splats &in, const uint32_t *id, Lanes &s) {
    Vec poison = {};
    gather<4>(in.quats, in.count, id, s.quat);
    for (const Vec q : s.quat)
        poison += q * 0.0f;
    gather<3>(in.scales, in.count, id, s.scale);
    for (Vec &scale : s.scale) {
        poison += scale * 0.0f;
        if (in.raw)
            scale = exp(scale);
    }
    const Vec o = gather_one(in.opacities, id);
    poison += o * 0.0f;
    if (in.raw) {
        const Vec e = exp(-o);
        s.opacity = 1.0f / (1.0f + e);
        s.see_through = e * s.opacity;
    } else {
        s.opacity = o;
    }
    return ge(poison, Vec{});
}

// Normalises the quaternions and computes R and W R; returns the lanes with a non-zero quaternion.
GS_INLINE Mask rotate(const float *w, Lanes &s) {
    // Divided by the largest component first, so that no length over- or underflows.
    Vec largest = {};
    for (int k = 0; k < 4; ++k)
        largest = max(largest, max(s.quat[k], -s.quat[k]));
    const Mask ok = ge(largest, set1(GS_QUAT_MIN));
    Vec q[4], norm2 = {};
    const Vec shrink = 1.0f / max(largest, set1(GS_QUAT_MIN));
    for (int k = 0; k < 4; ++k) {
        q[k] = s.quat[k] * shrink;
        norm2 = fma(q[k], q[k], norm2);
    }
    const Vec norm = sqrt(norm2);
    for (int k = 0; k < 4; ++k)
        s.quat[k] = q[k] / norm;
    s.quat_length = norm / shrink;
    const Vec qw = s.quat[0], qx = s.quat[1], qy = s.quat[2], qz = s.quat[3];
    s.rot[0][0] = 1.0f - 2.0f * fma(qy, qy, qz * qz);
    s.rot[0][1] = 2.0f * fnma(qw, qz, qx * qy);
    s.rot[0][2] = 2.0f * fma(qw, qy, qx * qz);
    s.rot[1][0] = 2.0f * fma(qw, qz, qx * qy);
    s.rot[1][1] = 1.0f - 2.0f * fma(qx, qx, qz * qz);
    s.rot[1][2] = 2.0f * fnma(qw, qx, qy * qz);
    s.rot[2][0] = 2.0f * fnma(qw, qy, qx * qz);
    s.rot[2][1] = 2.0f * fma(qw, qx, qy * qz);
    s.rot[2][2] = 1.0f - 2.0f * fma(qx, qx, qy * qy);
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k)
            s.world_rot[i][k] =
                dot3(set1(w[4 * i]), set1(w[4 * i + 1]), set1(w[4 * i + 2]), s.rot[0][k], s.rot[1][k], s.rot[2][k]);
    return ok;
}

// Projected means, J, J W R and M.
GS_INLINE void linearise(const gs_view &view, const Limits &limits, Lanes &s) {
    s.inverse_z = 1.0f / s.cam[2];
    const float focal[2] = {view.fx, view.fy}, center[2] = {view.cx, view.cy};
    for (int i = 0; i < 2; ++i) {
        if (view.orthographic) {
            s.jac_diagonal[i] = set1(focal[i]);
            s.jac_offset[i] = Vec{};
            s.mean2d[i] = fma(set1(focal[i]), s.cam[i], set1(center[i]));
        } else {
            s.ratio[i] = s.cam[i] * s.inverse_z;
            s.ratio_clamped[i] = min(max(s.ratio[i], set1(limits.low[i])), set1(limits.high[i]));
            s.unclamped[i] = both(ge(s.ratio[i], set1(limits.low[i])), ge(set1(limits.high[i]), s.ratio[i]));
            s.jac_diagonal[i] = focal[i] * s.inverse_z;
            s.jac_offset[i] = -s.jac_diagonal[i] * s.ratio_clamped[i];
            s.mean2d[i] = fma(set1(focal[i]), s.ratio[i], set1(center[i]));
        }
        for (int k = 0; k < 3; ++k) {
            s.proj[i][k] = fma(s.jac_diagonal[i], s.world_rot[i][k], s.jac_offset[i] * s.world_rot[2][k]);
            s.m[i][k] = s.proj[i][k] * s.scale[k];
        }
    }
}

// 2D covariance and compensated opacity; returns the lanes in which both are valid.
GS_INLINE Mask spread(const gs_view &view, Lanes &s) {
    for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        s.minor[k] = fnma(s.m[0][j], s.m[1][i], s.m[0][i] * s.m[1][j]);
    }
    const float eps = view.eps2d;
    const Vec xx = dot3(s.m[0][0], s.m[0][1], s.m[0][2], s.m[0][0], s.m[0][1], s.m[0][2]);
    const Vec yy = dot3(s.m[1][0], s.m[1][1], s.m[1][2], s.m[1][0], s.m[1][1], s.m[1][2]);
    s.cov_xy = dot3(s.m[0][0], s.m[0][1], s.m[0][2], s.m[1][0], s.m[1][1], s.m[1][2]);
    s.cov_xx = xx + eps;
    s.cov_yy = yy + eps;
    s.det0 = dot3(s.minor[0], s.minor[1], s.minor[2], s.minor[0], s.minor[1], s.minor[2]);
    s.det = fma(set1(eps), xx + yy + eps, s.det0);
    // Beyond float's range (a deviation of some 1e9 px) a splat cannot be drawn.
    const Mask ok = both(gt(s.det, Vec{}), ge(set1(3e38f), s.det));

    s.compensation = set1(1.0f);
    s.compensated = gt(Vec{}, set1(1.0f));
    if (view.antialias) {
        const Vec c = sqrt(s.det0 / s.det);
        s.compensated = gt(c, set1(GS_COMPENSATION_MIN));
        s.compensation = max(c, set1(GS_COMPENSATION_MIN));
    }
    s.sigma_opacity = s.opacity * s.compensation;
    return both(ok, both(ge(s.sigma_opacity, set1(GS_ALPHA_MIN)), ge(set1(3e38f), s.sigma_opacity)));
}

// Fills `s` for the splats id[0..kLanes); returns the lanes with valid geometry.
static inline Mask project_lanes(const gs_splats &in, const gs_view &view, const Limits &limits, const uint32_t *id,
                                 Lanes &s) {
    Mask ok = place(in, view, id, s);
    if (!bits(ok))
        return ok;
    ok = both(ok, read_shape(in, id, s));
    ok = both(ok, rotate(view.viewmat, s));
    linearise(view, limits, s);
    return both(ok, spread(view, s));
}

static inline void direction(const gs_view &view, const Lanes &s, Row3 &d, Vec &length) {
    // mean - camera centre = W^T (W mean + t), exact also far from the origin.
    // Parallel rays all run along W^T z.
    const float *w = view.viewmat;
    Vec v[3];
    for (int j = 0; j < 3; ++j)
        v[j] = view.orthographic ? set1(w[8 + j])
                                 : dot3(set1(w[j]), set1(w[4 + j]), set1(w[8 + j]), s.cam[0], s.cam[1], s.cam[2]);
    length = sqrt(dot3(v[0], v[1], v[2], v[0], v[1], v[2]));
    d = {v[0] / length, v[1] / length, v[2] / length};
}

} // namespace gs::GS_NAMESPACE
