// Real spherical harmonics of degree 0 to 3: colours and their gradients.
// Signs and order are those of 3D Gaussian Splatting: bands in ascending order, within a band m = -l..l.
#pragma once

#include "simd.h"
#include "types.h"

namespace gs::GS_NAMESPACE {

constexpr int kShMax = 16;
// Largest gradient of a basis function that is passed on to the viewing direction.
constexpr float kSlopeMax = 1e30f;

// Constants: sqrt of rational multiples of 1/pi, see e.g. Sloan 2013, "Efficient spherical harmonic evaluation".
constexpr float kSh0 = 0.28209479177387814f;
constexpr float kSh1 = 0.48860251190291987f;
constexpr float kSh2[5] = {1.0925484305920792f, -1.0925484305920792f, 0.31539156525252005f, -1.0925484305920792f,
                           0.5462742152960396f};
constexpr float kSh3[7] = {-0.5900435899266435f, 2.890611442640554f, -0.4570457994644658f, 0.3731763325901154f,
                           -0.4570457994644658f, 1.445305721320277f, -0.5900435899266435f};

static inline int sh_count(int degree) { return (degree + 1) * (degree + 1); }

static inline void sh_basis(int degree, Vec x, Vec y, Vec z, Vec *b) {
    b[0] = set1(kSh0);
    if (degree < 1)
        return;
    b[1] = -kSh1 * y;
    b[2] = kSh1 * z;
    b[3] = -kSh1 * x;
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
}

// dL/d(x, y, z) given s[k] = dL/db[k].
static inline void sh_basis_backward(int degree, Vec x, Vec y, Vec z, const Vec *s, Vec *v) {
    v[0] = v[1] = v[2] = Vec{};
    if (degree < 1)
        return;
    v[0] = -kSh1 * s[3];
    v[1] = -kSh1 * s[1];
    v[2] = kSh1 * s[2];
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
}

// Reads or writes three floats as a vector of four; the fourth is only touched where it belongs to the same row.
static inline Vec4 load3(const float *p) { return Vec4{p[0], p[1], p[2], 0.0f}; }
static inline void store3(float *p, Vec4 v) {
    p[0] = v[0];
    p[1] = v[1];
    p[2] = v[2];
}

// colour = max(0, 0.5 + sum of b_k c_k) of the lanes in `alive`; NaN where that is not finite.
static inline void sh_colors(const gs_splats &in, const uint32_t *id, uint32_t alive, Vec x, Vec y, Vec z,
                             float color[3][kLanes]) {
    Vec b[kShMax] = {};
    sh_basis(in.sh_degree, x, y, z, b);
    alignas(64) float basis[kShMax][kLanes];
    const int rest = sh_count(in.sh_degree) - 1;
    for (int k = 0; k <= rest; ++k)
        store(basis[k], b[k]);
    for (int l = 0; l < kLanes; ++l) {
        if (!(alive >> l & 1))
            continue;
        const float *row = in.shN + size_t(id[l]) * size_t(in.sh_rest) * 3;
        Vec4 c = load3(in.sh0 + size_t(id[l]) * 3) * kSh0 + 0.5f;
        for (int k = 0; k < rest - 1; ++k)
            c += load<Vec4>(row + 3 * k) * basis[k + 1][l];
        if (rest > 0)
            c += load3(row + 3 * (rest - 1)) * basis[rest][l];
        for (int k = 0; k < 3; ++k)
            color[k][l] = c[k] > 0.0f ? c[k] : c[k] >= -3e38f ? 0.0f : __builtin_nanf("");
    }
}

// Writes gradients of the coefficients of the first `lanes` lanes and returns dL/d(x, y, z) of the unit direction.
static inline void sh_backward(const gs_splats &in, const gs_splat_grads &grads, const uint32_t *id, int lanes, Vec x,
                               Vec y, Vec z, const Vec v_color[3], Vec v_dir[3]) {
    Vec b[kShMax] = {};
    sh_basis(in.sh_degree, x, y, z, b);
    alignas(64) float basis[kShMax][kLanes], v_basis[kShMax][kLanes] = {}, v_rgb[3][kLanes];
    const int rest = sh_count(in.sh_degree) - 1;
    for (int k = 0; k <= rest; ++k)
        store(basis[k], b[k]);
    for (int k = 0; k < 3; ++k)
        store(v_rgb[k], v_color[k]);
    for (int l = 0; l < lanes; ++l) {
        const Vec4 g = {v_rgb[0][l], v_rgb[1][l], v_rgb[2][l], 0.0f};
        store3(grads.sh0 + size_t(id[l]) * 3, g * kSh0);
        const size_t row = size_t(id[l]) * size_t(in.sh_rest) * 3;
        for (int k = 0; k < rest; ++k) {
            const float *c = in.shN + row + 3 * k;
            v_basis[k + 1][l] = c[0] * g[0] + c[1] * g[1] + c[2] * g[2];
            const Vec4 v = g * basis[k + 1][l];
            float *const out = grads.shN + row + 3 * k;
            if (k < rest - 1) // the fourth float is overwritten by the next k, or has zero added to it
                store(out, grads.add_shN ? v + load<Vec4>(out) : v);
            else
                store3(out, grads.add_shN ? v + load3(out) : v);
        }
        if (rest < in.sh_rest && !grads.add_shN)
            std::memset(grads.shN + row + 3 * rest, 0, size_t(in.sh_rest - rest) * 3 * sizeof(float));
    }
    // Coefficients that all but overflow leave a colour alone where their basis function is zero, but not its slope:
    // such a slope is dropped, NaN failing the comparisons.
    const Vec most = set1(kSlopeMax);
    Vec s[kShMax];
    for (int k = 0; k <= rest; ++k) {
        s[k] = load(v_basis[k]);
        s[k] = keep(both(ge(most, s[k]), ge(s[k], -most)), s[k]);
    }
    sh_basis_backward(in.sh_degree, x, y, z, s, v_dir);
}

} // namespace gs::GS_NAMESPACE
