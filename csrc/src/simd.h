// SIMD vectors of one instruction set: kLanes floats and a small set of operations.
// Each kernels_<isa>.cpp defines GS_ISA_<NAME> and the namespace it wants before including this.
// Arithmetic operators come from the compiler's vector types; fused multiply-add is always spelled out and automatic
// contraction is off, so forward and backward pass compute the same alpha to the last bit.
#pragma once

#include "../shared/constants.h"

#include <cstdint>
#include <cstring>

#if defined(GS_ISA_AVX2) || defined(GS_ISA_AVX512)
#include <immintrin.h>
#elif defined(GS_ISA_NEON)
#include <arm_neon.h>
#endif

// A part of a kernel that GCC and Clang, also clang-cl, always inline, so that its data stays in registers.
#define GS_INLINE static inline __attribute__((always_inline))

namespace gs::GS_NAMESPACE {

#if defined(GS_ISA_AVX512)
constexpr int kLanes = 16;
#elif defined(GS_ISA_AVX2)
constexpr int kLanes = 8;
#elif defined(GS_ISA_SCALAR) && defined(GS_SCALAR_LANES)
constexpr int kLanes = GS_SCALAR_LANES;
#else
constexpr int kLanes = 4;
#endif

typedef float Vec __attribute__((vector_size(4 * kLanes)));
typedef int32_t IVec __attribute__((vector_size(4 * kLanes)));
typedef double DVec __attribute__((vector_size(8 * kLanes)));
typedef float Vec4 __attribute__((vector_size(16)));

static inline Vec set1(float x) { return x - Vec{}; }
static inline DVec to_double(Vec v) { return __builtin_convertvector(v, DVec); }
static inline Vec to_float(DVec v) { return __builtin_convertvector(v, Vec); }
static inline DVec square_root(DVec v) {
    for (int i = 0; i < kLanes; ++i)
        v[i] = __builtin_sqrt(v[i]);
    return v;
}
static inline IVec as_int(Vec v) { return (IVec)v; }
static inline Vec as_float(IVec v) { return (Vec)v; }
// p times 2^n, with n in the low bits of `t`; unsigned, because signed overflow is undefined.
static inline Vec scale_by_power(Vec p, Vec t) {
    typedef uint32_t UVec __attribute__((vector_size(4 * kLanes)));
    return (Vec)((UVec)p + ((UVec)t << 23));
}

template <class V> static inline V load(const float *p) {
    V v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
static inline Vec load(const float *p) { return load<Vec>(p); }
template <class V> static inline void store(float *p, V v) { std::memcpy(p, &v, sizeof v); }

static inline Vec iota() {
    Vec v;
    for (int i = 0; i < kLanes; ++i)
        v[i] = float(i);
    return v;
}

#if defined(GS_ISA_AVX512)

typedef __mmask16 Mask;
static inline Vec fma(Vec a, Vec b, Vec c) { return _mm512_fmadd_ps(a, b, c); }
static inline Vec fnma(Vec a, Vec b, Vec c) { return _mm512_fnmadd_ps(a, b, c); }
static inline Vec min(Vec a, Vec b) { return _mm512_min_ps(a, b); }
static inline Vec max(Vec a, Vec b) { return _mm512_max_ps(a, b); }
static inline Vec sqrt(Vec a) { return _mm512_sqrt_ps(a); }
static inline Mask ge(Vec a, Vec b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
static inline Mask gt(Vec a, Vec b) { return _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ); }
static inline Mask gt_int(IVec a, IVec b) { return _mm512_cmpgt_epi32_mask((__m512i)a, (__m512i)b); }
static inline Mask both(Mask a, Mask b) { return Mask(a & b); }
static inline Vec keep(Mask m, Vec v) { return _mm512_maskz_mov_ps(m, v); }
static inline Vec select(Mask m, Vec a, Vec b) { return _mm512_mask_mov_ps(b, m, a); }
static inline uint32_t bits(Mask m) { return m; }

#elif defined(GS_ISA_AVX2)

typedef IVec Mask;
static inline Vec fma(Vec a, Vec b, Vec c) { return _mm256_fmadd_ps(a, b, c); }
static inline Vec fnma(Vec a, Vec b, Vec c) { return _mm256_fnmadd_ps(a, b, c); }
static inline Vec min(Vec a, Vec b) { return _mm256_min_ps(a, b); }
static inline Vec max(Vec a, Vec b) { return _mm256_max_ps(a, b); }
static inline Vec sqrt(Vec a) { return _mm256_sqrt_ps(a); }
static inline Mask ge(Vec a, Vec b) { return (IVec)_mm256_cmp_ps(a, b, _CMP_GE_OQ); }
static inline Mask gt(Vec a, Vec b) { return (IVec)_mm256_cmp_ps(a, b, _CMP_GT_OQ); }
static inline Mask gt_int(IVec a, IVec b) { return (IVec)(a > b); }
static inline Mask both(Mask a, Mask b) { return a & b; }
static inline Vec keep(Mask m, Vec v) { return (Vec)(m & (IVec)v); }
static inline Vec select(Mask m, Vec a, Vec b) { return _mm256_blendv_ps(b, a, (Vec)m); }
static inline uint32_t bits(Mask m) { return uint32_t(_mm256_movemask_ps((Vec)m)); }

#elif defined(GS_ISA_NEON)

typedef IVec Mask;
static inline Vec fma(Vec a, Vec b, Vec c) { return (Vec)vfmaq_f32((float32x4_t)c, (float32x4_t)a, (float32x4_t)b); }
static inline Vec fnma(Vec a, Vec b, Vec c) { return (Vec)vfmsq_f32((float32x4_t)c, (float32x4_t)a, (float32x4_t)b); }
static inline Vec min(Vec a, Vec b) { return (Vec)vminq_f32((float32x4_t)a, (float32x4_t)b); }
static inline Vec max(Vec a, Vec b) { return (Vec)vmaxq_f32((float32x4_t)a, (float32x4_t)b); }
static inline Vec sqrt(Vec a) { return (Vec)vsqrtq_f32((float32x4_t)a); }
static inline Mask ge(Vec a, Vec b) { return (IVec)(a >= b); }
static inline Mask gt(Vec a, Vec b) { return (IVec)(a > b); }
static inline Mask gt_int(IVec a, IVec b) { return (IVec)(a > b); }
static inline Mask both(Mask a, Mask b) { return a & b; }
static inline Vec keep(Mask m, Vec v) { return (Vec)(m & (IVec)v); }
static inline Vec select(Mask m, Vec a, Vec b) { return (Vec)((m & (IVec)a) | (~m & (IVec)b)); }
static inline uint32_t bits(Mask m) {
    const uint32_t weights[4] = {1, 2, 4, 8};
    return vaddvq_u32(vandq_u32((uint32x4_t)m, vld1q_u32(weights)));
}

#else

typedef IVec Mask;
static inline Vec fma(Vec a, Vec b, Vec c) { return a * b + c; }
static inline Vec fnma(Vec a, Vec b, Vec c) { return c - a * b; }
static inline Mask ge(Vec a, Vec b) { return (IVec)(a >= b); }
static inline Mask gt(Vec a, Vec b) { return (IVec)(a > b); }
static inline Mask gt_int(IVec a, IVec b) { return (IVec)(a > b); }
static inline Mask both(Mask a, Mask b) { return a & b; }
static inline Vec keep(Mask m, Vec v) { return (Vec)(m & (IVec)v); }
static inline Vec select(Mask m, Vec a, Vec b) { return (Vec)((m & (IVec)a) | (~m & (IVec)b)); }
static inline Vec min(Vec a, Vec b) { return select((IVec)(a < b), a, b); }
static inline Vec max(Vec a, Vec b) { return select((IVec)(a > b), a, b); }
static inline Vec sqrt(Vec a) {
    for (int i = 0; i < kLanes; ++i)
        a[i] = __builtin_sqrtf(a[i]);
    return a;
}
static inline uint32_t bits(Mask m) {
    uint32_t b = 0;
    for (int i = 0; i < kLanes; ++i)
        b |= uint32_t(m[i] & 1) << i;
    return b;
}

#endif

static inline IVec set1(int32_t x) { return x - IVec{}; }
static inline IVec load(const int32_t *p) {
    IVec v;
    std::memcpy(&v, p, sizeof v);
    return v;
}
static inline void store(int32_t *p, IVec v) { std::memcpy(p, &v, sizeof v); }
static inline IVec select(Mask m, IVec a, IVec b) { return as_int(select(m, as_float(a), as_float(b))); }

// c plus the products of two pairs of 16-bit numbers per lane, which are not negative.
static inline IVec add_products(IVec c, IVec a, IVec b) {
#if defined(GS_ISA_AVX512)
    return c + (IVec)_mm512_madd_epi16((__m512i)a, (__m512i)b);
#elif defined(GS_ISA_AVX2)
    return c + (IVec)_mm256_madd_epi16((__m256i)a, (__m256i)b);
#elif defined(GS_ISA_NEON)
    const int16x8_t x = (int16x8_t)a, y = (int16x8_t)b;
    return c + (IVec)vpaddq_s32(vmull_s16(vget_low_s16(x), vget_low_s16(y)), vmull_high_s16(x, y));
#else
    return c + (a & 0xffff) * (b & 0xffff) + (a >> 16) * (b >> 16);
#endif
}

// Gathers numbers of a table, one per lane.
static inline IVec gather(const uint32_t *table, IVec at) {
#if defined(GS_ISA_AVX512)
    return (IVec)_mm512_i32gather_epi32((__m512i)at, table, 4);
#elif defined(GS_ISA_AVX2)
    return (IVec)_mm256_i32gather_epi32((const int *)table, (__m256i)at, 4);
#else
    IVec v;
    for (int i = 0; i < kLanes; ++i)
        v[i] = int32_t(table[at[i]]);
    return v;
#endif
}
static inline Vec gather(const float *table, IVec at) {
#if defined(GS_ISA_AVX512)
    return _mm512_i32gather_ps((__m512i)at, table, 4);
#elif defined(GS_ISA_AVX2)
    return _mm256_i32gather_ps(table, (__m256i)at, 4);
#else
    Vec v;
    for (int i = 0; i < kLanes; ++i)
        v[i] = table[at[i]];
    return v;
#endif
}
static inline IVec to_int(Vec v) { return __builtin_convertvector(v, IVec); } // towards zero
static inline Vec to_float(IVec v) { return __builtin_convertvector(v, Vec); }

static inline Vec fma(Vec a, float b, Vec c) { return fma(a, set1(b), c); }
static inline Vec fma(float a, Vec b, Vec c) { return fma(set1(a), b, c); }

// x / y to float precision with few operations: an AVX-512 division takes as long as ten multiplications.
static inline Vec quotient(Vec x, Vec y) {
#if defined(GS_ISA_AVX512)
    const Vec r = _mm512_rcp14_ps(y);
    return x * fma(r, fnma(y, r, set1(1.0f)), r);
#else
    return x / y;
#endif
}

// Sums of the lanes of 12 vectors.
static inline void lane_sums(const Vec *v, float *out) {
#if defined(GS_ISA_AVX512)
    __m512 q[3]; // four sums, separate for each quarter
    for (int i = 0; i < 3; ++i) {
        const __m512 *x = (const __m512 *)v + 4 * i;
        const __m512d ab = (__m512d)_mm512_add_ps(_mm512_unpacklo_ps(x[0], x[1]), _mm512_unpackhi_ps(x[0], x[1]));
        const __m512d cd = (__m512d)_mm512_add_ps(_mm512_unpacklo_ps(x[2], x[3]), _mm512_unpackhi_ps(x[2], x[3]));
        q[i] = _mm512_add_ps((__m512)_mm512_unpacklo_pd(ab, cd), (__m512)_mm512_unpackhi_pd(ab, cd));
    }
    const __m512 h01 = _mm512_add_ps(_mm512_shuffle_f32x4(q[0], q[1], 0x88), _mm512_shuffle_f32x4(q[0], q[1], 0xdd));
    const __m512 h2 = _mm512_add_ps(_mm512_shuffle_f32x4(q[2], q[2], 0x88), _mm512_shuffle_f32x4(q[2], q[2], 0xdd));
    const __m512 s = _mm512_add_ps(_mm512_shuffle_f32x4(h01, h2, 0x88), _mm512_shuffle_f32x4(h01, h2, 0xdd));
    _mm512_mask_storeu_ps(out, 0xfff, s);
#elif defined(GS_ISA_AVX2)
    for (int i = 0; i < 12; i += 4) {
        const __m256 s = _mm256_hadd_ps(_mm256_hadd_ps(v[i], v[i + 1]), _mm256_hadd_ps(v[i + 2], v[i + 3]));
        _mm_storeu_ps(out + i, _mm_add_ps(_mm256_castps256_ps128(s), _mm256_extractf128_ps(s, 1)));
    }
#else
    for (int i = 0; i < 12; ++i) {
        alignas(64) float lane[kLanes];
        store(lane, v[i]);
        for (int n = kLanes / 2; n > 0; n /= 2)
            for (int l = 0; l < n; ++l)
                lane[l] += lane[l + n];
        out[i] = lane[0];
    }
#endif
}

// Degree of the polynomial for 2^x: 3, 4, 5 or 6, see GS_EXP2_5.
#ifndef GS_EXP_DEGREE
#define GS_EXP_DEGREE 5
#endif
#define GS_PASTE(a, b) a##b
#define GS_EXP2(degree) GS_PASTE(GS_EXP2_, degree)
constexpr float kExp2Poly[] = {GS_EXP2(GS_EXP_DEGREE)};

// 2^x of `count` vectors, stage by stage, zero where x < lowest, for x <= 127 and lowest >= -126; relative error 2.2e-7.
template <int count> static inline void exp2_above(float lowest, const Vec *x, Vec *out) {
    Vec t[count], f[count], p[count];
    for (int j = 0; j < count; ++j) {
#if defined(GS_ISA_AVX512)
        f[j] = _mm512_reduce_ps(x[j], 0); // x less the nearest integer
        t[j] = x[j] - f[j];
#else
        const Vec magic = set1(12582912.0f); // 1.5 * 2^23: adding it rounds to an integer kept in the low mantissa bits
        t[j] = x[j] + magic;
        f[j] = x[j] - (t[j] - magic);
#endif
        p[j] = set1(kExp2Poly[0]);
    }
    for (int k = 1; k <= GS_EXP_DEGREE; ++k)
        for (int j = 0; j < count; ++j)
            p[j] = fma(p[j], f[j], set1(kExp2Poly[k]));
    for (int j = 0; j < count; ++j) {
        const Mask reached = ge(x[j], set1(lowest));
#if defined(GS_ISA_AVX512)
        out[j] = _mm512_maskz_scalef_ps(reached, p[j], t[j]);
#else
        out[j] = keep(reached, scale_by_power(p[j], t[j]));
#endif
    }
}

// e^x, relative error below 4e-7; x is clamped to [-87, 88].
static inline Vec exp(Vec x) {
    x = min(max(x, set1(-87.0f)), set1(88.0f));
    const Vec magic = set1(12582912.0f);
    const Vec t = fma(x, set1(1.44269504f), magic);
    const Vec n = t - magic;
    // x log2(e) - n in two parts, so that large |x| keep their fraction.
    const Vec f = fma(x, set1(1.92596303e-8f), fma(x, set1(1.44269502162933349609375f), -n));
    constexpr float c[] = {GS_EXP2_5};
    Vec p = fma(set1(c[0]), f, set1(c[1]));
    p = fma(p, f, set1(c[2]));
    p = fma(p, f, set1(c[3]));
    p = fma(p, f, set1(c[4]));
    p = fma(p, f, set1(c[5]));
    return scale_by_power(p, t);
}

// log2(x) for normal positive x: x = m 2^e with m in [sqrt(1/2), sqrt(2)), then 2 atanh((m - 1) / (m + 1)) / ln 2.
static inline Vec log2(Vec x) {
    const IVec shifted = as_int(x) - 0x3f3504f3;
    const IVec e = shifted >> 23;
    const Vec m = as_float((shifted & 0x007fffff) + 0x3f3504f3);
    const Vec f = (m - 1.0f) / (m + 1.0f);
    const Vec f2 = f * f;
    Vec p = set1(2.885390082f / 9);
    p = fma(p, f2, set1(2.885390082f / 7));
    p = fma(p, f2, set1(2.885390082f / 5));
    p = fma(p, f2, set1(2.885390082f / 3));
    p = fma(p, f2, set1(2.885390082f));
    return fma(p, f, __builtin_convertvector(e, Vec));
}

} // namespace gs::GS_NAMESPACE
