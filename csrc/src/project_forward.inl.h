// Forward projection kernel: splats to screen, with colours of spherical harmonics.
#pragma once

#include "project.inl.h"
#include "sh.inl.h"

namespace gs::GS_NAMESPACE {

static void project(const ProjectArgs &a, int64_t chunk) {
    const gs_splats &in = *a.splats;
    const gs_view &view = *a.view;
    const Limits limits(view);
    const int64_t begin = chunk * kChunk;
    const int64_t end = begin + kChunk < in.count ? begin + kChunk : in.count;
    Projected *out = a.projected + begin;
    uint32_t *keys = a.depth_keys + begin;
    int visible = 0;
    Lanes s;
    for (int64_t i0 = begin; i0 < end; i0 += kLanes) {
        const int lanes = end - i0 < kLanes ? int(end - i0) : kLanes;
        uint32_t id[kLanes];
        for (int l = 0; l < kLanes; ++l)
            id[l] = uint32_t(l < lanes ? i0 + l : i0);
        if (a.radii)
            for (int l = 0; l < lanes; ++l)
                a.radii[i0 + l] = 0;
        Mask ok = project_lanes(in, view, limits, id, s);
        if (!bits(ok))
            continue;
        const Vec log2_opacity = log2(s.sigma_opacity);
        const Vec t = max(log2_opacity - GS_LOG2_ALPHA_MIN, Vec{}) * (1.0f / GS_HALF_LOG2E);
        const Vec ex = sqrt(t * s.cov_xx), ey = sqrt(t * s.cov_yy);
        ok = both(ok, both(ge(s.mean2d[0] + ex, set1(0.5f)), ge(set1(float(view.width) - 0.5f), s.mean2d[0] - ex)));
        ok = both(ok, both(ge(s.mean2d[1] + ey, set1(0.5f)), ge(set1(float(view.height) - 0.5f), s.mean2d[1] - ey)));
        uint32_t alive = bits(ok) & ((1u << lanes) - 1);
        if (!alive)
            continue;

        // Neighbours in memory are mostly neighbours in space: the next ones will be visible too.
        fetch_floats(in.shN, (i0 + kLanes) * 3 * in.sh_rest, end * 3 * in.sh_rest, kLanes * 3 * in.sh_rest);
        Row3 d;
        Vec length;
        direction(view, s, d, length);
        Vec color[3];
        sh_colors(in, view.sh_degree, id, alive, d.x, d.y, d.z, color);

        const Vec inv_yy = 1.0f / s.cov_yy;
        const Vec vc = sqrt(GS_HALF_LOG2E * inv_yy);
        const Vec ua = sqrt(GS_HALF_LOG2E * s.cov_yy / s.det);
        const Vec ub = -ua * s.cov_xy * inv_yy;
        const Vec extent = max(ex, ey);
        const Vec slope = s.cov_xy / s.cov_xx;
        const Vec half_chord = sqrt(s.det) / s.cov_xx;
        for (const Vec c : color)
            alive &= bits(ge(set1(GS_COLOR_MAX), c)); // NaN fails
        IVec ids;
        std::memcpy(&ids, id, sizeof ids);
        // In the form of `Projected`.
        const Vec columns[4][4] = {{s.mean2d[0], s.mean2d[1], ua, ub},
                                   {vc, log2_opacity, color[0], color[1]},
                                   {color[2], s.inverse_z, s.cam[2], ex},
                                   {ey, slope, half_chord, as_float(ids)}};
        Vec4 rows[4][kLanes];
        for (int k = 0; k < 4; ++k)
            rows_of_columns(columns[k], rows[k]);
        for (int l = 0; l < lanes; ++l) {
            if (!(alive >> l & 1))
                continue;
            for (int k = 0; k < 4; ++k)
                std::memcpy(reinterpret_cast<char *>(out + visible) + k * sizeof(Vec4), &rows[k][l], sizeof(Vec4));
            const float z = out[visible].channel[kChannelZ];
            uint32_t key; // z is positive, so its bits have the order of its values
            std::memcpy(&key, &z, sizeof key);
            keys[visible] = key;
            if (a.radii)
                a.radii[id[l]] = extent[l] < 1e9f ? int32_t(extent[l]) + 1 : 1000000000;
            ++visible;
        }
    }
    a.visible[chunk] = visible;
}

} // namespace gs::GS_NAMESPACE
