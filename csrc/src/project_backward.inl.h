// Backward projection kernel: gradients of the splats' parameters and the camera.
#pragma once

#include "project.inl.h"
#include "sh.inl.h"

namespace gs::GS_NAMESPACE {

// Gradient from the rotation matrix to the quaternion, per lane.
static inline void quat_backward(const Lanes &s, const Vec v_rot[3][3], Vec v_quat[4]) {
    const Vec w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
    Vec v[4];
    v[0] = 2.0f * (x * (v_rot[2][1] - v_rot[1][2]) + y * (v_rot[0][2] - v_rot[2][0]) + z * (v_rot[1][0] - v_rot[0][1]));
    v[1] = 2.0f * (y * (v_rot[0][1] + v_rot[1][0]) + z * (v_rot[0][2] + v_rot[2][0]) + w * (v_rot[2][1] - v_rot[1][2]) -
                   2.0f * x * (v_rot[1][1] + v_rot[2][2]));
    v[2] = 2.0f * (x * (v_rot[0][1] + v_rot[1][0]) + z * (v_rot[1][2] + v_rot[2][1]) + w * (v_rot[0][2] - v_rot[2][0]) -
                   2.0f * y * (v_rot[0][0] + v_rot[2][2]));
    v[3] = 2.0f * (x * (v_rot[0][2] + v_rot[2][0]) + y * (v_rot[1][2] + v_rot[2][1]) + w * (v_rot[1][0] - v_rot[0][1]) -
                   2.0f * z * (v_rot[0][0] + v_rot[1][1]));
    // Through q = p / |p|: remove the component along q, divide by the length.
    Vec along = {};
    for (int k = 0; k < 4; ++k)
        along = fma(v[k], s.quat[k], along);
    for (int k = 0; k < 4; ++k)
        v_quat[k] = fnma(along, s.quat[k], v[k]) / s.quat_length;
}

static inline void zero_rows(const gs_splat_grads &g, int64_t begin, int64_t end, int sh_rest) {
    const size_t n = size_t(end - begin) * sizeof(float);
    std::memset(g.means + 3 * begin, 0, 3 * n);
    std::memset(g.quats + 4 * begin, 0, 4 * n);
    std::memset(g.scales + 3 * begin, 0, 3 * n);
    std::memset(g.opacities + begin, 0, n);
    std::memset(g.sh0 + 3 * begin, 0, 3 * n);
    if (sh_rest && !g.add_shN)
        std::memset(g.shN + 3 * sh_rest * begin, 0, 3 * size_t(sh_rest) * n);
    if (g.means2d)
        std::memset(g.means2d + 2 * begin, 0, 2 * n);
}

// Rows of the chunk whose splats are culled get zeros; the others are written by the caller.
static inline void zero_culled_rows(const ProjectBackwardArgs &a, int64_t begin, int64_t end, int visible) {
    int64_t next = begin;
    for (int i = 0; i < visible; ++i) {
        const int64_t id = a.forward.projected[begin + i].id;
        if (id > next)
            zero_rows(a.grads, next, id, a.forward.splats->sh_rest);
        next = id + 1;
    }
    if (end > next)
        zero_rows(a.grads, next, end, a.forward.splats->sh_rest);
}

// Sum of the moments of a splat's entries, always in the order of its tiles, for any number of threads.
static inline Moments merge_moments(const Moments *of_list, Span span) {
    const Moments *moments = of_list + span.begin;
    Vec4 sum[kMomentCount / 4] = {};
    for (uint32_t e = 0; e < span.count; ++e)
        for (int k = 0; k < kMomentCount / 4; ++k)
            sum[k] += load<Vec4>(moments[e].v + 4 * k);
    Moments m;
    std::memcpy(m.v, sum, sizeof m.v);
    return m;
}

// Gradient with respect to M = J W R S. With G the matrix of second moments of d and Q the conic, that with respect to
// the covariance is Q G Q / 2, hence (Q G Q) M. G itself is not needed: Q d = (ua u, ub u + vc v) / GS_HALF_LOG2E.
// ln(compensation) = (ln det0 - ln det) / 2 adds -log_gain Q M for its second term. In double, because for needles
// entries of Q G Q are ten thousand times the product.
static inline void covariance_backward(const Lanes &s, float eps2d, Vec guu, Vec guv, Vec gvv, Vec log_gain,
                                       Vec v_m[2][3]) {
    DVec m[2][3];
    for (int i = 0; i < 2; ++i)
        for (int k = 0; k < 3; ++k)
            m[i][k] = to_double(s.m[i][k]);
    const DVec xx = m[0][0] * m[0][0] + m[0][1] * m[0][1] + m[0][2] * m[0][2] + double(eps2d);
    const DVec yy = m[1][0] * m[1][0] + m[1][1] * m[1][1] + m[1][2] * m[1][2] + double(eps2d);
    const DVec xy = m[0][0] * m[1][0] + m[0][1] * m[1][1] + m[0][2] * m[1][2];
    // From the minors, as in float: for needles longer than 1e7 px, xx yy - xy^2 cancels even in double.
    DVec det = double(eps2d) * (xx + yy - double(eps2d));
    for (int k = 0; k < 3; ++k) {
        const DVec minor = m[0][k] * m[1][(k + 1) % 3] - m[0][(k + 1) % 3] * m[1][k];
        det += minor * minor;
    }
    // Squares and products of ua, ub = -ratio ua and vc, all over GS_HALF_LOG2E.
    const DVec inv_yy = 1.0 / yy, inv_det = 1.0 / det, ratio = xy * inv_yy;
    const DVec aa = yy * inv_det, ac = square_root(inv_det);
    const DVec scale = DVec{} + 1.0 / double(GS_HALF_LOG2E);
    const DVec uu = scale * to_double(guu) * aa, uv = scale * to_double(guv) * ac, vv = scale * to_double(gvv) * inv_yy;
    const DVec gain = to_double(log_gain);
    const DVec k00 = uu - gain * aa;
    const DVec k01 = uv - ratio * k00;
    const DVec k11 = vv - gain * inv_yy - ratio * (uv + k01);
    for (int k = 0; k < 3; ++k) {
        v_m[0][k] = to_float(k00 * m[0][k] + k01 * m[1][k]);
        v_m[1][k] = to_float(k01 * m[0][k] + k11 * m[1][k]);
    }
}

// Results of the forward pass and of blending for kLanes splats.
struct Blended {
    uint32_t id[kLanes];
    alignas(64) float sums[kMomentCount][kLanes];
    alignas(64) float color[3][kLanes], conic[3][kLanes]; // conic: ua, ub, vc
    Vec sum(MomentIndex k) const { return load(sums[k]); }
};

// Loads `lanes` slots from `first` on; further lanes repeat the first splat, with sums of zero.
GS_INLINE void read_blended(const ProjectBackwardArgs &a, const Moments *moments, int64_t first, int lanes,
                            Blended &b) {
    std::memset(b.sums, 0, sizeof b.sums);
    std::memset(b.color, 0, sizeof b.color);
    std::memset(b.conic, 0, sizeof b.conic);
    for (int l = 0; l < kLanes; ++l) {
        const size_t slot = size_t(first + (l < lanes ? l : 0));
        const Projected &p = a.forward.projected[slot];
        b.id[l] = p.id;
        if (l >= lanes)
            continue;
        const Moments m = merge_moments(moments, a.spans[slot]);
        for (int k = 0; k < kMomentCount; ++k)
            b.sums[k][l] = m.v[k];
        for (int k = 0; k < 3; ++k)
            b.color[k][l] = p.channel[k];
        b.conic[0][l] = p.ua;
        b.conic[1][l] = p.ub;
        b.conic[2][l] = p.vc;
    }
}

// Adds the first term of the opacity compensation, through the minors, to the gradient with respect to M.
GS_INLINE void compensation_backward(const Lanes &s, Vec g_sum, Vec v_m[2][3]) {
    const Vec gain = keep(s.compensated, g_sum / s.det0);
    for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const Vec g = gain * s.minor[k]; // minor[k] = m0i m1j - m0j m1i
        v_m[0][i] = fma(g, s.m[1][j], v_m[0][i]);
        v_m[1][j] = fma(g, s.m[0][i], v_m[1][j]);
        v_m[0][j] = fnma(g, s.m[1][i], v_m[0][j]);
        v_m[1][i] = fnma(g, s.m[0][j], v_m[1][i]);
    }
}

// Gradients with respect to J, W R and S from that with respect to M = J W R S.
GS_INLINE void product_backward(const Lanes &s, bool raw, const Vec v_m[2][3], Vec v_jac_diagonal[2],
                                Vec v_jac_offset[2], Vec v_world_rot[3][3], Vec v_scale[3]) {
    for (int k = 0; k < 3; ++k) {
        v_scale[k] = fma(v_m[0][k], s.proj[0][k], v_m[1][k] * s.proj[1][k]);
        if (raw)
            v_scale[k] *= s.scale[k];
        const Vec v_p0 = v_m[0][k] * s.scale[k], v_p1 = v_m[1][k] * s.scale[k];
        v_jac_diagonal[0] = fma(v_p0, s.world_rot[0][k], v_jac_diagonal[0]);
        v_jac_diagonal[1] = fma(v_p1, s.world_rot[1][k], v_jac_diagonal[1]);
        v_jac_offset[0] = fma(v_p0, s.world_rot[2][k], v_jac_offset[0]);
        v_jac_offset[1] = fma(v_p1, s.world_rot[2][k], v_jac_offset[1]);
        v_world_rot[0][k] = v_p0 * s.jac_diagonal[0];
        v_world_rot[1][k] = v_p1 * s.jac_diagonal[1];
        v_world_rot[2][k] = fma(v_p0, s.jac_offset[0], v_p1 * s.jac_offset[1]);
    }
}

// Gradient with respect to the mean in the camera frame, from those of J, the projected mean and the two depths.
GS_INLINE void screen_backward(const Lanes &s, const gs_view &view, const Vec v_jac_diagonal[2],
                               const Vec v_jac_offset[2], const Vec v_mean2d[2], Vec v_inverse_z, Vec v_z,
                               Vec v_cam[3]) {
    const float focal[2] = {view.fx, view.fy};
    for (int i = 0; i < 2; ++i) {
        // jac_diagonal = f / z, jac_offset = -f / z * clamped ratio.
        const Vec v_clamped = -s.jac_diagonal[i] * v_jac_offset[i];
        v_inverse_z += focal[i] * fnma(s.ratio_clamped[i], v_jac_offset[i], v_jac_diagonal[i]);
        const Vec v_ratio = fma(set1(focal[i]), v_mean2d[i], keep(s.unclamped[i], v_clamped));
        v_cam[i] = v_ratio * s.inverse_z;
        v_inverse_z = fma(v_ratio, s.cam[i], v_inverse_z);
    }
    v_cam[2] = fnma(s.inverse_z * s.inverse_z, v_inverse_z, v_z);
}

// Writes the gradients of the SH coefficients; returns that of the vector from the camera centre to the mean.
GS_INLINE void color_backward(const ProjectBackwardArgs &a, const Lanes &s, const Blended &b, int lanes,
                              Vec v_from_center[3]) {
    Vec v_color[3];
    for (int k = 0; k < 3; ++k) // passes where it was not clamped at zero
        v_color[k] = keep(gt(load(b.color[k]), Vec{}), b.sum(MomentIndex(kRed + k)));
    Row3 d;
    Vec length;
    direction(*a.forward.view, s, d, length);
    Vec v_d[3];
    sh_backward(*a.forward.splats, a.forward.view->sh_degree, a.grads, b.id, lanes, d.x, d.y, d.z, v_color, v_d);
    const Vec radial = dot3(d.x, d.y, d.z, v_d[0], v_d[1], v_d[2]);
    v_from_center[0] = fnma(radial, d.x, v_d[0]) / length;
    v_from_center[1] = fnma(radial, d.y, v_d[1]) / length;
    v_from_center[2] = fnma(radial, d.z, v_d[2]) / length;
}

// Adds the gradients of kLanes splats with respect to the camera, 3 x 4 row-major.
GS_INLINE void view_backward(const Lanes &s, const float *viewmat, int lanes, const Vec v_cam[3],
                             const Vec v_world_rot[3][3], const Vec v_from_center[3], Vec view_sums[12]) {
    alignas(64) float on[kLanes];
    for (int l = 0; l < kLanes; ++l)
        on[l] = float(l < lanes);
    const Mask mask = gt(load(on), Vec{});
    for (int i = 0; i < 3; ++i) {
        const float t = viewmat[4 * i + 3];
        Vec v_t = v_cam[i];
        for (int j = 0; j < 3; ++j) {
            // W acts on the mean, on R, and through the centre -W^T t on the viewing direction.
            Vec v_w = fma(v_cam[i], s.mean[j], t * v_from_center[j]);
            for (int k = 0; k < 3; ++k)
                v_w = fma(v_world_rot[i][k], s.rot[j][k], v_w);
            view_sums[4 * i + j] += keep(mask, v_w);
            v_t = fma(set1(viewmat[4 * i + j]), v_from_center[j], v_t);
        }
        view_sums[4 * i + 3] += keep(mask, v_t);
    }
}

// Gradients of the first `lanes` splats of `s`: writes those of their parameters, accumulates those of the camera.
GS_INLINE void lanes_backward(const ProjectBackwardArgs &a, const Lanes &s, const Blended &b, int lanes,
                              Vec view_sums[12]) {
    const gs_splats &in = *a.forward.splats;
    const gs_splat_grads &grads = a.grads;
    const float *viewmat = a.forward.view->viewmat;
    const Vec u_sum = b.sum(kGu) * (1.0f / GS_HALF_LOG2E), v_sum = b.sum(kGv) * (1.0f / GS_HALF_LOG2E);
    const Vec v_mean2d[2] = {load(b.conic[0]) * u_sum, fma(load(b.conic[1]), u_sum, load(b.conic[2]) * v_sum)};
    const Vec log_gain = keep(s.compensated, b.sum(kG));
    Vec v_m[2][3];
    covariance_backward(s, a.forward.view->eps2d, b.sum(kGuu), b.sum(kGuv), b.sum(kGvv), log_gain, v_m);
    if (a.forward.view->antialias)
        compensation_backward(s, b.sum(kG), v_m);

    // v_opacity: alpha is proportional to the opacity.
    const Vec v_opacity = in.raw ? b.sum(kG) * s.see_through : b.sum(kG) / s.opacity;
    scatter_one(grads.opacities, b.id, lanes, v_opacity);

    Vec v_jac_diagonal[2] = {}, v_jac_offset[2] = {}, v_world_rot[3][3], v_scale[3];
    product_backward(s, in.raw, v_m, v_jac_diagonal, v_jac_offset, v_world_rot, v_scale);
    scatter<3>(grads.scales, b.id, lanes, v_scale);
    Vec v_rot[3][3];
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k)
            v_rot[i][k] = dot3(set1(viewmat[i]), set1(viewmat[4 + i]), set1(viewmat[8 + i]), v_world_rot[0][k],
                               v_world_rot[1][k], v_world_rot[2][k]);
    Vec v_quat[4];
    quat_backward(s, v_rot, v_quat);
    scatter<4>(grads.quats, b.id, lanes, v_quat);

    Vec v_cam[3], v_from_center[3], v_mean[3];
    screen_backward(s, *a.forward.view, v_jac_diagonal, v_jac_offset, v_mean2d, b.sum(kInvZ), b.sum(kZ), v_cam);
    color_backward(a, s, b, lanes, v_from_center);
    for (int j = 0; j < 3; ++j)
        v_mean[j] = dot3(set1(viewmat[j]), set1(viewmat[4 + j]), set1(viewmat[8 + j]), v_cam[0], v_cam[1], v_cam[2]) +
                    v_from_center[j];
    scatter<3>(grads.means, b.id, lanes, v_mean);
    if (grads.means2d)
        scatter<2>(grads.means2d, b.id, lanes, v_mean2d);
    if (a.viewmat_partial)
        view_backward(s, viewmat, lanes, v_cam, v_world_rot, v_from_center, view_sums);
}

static void project_backward(const ProjectBackwardArgs &a, int64_t chunk) {
    const gs_splats &in = *a.forward.splats;
    const gs_view &view = *a.forward.view;
    const Limits limits(view);
    const int64_t begin = chunk * kChunk;
    const int visible = a.forward.visible[chunk];
    zero_culled_rows(a, begin, begin + kChunk < in.count ? begin + kChunk : in.count, visible);
    const Moments *const moments = a.moments + a.moment_begin[chunk];
    Vec view_sums[12] = {}; // 3 x 4 row-major
    Lanes s;
    Blended b;
    for (int first = 0; first < visible; first += kLanes) {
        for (int i = first + kLanes; i < first + 2 * kLanes && i < visible; ++i)
            fetch_coefficients(in, a.grads, a.forward.projected[begin + i].id);
        const int lanes = visible - first < kLanes ? visible - first : kLanes;
        read_blended(a, moments, begin + first, lanes, b);
        project_lanes(in, view, limits, b.id, s);
        lanes_backward(a, s, b, lanes, view_sums);
    }
    if (a.viewmat_partial) {
        float out[16] = {};
        lane_sums(view_sums, out);
        for (int k = 0; k < 16; ++k)
            a.viewmat_partial[chunk * 16 + k] = double(out[k]);
    }
}

} // namespace gs::GS_NAMESPACE
