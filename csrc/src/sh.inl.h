// Spherical harmonics kernel: real SH of degree 0 to 4: colours and their gradients.
// Signs and order are those of 3D Gaussian Splatting: bands in ascending order, within a band m = -l..l.
#pragma once

#include "raster_types.h"
#include "rows.h"
#include "simd.h"

namespace gs::GS_NAMESPACE {

// Maximum gradient of a basis function passed to the view direction.
constexpr float kSlopeMax = 1e30f;

constexpr float kSh2[5] = {GS_SH_C2}, kSh3[7] = {GS_SH_C3}, kSh4[9] = {GS_SH_C4};

static constexpr int sh_count(int degree) { return (degree + 1) * (degree + 1); }

// The nine functions of degree 4.
static inline void sh_basis_4(Vec x, Vec y, Vec z, Vec *b) {
    const Vec xx = x * x, yy = y * y, zz = z * z;
    const Vec rr = xx + yy, p = 4.0f * zz - 3.0f * rr, q = 6.0f * zz - rr, d = xx - yy;
    b[0] = kSh4[0] * (x * y) * d;
    b[1] = kSh4[1] * (y * z) * (3.0f * xx - yy);
    b[2] = kSh4[2] * (x * y) * q;
    b[3] = kSh4[3] * (y * z) * p;
    b[4] = kSh4[4] * (8.0f * zz * (zz - 3.0f * rr) + 3.0f * rr * rr);
    b[5] = kSh4[5] * (x * z) * p;
    b[6] = kSh4[6] * d * q;
    b[7] = kSh4[7] * (x * z) * (xx - 3.0f * yy);
    b[8] = kSh4[8] * (xx * (xx - 6.0f * yy) + yy * yy);
}

// Adds dL/d(x, y, z) given s[k] = dL/db[k] of the functions of degree 4.
static inline void sh_basis_4_backward(Vec x, Vec y, Vec z, const Vec *s, Vec *v) {
    const Vec xx = x * x, yy = y * y, zz = z * z;
    const Vec rr = xx + yy, p = 4.0f * zz - 3.0f * rr, q = 6.0f * zz - rr, d = xx - yy;
    Vec c[9];
    for (int k = 0; k < 9; ++k)
        c[k] = kSh4[k] * s[k];
    const Vec e = 4.0f * c[4] * (3.0f * rr - 12.0f * zz);
    v[0] += c[0] * y * (3.0f * xx - yy) + 6.0f * c[1] * x * y * z + c[2] * y * (q - 2.0f * xx) -
            6.0f * c[3] * x * y * z + e * x + c[5] * z * (p - 6.0f * xx) + 2.0f * c[6] * x * (q - d) +
            3.0f * c[7] * z * d + 4.0f * c[8] * x * (xx - 3.0f * yy);
    v[1] += c[0] * x * (xx - 3.0f * yy) + 3.0f * c[1] * z * d + c[2] * x * (q - 2.0f * yy) +
            c[3] * z * (p - 6.0f * yy) + e * y - 6.0f * c[5] * x * y * z - 2.0f * c[6] * y * (q + d) -
            6.0f * c[7] * x * y * z + 4.0f * c[8] * y * (yy - 3.0f * xx);
    v[2] += c[1] * y * (3.0f * xx - yy) + 12.0f * c[2] * x * y * z + c[3] * y * (p + 8.0f * zz) +
            16.0f * c[4] * z * (2.0f * zz - 3.0f * rr) + c[5] * x * (p + 8.0f * zz) + 12.0f * c[6] * d * z +
            c[7] * x * (xx - 3.0f * yy);
}

template <int kMost> static inline void sh_basis(int degree, Vec x, Vec y, Vec z, Vec *b) {
    b[0] = set1(GS_SH_C0);
    if (degree < 1)
        return;
    b[1] = -GS_SH_C1 * y;
    b[2] = GS_SH_C1 * z;
    b[3] = -GS_SH_C1 * x;
    if (degree < 2)
        return;
    const Vec xx = x * x, yy = y * y, zz = z * z;
    b[4] = kSh2[0] * (x * y);
    b[5] = kSh2[1] * (y * z);
    b[6] = kSh2[2] * (2.0f * zz - xx - yy);
    b[7] = kSh2[3] * (x * z);
    b[8] = kSh2[4] * (xx - yy);
    if (degree < 3)
        return;
    b[9] = kSh3[0] * y * (3.0f * xx - yy);
    b[10] = kSh3[1] * (x * y) * z;
    b[11] = kSh3[2] * y * (4.0f * zz - xx - yy);
    b[12] = kSh3[3] * z * (2.0f * zz - 3.0f * xx - 3.0f * yy);
    b[13] = kSh3[4] * x * (4.0f * zz - xx - yy);
    b[14] = kSh3[5] * z * (xx - yy);
    b[15] = kSh3[6] * x * (xx - 3.0f * yy);
    if (kMost >= 4 && degree >= 4)
        sh_basis_4(x, y, z, b + 16);
}

// dL/d(x, y, z) given s[k] = dL/db[k].
template <int kMost> static inline void sh_basis_backward(int degree, Vec x, Vec y, Vec z, const Vec *s, Vec *v) {
    v[0] = v[1] = v[2] = Vec{};
    if (degree < 1)
        return;
    v[0] = -GS_SH_C1 * s[3];
    v[1] = -GS_SH_C1 * s[1];
    v[2] = GS_SH_C1 * s[2];
    if (degree < 2)
        return;
    const Vec a4 = kSh2[0] * s[4], a5 = kSh2[1] * s[5], a6 = kSh2[2] * s[6], a7 = kSh2[3] * s[7], a8 = kSh2[4] * s[8];
    v[0] += a4 * y - 2.0f * a6 * x + a7 * z + 2.0f * a8 * x;
    v[1] += a4 * x + a5 * z - 2.0f * a6 * y - 2.0f * a8 * y;
    v[2] += a5 * y + 4.0f * a6 * z + a7 * x;
    if (degree < 3)
        return;
    const Vec xx = x * x, yy = y * y, zz = z * z;
    const Vec c9 = kSh3[0] * s[9], c10 = kSh3[1] * s[10], c11 = kSh3[2] * s[11], c12 = kSh3[3] * s[12];
    const Vec c13 = kSh3[4] * s[13], c14 = kSh3[5] * s[14], c15 = kSh3[6] * s[15];
    v[0] += 6.0f * c9 * x * y + c10 * y * z - 2.0f * c11 * x * y - 6.0f * c12 * x * z +
            c13 * (4.0f * zz - 3.0f * xx - yy) + 2.0f * c14 * x * z + 3.0f * c15 * (xx - yy);
    v[1] += 3.0f * c9 * (xx - yy) + c10 * x * z + c11 * (4.0f * zz - xx - 3.0f * yy) - 6.0f * c12 * y * z -
            2.0f * c13 * x * y - 2.0f * c14 * y * z - 6.0f * c15 * x * y;
    v[2] += c10 * x * y + 8.0f * c11 * y * z + c12 * (6.0f * zz - 3.0f * xx - 3.0f * yy) + 8.0f * c13 * x * z +
            c14 * (xx - yy);
    if (kMost >= 4 && degree >= 4)
        sh_basis_4_backward(x, y, z, s + 16, v);
}

// Rows of the higher coefficients; lanes not in `alive` repeat one of them.
static inline void coefficient_rows(const gs_splats &in, const uint32_t *id, uint32_t alive, const float *row[kLanes]) {
    const int some = __builtin_ctz(alive);
    for (int l = 0; l < kLanes; ++l)
        row[l] = in.shN + size_t(id[alive >> l & 1 ? l : some]) * size_t(in.sh_rest) * 3;
}

// colour = max(0, 0.5 + sum of b_k c_k) of the lanes in `alive`, which is not empty; NaN if that is not finite.
template <int kMost>
static inline void sh_colors_of(const gs_splats &in, int degree, const uint32_t *id, uint32_t alive, Vec x, Vec y,
                                Vec z, Vec color[3]) {
    constexpr int kMax = sh_count(kMost);
    Vec b[kMax] = {};
    sh_basis<kMost>(degree, x, y, z, b);
    const int rest = sh_count(degree) - 1;
    gather<3>(in.sh0, in.count, id, color);
    for (int c = 0; c < 3; ++c)
        color[c] = color[c] * GS_SH_C0 + 0.5f;
    if (rest > 0) {
        const float *row[kLanes];
        coefficient_rows(in, id, alive, row);
        Vec coefficients[3 * kMax];
        by_four(3 * rest, [&](int at) { load_columns(row, size_t(at), coefficients + at); });
        for (int k = 0; k < rest; ++k)
            for (int c = 0; c < 3; ++c)
                color[c] += coefficients[3 * k + c] * b[k + 1];
    }
    for (int c = 0; c < 3; ++c)
        color[c] =
            select(gt(color[c], Vec{}), color[c], select(ge(color[c], set1(-3e38f)), Vec{}, set1(__builtin_nanf(""))));
}

// Degree 4 is separate and not inlined, so that the usual lower degrees do not pay for its registers.
static __attribute__((noinline)) void sh_colors_4(const gs_splats &in, int degree, const uint32_t *id, uint32_t alive,
                                                  Vec x, Vec y, Vec z, Vec color[3]) {
    sh_colors_of<4>(in, degree, id, alive, x, y, z, color);
}

static inline void sh_colors(const gs_splats &in, int degree, const uint32_t *id, uint32_t alive, Vec x, Vec y, Vec z,
                             Vec color[3]) {
    if (degree > 3)
        sh_colors_4(in, degree, id, alive, x, y, z, color);
    else
        sh_colors_of<3>(in, degree, id, alive, x, y, z, color);
}

// Prefetches the data of a row for `sh_backward`, which accesses pieces of many rows at a time, a pattern that hardware
// prefetchers do not recognise.
static inline void fetch_coefficients(const gs_splats &in, const gs_splat_grads &grads, uint32_t id) {
    const size_t row = size_t(id) * size_t(in.sh_rest) * 3;
    for (int i = 0; i < 3 * in.sh_rest; i += 16) {
        __builtin_prefetch(in.shN + row + i);
        __builtin_prefetch(grads.shN + row + i, 1);
    }
}

// Writes gradients of the coefficients of the first `lanes` lanes and returns dL/d(x, y, z) of the unit direction.
template <int kMost>
static inline void sh_backward_of(const gs_splats &in, int degree, const gs_splat_grads &grads, const uint32_t *id,
                                  int lanes, Vec x, Vec y, Vec z, const Vec v_color[3], Vec v_dir[3]) {
    constexpr int kMax = sh_count(kMost);
    Vec b[kMax] = {}, s[kMax] = {};
    sh_basis<kMost>(degree, x, y, z, b);
    const int rest = sh_count(degree) - 1;
    const Vec v_sh0[3] = {v_color[0] * GS_SH_C0, v_color[1] * GS_SH_C0, v_color[2] * GS_SH_C0};
    scatter<3>(grads.sh0, id, lanes, v_sh0);
    if (rest > 0) {
        const float *row[kLanes];
        coefficient_rows(in, id, (1u << lanes) - 1, row);
        Vec coefficients[3 * kMax], gradients[3 * kMax];
        by_four(3 * rest, [&](int at) { load_columns(row, size_t(at), coefficients + at); });
        for (int k = 0; k < rest; ++k) {
            const Vec *const c = coefficients + 3 * k;
            s[k + 1] = c[0] * v_color[0] + c[1] * v_color[1] + c[2] * v_color[2];
            for (int i = 0; i < 3; ++i)
                gradients[3 * k + i] = v_color[i] * b[k + 1];
        }
        int written = 0;
        by_four(3 * rest, [&](int at) {
            if (grads.add_shN)
                for (int i = at; i < written; ++i)
                    gradients[i] = Vec{}; // already added
            written = at + 4;
            Vec4 rows[kLanes];
            rows_of_columns(gradients + at, rows);
            for (int l = 0; l < lanes; ++l) {
                float *const out = grads.shN + (row[l] - in.shN) + at;
                store(out, grads.add_shN ? rows[l] + load<Vec4>(out) : rows[l]);
            }
        });
    }
    if (rest < in.sh_rest && !grads.add_shN)
        for (int l = 0; l < lanes; ++l)
            std::memset(grads.shN + (size_t(id[l]) * size_t(in.sh_rest) + size_t(rest)) * 3, 0,
                        size_t(in.sh_rest - rest) * 3 * sizeof(float));
    // Coefficients close to overflow do not affect a colour where their basis function is zero, but its slope: such a
    // slope is dropped; NaN fails the comparisons.
    const Vec most = set1(kSlopeMax);
    for (int k = 1; k <= rest; ++k)
        s[k] = keep(both(ge(most, s[k]), ge(s[k], -most)), s[k]);
    sh_basis_backward<kMost>(degree, x, y, z, s, v_dir);
}

static __attribute__((noinline)) void sh_backward_4(const gs_splats &in, int degree, const gs_splat_grads &grads,
                                                    const uint32_t *id, int lanes, Vec x, Vec y, Vec z,
                                                    const Vec v_color[3], Vec v_dir[3]) {
    sh_backward_of<4>(in, degree, grads, id, lanes, x, y, z, v_color, v_dir);
}

static inline void sh_backward(const gs_splats &in, int degree, const gs_splat_grads &grads, const uint32_t *id,
                               int lanes, Vec x, Vec y, Vec z, const Vec v_color[3], Vec v_dir[3]) {
    if (degree > 3)
        sh_backward_4(in, degree, grads, id, lanes, x, y, z, v_color, v_dir);
    else
        sh_backward_of<3>(in, degree, grads, id, lanes, x, y, z, v_color, v_dir);
}

} // namespace gs::GS_NAMESPACE
