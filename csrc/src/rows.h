// Rows: transposes between rows of floats in memory, one row per lane, and vectors.
#pragma once

#include "simd.h"

namespace gs::GS_NAMESPACE {

#if defined(GS_ISA_AVX512) || defined(GS_ISA_AVX2)
// Transposes the 4 x 4 blocks in the same 128 bits of four vectors; its own inverse.
static inline void transpose_blocks(Vec v[4]) {
#if defined(GS_ISA_AVX512)
    const __m512d ab0 = (__m512d)_mm512_unpacklo_ps(v[0], v[1]), ab2 = (__m512d)_mm512_unpackhi_ps(v[0], v[1]);
    const __m512d cd0 = (__m512d)_mm512_unpacklo_ps(v[2], v[3]), cd2 = (__m512d)_mm512_unpackhi_ps(v[2], v[3]);
    v[0] = (Vec)_mm512_unpacklo_pd(ab0, cd0);
    v[1] = (Vec)_mm512_unpackhi_pd(ab0, cd0);
    v[2] = (Vec)_mm512_unpacklo_pd(ab2, cd2);
    v[3] = (Vec)_mm512_unpackhi_pd(ab2, cd2);
#else
    const __m256d ab0 = (__m256d)_mm256_unpacklo_ps(v[0], v[1]), ab2 = (__m256d)_mm256_unpackhi_ps(v[0], v[1]);
    const __m256d cd0 = (__m256d)_mm256_unpacklo_ps(v[2], v[3]), cd2 = (__m256d)_mm256_unpackhi_ps(v[2], v[3]);
    v[0] = (Vec)_mm256_unpacklo_pd(ab0, cd0);
    v[1] = (Vec)_mm256_unpackhi_pd(ab0, cd0);
    v[2] = (Vec)_mm256_unpacklo_pd(ab2, cd2);
    v[3] = (Vec)_mm256_unpackhi_pd(ab2, cd2);
#endif
}
#endif

// Loads four floats per lane: out[k][l] = row[l][at + k].
static inline void load_columns(const float *const row[kLanes], size_t at, Vec out[4]) {
#if defined(GS_ISA_AVX512)
    for (int r = 0; r < 4; ++r) {
        __m512 v = _mm512_castps128_ps512(_mm_loadu_ps(row[r] + at));
        v = _mm512_insertf32x4(v, _mm_loadu_ps(row[r + 4] + at), 1);
        v = _mm512_insertf32x4(v, _mm_loadu_ps(row[r + 8] + at), 2);
        out[r] = _mm512_insertf32x4(v, _mm_loadu_ps(row[r + 12] + at), 3);
    }
    transpose_blocks(out);
#elif defined(GS_ISA_AVX2)
    for (int r = 0; r < 4; ++r)
        out[r] =
            _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(row[r] + at)), _mm_loadu_ps(row[r + 4] + at), 1);
    transpose_blocks(out);
#else
    alignas(64) float columns[4][kLanes];
    for (int l = 0; l < kLanes; ++l)
        for (int k = 0; k < 4; ++k)
            columns[k][l] = row[l][at + size_t(k)];
    for (int k = 0; k < 4; ++k)
        out[k] = load(columns[k]);
#endif
}

// The inverse: out[l] becomes float l of columns[0], columns[1], columns[2] and columns[3].
static inline void rows_of_columns(const Vec columns[4], Vec4 out[kLanes]) {
#if defined(GS_ISA_AVX512) || defined(GS_ISA_AVX2)
    Vec v[4] = {columns[0], columns[1], columns[2], columns[3]};
    transpose_blocks(v);
    for (int r = 0; r < 4; ++r) {
        float lanes[kLanes];
        store(lanes, v[r]);
        for (int q = 0; q < kLanes / 4; ++q)
            out[4 * q + r] = load<Vec4>(lanes + 4 * q);
    }
#else
    for (int l = 0; l < kLanes; ++l)
        out[l] = Vec4{columns[0][l], columns[1][l], columns[2][l], columns[3][l]};
#endif
}

// `width` floats, 2 to 4, of the rows id[l] of an array of `rows`.
template <int width> static inline void gather(const float *base, int64_t rows, const uint32_t *id, Vec out[width]) {
    float end[4] = {};
    const float *row[kLanes];
    for (int l = 0; l < kLanes; ++l) {
        row[l] = base + size_t(id[l]) * size_t(width);
        if (width < 4 && int64_t(id[l]) + 1 == rows) { // other rows read into the next row
            std::memcpy(end, row[l], width * sizeof(float));
            row[l] = end;
        }
    }
    Vec four[4];
    load_columns(row, 0, four);
    for (int k = 0; k < width; ++k)
        out[k] = four[k];
}

// Writes `width` values, 2 to 4, of each of the first `lanes` lanes to the rows `id`.
template <int width> static inline void scatter(float *base, const uint32_t *id, int lanes, const Vec *v) {
    Vec columns[4] = {};
    for (int k = 0; k < width; ++k)
        columns[k] = v[k];
    Vec4 rows[kLanes];
    rows_of_columns(columns, rows);
    for (int l = 0; l < lanes; ++l)
        std::memcpy(base + size_t(id[l]) * size_t(width), &rows[l], width * sizeof(float));
}

static inline Vec gather_one(const float *base, const uint32_t *id) {
    alignas(64) float lane[kLanes];
    for (int l = 0; l < kLanes; ++l)
        lane[l] = base[id[l]];
    return load(lane);
}

static inline void scatter_one(float *base, const uint32_t *id, int lanes, Vec v) {
    alignas(64) float lane[kLanes];
    store(lane, v);
    for (int l = 0; l < lanes; ++l)
        base[id[l]] = lane[l];
}

// Prefetches `count` floats from `begin` on, up to `end`.
static inline void fetch_floats(const float *base, int64_t begin, int64_t end, int64_t count) {
    for (int64_t i = begin; i < begin + count && i < end; i += 16)
        __builtin_prefetch(base + i);
}

// Calls f(at) for groups of four floats that cover `count`, at least 4; the last group may overlap.
template <class F> static inline void by_four(int count, F f) {
    int at = 0;
    for (; at + 4 <= count; at += 4)
        f(at);
    if (at < count)
        f(count - 4);
}

} // namespace gs::GS_NAMESPACE
