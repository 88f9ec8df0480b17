// Alpha blending of one tile, forward and backward (Kerbl et al. 2023, section 6).
// A tile belongs to one thread. Per splat only the pixel rows its ellipse reaches are visited, apart for each block of
// kLanes columns; sums over pixels stay in vector accumulators and are reduced once per (tile, splat).
#pragma once

#include "simd.h"
#include "types.h"

namespace gs::GS_NAMESPACE {

constexpr int kBlocks = kTile / kLanes;
constexpr uint32_t kLaneBits = (1u << kLanes) - 1;
// Records are fetched this many list entries ahead of their use.
constexpr uint32_t kPrefetch = 8;

// Rows the backward pass computes together, stage by stage: a row's chain of dependent operations is so long that
// out-of-order execution alone cannot keep the arithmetic units busy. The forward pass gains nothing from it.
constexpr int kBackwardRows = 4;

struct RowSpan {
    int first, end;
};

// The span widened to a multiple of kBackwardRows inside the tile. Rows added are below the alpha threshold or complete,
// so they contribute exactly nothing.
static inline RowSpan whole_steps(RowSpan span) {
    const int count = (span.end - span.first + kBackwardRows - 1) / kBackwardRows * kBackwardRows;
    const int first = span.first + count > kTile ? kTile - count : span.first;
    return {first, first + count};
}

// Rows of column block `block` in which the splat can reach its alpha threshold.
static inline RowSpan rows_of_block(RowRange rows, int block) {
    const auto span = [&](int half) { return RowSpan{rows.half[half] & 15, (rows.half[half] >> 4) + 1}; };
    if constexpr (kLanes == kTile) {
        const RowSpan a = span(0), b = span(1);
        if (rows.half[0] == kNoRows)
            return b;
        if (rows.half[1] == kNoRows)
            return a;
        return {a.first < b.first ? a.first : b.first, a.end > b.end ? a.end : b.end};
    } else {
        return span(block * kLanes / (kTile / 2));
    }
}

// What depends on the row alone: u = ux + ub_dy[row], alpha = exp2(lv[row] - u^2).
struct RowTable {
    alignas(64) float ub_dy[kTile], lv[kTile], dy[kTile];
};

static inline void fill_rows(RowTable &t, const Projected &p, float first_row_y) {
    for (int i = 0; i < kTile; i += kLanes) {
        const Vec dy = (iota() + (first_row_y + float(i))) - p.mean_y;
        const Vec v = p.vc * dy;
        store(t.dy + i, dy);
        store(t.ub_dy + i, p.ub * dy);
        store(t.lv + i, fnma(v, v, set1(p.log2_opacity)));
    }
}

// Alpha of `kRows` rows before the clamp, zero below the threshold. The one place that decides which splat reaches
// which pixel.
template <int kRows> static inline void unclamped_alpha(Vec ux, const float *ub_dy, const float *lv, Vec *alpha) {
    Vec q[kRows];
    for (int j = 0; j < kRows; ++j) {
        const Vec u = ux + ub_dy[j];
        q[j] = fnma(u, u, set1(lv[j]));
    }
    exp2<kRows>(q, alpha);
    for (int j = 0; j < kRows; ++j)
        alpha[j] = keep(ge(q[j], set1(kLog2AlphaMin)), alpha[j]);
}

template <int kChannels> static inline void channels_of(const Projected &p, uint32_t outputs, float *c) {
    c[0] = p.color[0];
    c[1] = p.color[1];
    c[2] = p.color[2];
    if constexpr (kChannels >= 4)
        c[3] = outputs & GS_OUT_INVERSE_DEPTH ? p.inverse_z : p.z;
    if constexpr (kChannels >= 5)
        c[4] = p.z;
}

template <int kChannels, bool kMedian>
static int64_t blend_tile(const BlendArgs &a, uint32_t outputs, uint32_t tile) {
    const int tile_x = int(tile) % a.tiles_x, tile_y = int(tile) / a.tiles_x;
    const int x0 = tile_x * kTile, y0 = tile_y * kTile;
    const int columns = a.width - x0 < kTile ? a.width - x0 : kTile;
    const int rows = a.height - y0 < kTile ? a.height - y0 : kTile;

    // With depths, alpha is summed: depths are divided by it, and 1 - T has lost the digits of faint pixels.
    constexpr bool kSumAlpha = kChannels >= 4;
    // One block, so that the inner loop addresses all of it from one pointer: transmittance, channels, and where needed
    // the sum of weights and the median depth.
    constexpr int kCover = 1 + kChannels, kMedianAt = kCover + kSumAlpha, kPlanes = kMedianAt + kMedian;
    alignas(64) float state[kPlanes][kTilePixels];
    uint32_t done[kBlocks][kTile];
    RowSpan live[kBlocks]; // rows of a block outside of which every pixel is complete
    float *final_trans = a.final_transmittance + size_t(tile) * kTilePixels;
    uint32_t *stop = a.stop_index + size_t(tile) * kTilePixels;
    uint8_t *stop_order = a.stop_order + size_t(tile) * kTilePixels;
    int stops = 0;

    int open = 0;
    std::memset(state, 0, sizeof state);
    for (int i = 0; i < kTilePixels; ++i) {
        const bool inside = i % kTile < columns && i / kTile < rows;
        state[0][i] = final_trans[i] = inside ? 1.0f : 0.0f;
        stop[i] = inside ? ~0u : 0u;
        open += inside;
    }
    for (int b = 0; b < kBlocks; ++b) {
        live[b] = {0, rows};
        for (int r = 0; r < kTile; ++r) {
            done[b][r] = 0;
            for (int l = 0; l < kLanes; ++l)
                done[b][r] |= uint32_t(state[0][r * kTile + b * kLanes + l] == 0.0f) << l;
        }
    }
    // The lanes `finished` of a row are complete before `entry`. `values` holds their transmittance before it, and its
    // weights and their transmittance after it, which become zero. Rare, hence kept out of the loop below.
    const auto complete = [&](int b, int r, uint32_t finished, uint32_t entry,
                              float (*values)[kLanes]) __attribute__((noinline)) {
        // Complete pixels hold a transmittance of zero, so the new ones are those not yet marked.
        const uint32_t fresh = finished & ~done[b][r];
        for (int l = 0; l < kLanes; ++l)
            if (fresh >> l & 1) {
                const int at = r * kTile + b * kLanes + l;
                final_trans[at] = values[0][l];
                stop[at] = entry;
                stop_order[stops++] = uint8_t(at);
                values[1][l] = values[2][l] = 0.0f;
                --open;
            }
        done[b][r] = finished;
        while (live[b].first < live[b].end && done[b][live[b].first] == kLaneBits)
            ++live[b].first;
        while (live[b].first < live[b].end && done[b][live[b].end - 1] == kLaneBits)
            --live[b].end;
    };

    const uint32_t begin = a.tile_begin[tile], end = a.tile_begin[tile + 1];
    const Vec first_x = iota() + (float(x0) + 0.5f);
    RowTable table;
    int64_t vectors = 0;
    for (uint32_t e = begin; e < end && open > 0; ++e) {
        if (e + kPrefetch < end)
            __builtin_prefetch(&a.projected[a.entries[e + kPrefetch].slot]);
        const Entry entry = a.entries[e];
        const Projected &p = a.projected[entry.slot];
        fill_rows(table, p, float(y0) + 0.5f);
        float c[kChannels];
        channels_of<kChannels>(p, outputs, c);
        for (int b = 0; b < kBlocks; ++b) {
            RowSpan span = rows_of_block(entry.rows, b);
            span.first = span.first > live[b].first ? span.first : live[b].first;
            span.end = span.end < live[b].end ? span.end : live[b].end;
            if (span.first >= span.end)
                continue;
            vectors += span.end - span.first;
            const Vec ux = p.ua * ((first_x + float(b * kLanes)) - p.mean_x);
            float *at = state[0] + span.first * kTile + b * kLanes;
            for (int r = span.first; r < span.end; ++r, at += kTile) {
                Vec alpha;
                unclamped_alpha<1>(ux, table.ub_dy + r, table.lv + r, &alpha);
                const Vec t = load(at);
                Vec w = min(alpha, set1(kAlphaMax)) * t;
                Vec next = t - w;
                const uint32_t finished = bits(ge(set1(kTransmittanceMin), next));
                if (finished != done[b][r]) [[unlikely]] {
                    alignas(64) float values[3][kLanes];
                    store(values[0], t);
                    store(values[1], w);
                    store(values[2], next);
                    complete(b, r, finished, e - begin, values);
                    w = load(values[1]);
                    next = load(values[2]);
                }
                store(at, next);
                for (int k = 0; k < kChannels; ++k) {
                    float *channel = at + (1 + k) * kTilePixels;
                    store(channel, fma(w, set1(c[k]), load(channel)));
                }
                if constexpr (kSumAlpha) {
                    float *cover = at + kCover * kTilePixels;
                    store(cover, load(cover) + w);
                }
                if constexpr (kMedian) {
                    // A splat leaves at least 1 - kAlphaMax, so none completes a pixel and crosses 0.5 at once.
                    const Mask crossed = both(gt(t, set1(0.5f)), ge(set1(0.5f), next));
                    float *median = at + kMedianAt * kTilePixels;
                    store(median, load(median) + keep(crossed, set1(p.z)));
                }
            }
        }
    }

    a.stop_count[tile] = uint16_t(stops);
    for (int r = 0; r < rows; ++r)
        for (int x = 0; x < columns; ++x) {
            const int at = r * kTile + x;
            if (stop[at] == ~0u)
                final_trans[at] = state[0][at];
            const float t = final_trans[at];
            const size_t pixel = size_t(y0 + r) * size_t(a.width) + size_t(x0 + x);
            for (int k = 0; k < 3; ++k)
                a.image.rgb[3 * pixel + k] = state[1 + k][at] + t * a.background[k];
            a.image.alpha[pixel] = kSumAlpha ? state[kCover][at] : 1.0f - t;
            if (kChannels >= 4 && outputs & GS_OUT_INVERSE_DEPTH)
                a.image.inverse_depth[pixel] = state[4][at];
            if (kChannels >= 4 && outputs & GS_OUT_DEPTH)
                a.image.depth[pixel] = state[kChannels][at];
            if constexpr (kMedian)
                a.image.median_depth[pixel] = state[kMedianAt][at];
        }
    return vectors * kLanes;
}

static int64_t blend(const BlendArgs &a, uint32_t outputs, uint32_t tile) {
    const int extra = bool(outputs & GS_OUT_INVERSE_DEPTH) + bool(outputs & GS_OUT_DEPTH);
    if (outputs & GS_OUT_MEDIAN_DEPTH)
        return extra == 0   ? blend_tile<3, true>(a, outputs, tile)
               : extra == 1 ? blend_tile<4, true>(a, outputs, tile)
                            : blend_tile<5, true>(a, outputs, tile);
    return extra == 0   ? blend_tile<3, false>(a, outputs, tile)
           : extra == 1 ? blend_tile<4, false>(a, outputs, tile)
                        : blend_tile<5, false>(a, outputs, tile);
}

// With C the colour a pixel shows from splat i on (background last) and c_i its own, C_i = alpha_i c_i + (1 - alpha_i)
// C_{i+1}; therefore dL/dalpha_i = T_i (c_i - C_{i+1}) . dL/dC. Walking back to front, `behind` is C_{i+1} . dL/dC and
// T_i = T_{i+1} / (1 - alpha_i). All quantities are relative to what remains behind, so distant splats keep precision.
template <int kChannels>
static int64_t blend_tile_backward(const BlendBackwardArgs &args, uint32_t outputs, uint32_t tile) {
    const BlendArgs &a = *args.forward;
    const uint32_t begin = a.tile_begin[tile], count = a.tile_begin[tile + 1] - begin;
    if (count == 0)
        return 0;
    Moments *moments = args.moments + begin;
    const int tile_x = int(tile) % a.tiles_x, tile_y = int(tile) / a.tiles_x;
    const int x0 = tile_x * kTile, y0 = tile_y * kTile;
    const int columns = a.width - x0 < kTile ? a.width - x0 : kTile;
    const int rows = a.height - y0 < kTile ? a.height - y0 : kTile;
    const float *final_trans = a.final_transmittance + size_t(tile) * kTilePixels;
    const uint32_t *stop = a.stop_index + size_t(tile) * kTilePixels;

    alignas(64) float v_color[kChannels][kTilePixels];
    alignas(64) float trans[kTilePixels], behind[kTilePixels], last[kTilePixels];
    std::memset(v_color, 0, sizeof v_color);
    std::memset(last, 0, sizeof last);
    const float *planes[2] = {nullptr, nullptr};
    if constexpr (kChannels >= 4)
        planes[0] = outputs & GS_OUT_INVERSE_DEPTH ? args.grads.inverse_depth : args.grads.depth;
    if constexpr (kChannels >= 5)
        planes[1] = args.grads.depth;
    bool any = false;
    for (int r = 0; r < rows; ++r)
        for (int x = 0; x < columns; ++x) {
            const int at = r * kTile + x;
            const size_t pixel = size_t(y0 + r) * size_t(a.width) + size_t(x0 + x);
            for (int k = 0; k < 3 && args.grads.rgb; ++k)
                v_color[k][at] = args.grads.rgb[3 * pixel + k];
            for (int k = 3; k < kChannels; ++k)
                if (planes[k - 3])
                    v_color[k][at] = planes[k - 3][pixel];
            last[at] = v_color[0][at] * a.background[0] + v_color[1][at] * a.background[1] +
                       v_color[2][at] * a.background[2] - (args.grads.alpha ? args.grads.alpha[pixel] : 0.0f);
            bool nonzero = last[at] != 0.0f;
            for (int k = 0; k < kChannels; ++k)
                nonzero |= v_color[k][at] != 0.0f;
            any |= nonzero;
        }
    if (!any && args.skip_zero_tiles) {
        std::memset(moments, 0, count * sizeof(Moments));
        return 0;
    }

    // Pixels that stopped early join when the walk reaches the splat before their stop: until then their transmittance
    // is held at zero, which makes every contribution vanish.
    const uint8_t *stop_order = a.stop_order + size_t(tile) * kTilePixels;
    int waiting = a.stop_count[tile];
    uint32_t start = waiting > 0 ? stop[stop_order[waiting - 1]] : 0;
    RowSpan live[kBlocks];
    for (int b = 0; b < kBlocks; ++b)
        live[b] = {kTile, 0};
    const auto wake = [&](int at) {
        trans[at] = final_trans[at];
        behind[at] = last[at];
        RowSpan &span = live[at % kTile / kLanes];
        const int r = at / kTile;
        span.first = r < span.first ? r : span.first;
        span.end = r + 1 > span.end ? r + 1 : span.end;
    };
    for (int i = 0; i < kTilePixels; ++i) {
        trans[i] = behind[i] = 0.0f;
        if (stop[i] == ~0u) {
            wake(i);
            start = count;
        }
    }
    std::memset(moments + start, 0, (count - start) * sizeof(Moments));

    const Vec first_x = iota() + (float(x0) + 0.5f);
    RowTable table;
    int64_t vectors = 0;
    for (uint32_t i = start; i-- > 0;) {
        while (waiting > 0 && stop[stop_order[waiting - 1]] > i)
            wake(stop_order[--waiting]);
        const uint32_t e = begin + i;
        if (i >= kPrefetch)
            __builtin_prefetch(&a.projected[a.entries[e - kPrefetch].slot]);
        const Entry entry = a.entries[e];
        const Projected &p = a.projected[entry.slot];
        fill_rows(table, p, float(y0) + 0.5f);
        float c[kChannels];
        channels_of<kChannels>(p, outputs, c);
        Vec sums[kMomentCount] = {};
        for (int b = 0; b < kBlocks; ++b) {
            RowSpan span = rows_of_block(entry.rows, b);
            span.first = span.first > live[b].first ? span.first : live[b].first;
            span.end = span.end < live[b].end ? span.end : live[b].end;
            if (span.first >= span.end)
                continue;
            vectors += span.end - span.first;
            const Vec dx = (first_x + float(b * kLanes)) - p.mean_x;
            const Vec ux = p.ua * dx;
            // dx does not change down the rows, so its powers are applied after the row loop.
            Vec g0 = {}, gy = {}, gyy = {}, v_c[kChannels] = {};
            span = whole_steps(span);
            for (int r = span.first; r < span.end; r += kBackwardRows) {
                const int at = r * kTile + b * kLanes;
                Vec raw[kBackwardRows], alpha[kBackwardRows], w[kBackwardRows], g[kBackwardRows];
                unclamped_alpha<kBackwardRows>(ux, table.ub_dy + r, table.lv + r, raw);
                for (int j = 0; j < kBackwardRows; ++j) {
                    alpha[j] = min(raw[j], set1(kAlphaMax));
                    const Vec t = load(trans + at + j * kTile) / (1.0f - alpha[j]);
                    store(trans + at + j * kTile, t);
                    w[j] = alpha[j] * t;
                }
                for (int j = 0; j < kBackwardRows; ++j) {
                    const int row_at = at + j * kTile;
                    Vec own = set1(c[0]) * load(v_color[0] + row_at);
                    for (int k = 1; k < kChannels; ++k)
                        own = fma(set1(c[k]), load(v_color[k] + row_at), own);
                    const Vec back = load(behind + row_at);
                    const Vec diff = own - back;
                    store(behind + row_at, fma(alpha[j], diff, back));
                    g[j] = keep(ge(set1(kAlphaMax), raw[j]), w[j] * diff);
                }
                for (int j = 0; j < kBackwardRows; ++j) {
                    const Vec dy = set1(table.dy[r + j]);
                    const Vec g_dy = g[j] * dy;
                    g0 += g[j];
                    gy += g_dy;
                    gyy = fma(g_dy, dy, gyy);
                    for (int k = 0; k < kChannels; ++k)
                        v_c[k] = fma(w[j], load(v_color[k] + at + j * kTile), v_c[k]);
                }
            }
            const Vec gx = g0 * dx;
            sums[kG] += g0;
            sums[kGx] += gx;
            sums[kGy] += gy;
            sums[kGxx] = fma(gx, dx, sums[kGxx]);
            sums[kGxy] = fma(gy, dx, sums[kGxy]);
            sums[kGyy] += gyy;
            sums[kRed] += v_c[0];
            sums[kGreen] += v_c[1];
            sums[kBlue] += v_c[2];
            if constexpr (kChannels == 4)
                sums[outputs & GS_OUT_INVERSE_DEPTH ? kInvZ : kZ] += v_c[3];
            if constexpr (kChannels == 5) {
                sums[kInvZ] += v_c[3];
                sums[kZ] += v_c[4];
            }
        }
        lane_sums(sums, kMomentCount, moments[i].v);
    }
    return vectors * kLanes;
}

static int64_t blend_backward(const BlendBackwardArgs &a, uint32_t outputs, uint32_t tile) {
    const int extra = bool(outputs & GS_OUT_INVERSE_DEPTH) + bool(outputs & GS_OUT_DEPTH);
    return extra == 0   ? blend_tile_backward<3>(a, outputs, tile)
           : extra == 1 ? blend_tile_backward<4>(a, outputs, tile)
                        : blend_tile_backward<5>(a, outputs, tile);
}

} // namespace gs::GS_NAMESPACE
