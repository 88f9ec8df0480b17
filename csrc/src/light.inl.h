// Light kernels: radiance of surfaces under lamps with shadow maps, and colours of splats under it.
#pragma once

#include "light.h"
#include "rows.h"
#include "sh.inl.h"
#include "simd.h"

#include <cmath>

namespace gs::GS_NAMESPACE {

// Vectors of lanes.
struct Light3 {
    Vec x, y, z;
};

GS_INLINE Vec light_dot(const float *row, const Light3 &v) { return fma(v.z, row[2], fma(v.y, row[1], v.x * row[0])); }

GS_INLINE Light3 light_turn(const float *matrix, const Light3 &v) {
    return {light_dot(matrix, v), light_dot(matrix + 3, v), light_dot(matrix + 6, v)};
}

// 1 where a pixel's mesh is not in front of `most`, else 0.
GS_INLINE Vec light_passes(const float *depths, IVec pixel, Vec most) {
    return keep(ge(most, gather(depths, pixel)), set1(1.0f));
}

// The view of a map that shows each lane, and the places in its axes.
GS_INLINE IVec light_view(const gs_shadow_map &map, const Light3 &away, Light3 &seen) {
    if (map.views == 1) {
        seen = light_turn(map.rotations, away);
        return IVec{};
    }
    const Vec x = max(away.x, -away.x), y = max(away.y, -away.y), z = max(away.z, -away.z);
    const Mask along_y = gt(y, x), along_z = gt(z, max(x, y));
    const Vec ahead = select(along_z, away.z, select(along_y, away.y, away.x));
    const Mask back = gt(Vec{}, ahead);
    const Vec other = select(along_z, -away.y, select(along_y, away.z, -away.z));
    seen.x = select(back, -other, other);
    seen.y = select(along_z, away.x, select(along_y, away.x, away.y));
    seen.z = select(back, -ahead, ahead);
    const IVec first = select(along_z, set1(4), select(along_y, set1(2), IVec{}));
    return first + select(back, set1(1), IVec{});
}

// Places in a map: pixel coordinates with integers at centres, the depth from which on meshes are in front, and z.
struct LightSeen {
    IVec view;
    Vec x, y, most, z;
};

GS_INLINE LightSeen light_seen(const gs_shadow_map &map, const Light3 &at, float slack) {
    Light3 seen = {};
    const IVec view = light_view(map, {at.x - map.place[0], at.y - map.place[1], at.z - map.place[2]}, seen);
    const Vec before = seen.z - slack;
    const Vec scale = map.parallel ? set1(map.scale) : map.scale / max(seen.z, set1(1e-9f));
    // Beyond all meshes as seen from a sun, each of them is in front.
    const Vec most = map.parallel ? max(map.farthest - before, Vec{}) : 1.0f / max(before, set1(1e-30f));
    const float middle = 0.5f * float(map.size) - 0.5f;
    return {view, scale * seen.x + middle, scale * seen.y + middle, most, seen.z};
}

// Share of a point, or a direction, that reaches places.
static Vec light_reaching(const gs_shadow_map &map, const Light3 &at, float slack) {
    const auto [view, x, y, most, z] = light_seen(map, at, slack);
    const Vec end = set1(float(map.size - 1));
    const Mask inside = both(both(both(ge(x, Vec{}), gt(end, x)), both(ge(y, Vec{}), gt(end, y))), gt(z, Vec{}));
    if (!bits(inside))
        return set1(1.0f);
    const Vec cx = keep(inside, x), cy = keep(inside, y);
    const IVec left = to_int(cx), top = to_int(cy);
    const IVec pixel = (view * map.size + top) * map.size + left;
    const Vec u = cx - to_float(left), v = cy - to_float(top);
    Vec rows[2];
    for (int k = 0; k < 2; ++k) {
        const IVec first = pixel + k * map.size;
        const Vec near = light_passes(map.depths, first, most), far = light_passes(map.depths, first + 1, most);
        rows[k] = fma(u, far - near, near);
    }
    return select(inside, fma(v, rows[1] - rows[0], rows[0]), set1(1.0f));
}

// Samples of the search for meshes in front, and of a soft shadow.
constexpr int kLightSearch = 16, kLightSoft = 24;
// The search of each of so many splats is turned otherwise, so that its samples make no edges.
constexpr int kLightTurns = 16;
static_assert(kLightTurns % kLanes == 0, "lanes have turns next to each other");
// Least cosine at which a disc around a surface is turned into its plane.
constexpr float kLightGrazing = 0.2f;

// Points of a disc of radius 1 on a spiral by the golden angle (Vogel 1979); in the search denser in the middle, because
// meshes close to the surface blur little.
struct LightDiscs {
    float search[kLightSearch][3], soft[kLightSoft][2]; // x, y; and the distance from the middle
    float turns[2][kLightTurns];                        // cosines and sines of turns of the search

    LightDiscs() {
        for (int i = 0; i < kLightTurns; ++i) {
            turns[0][i] = float(std::cos(2.399963229728653 * i));
            turns[1][i] = float(std::sin(2.399963229728653 * i));
        }
        for (int i = 0; i < kLightSearch; ++i) {
            const double t = (i + 0.5) / kLightSearch, turn = 2.399963229728653 * i;
            search[i][0] = float(t * t * std::cos(turn));
            search[i][1] = float(t * t * std::sin(turn));
            search[i][2] = float(t * t);
        }
        for (int i = 0; i < kLightSoft; ++i) {
            const double t = std::sqrt((i + 0.5) / kLightSoft), turn = 2.399963229728653 * i;
            soft[i][0] = float(t * std::cos(turn));
            soft[i][1] = float(t * std::sin(turn));
        }
    }
};

// Surfaces in the light of a lamp with a size: a place, and two vectors in their plane that are, seen from the lamp,
// perpendicular and 1 long.
struct LightPlane {
    Light3 at, a, b;

    LightPlane(const gs_shadow_map &map, const Light3 &place, const Light3 &normal) : at(place) {
        const float *const axis = map.rotations + 6;
        Light3 d = {set1(axis[0]), set1(axis[1]), set1(axis[2])};
        if (!map.parallel) {
            d = {at.x - map.place[0], at.y - map.place[1], at.z - map.place[2]};
            const Vec per = 1.0f / sqrt(max(light_dot3(d, d), set1(1e-30f)));
            d = {d.x * per, d.y * per, d.z * per};
        }
        // Duff et al. 2017, "Building an orthonormal basis, revisited".
        const Vec sign = select(ge(d.z, Vec{}), set1(1.0f), set1(-1.0f));
        const Vec p = -1.0f / (sign + d.z), q = d.x * d.y * p;
        const Vec per = 1.0f / min(light_dot3(normal, d), set1(-kLightGrazing));
        a = slid({1.0f + sign * d.x * d.x * p, sign * q, -sign * d.x}, d, normal, per);
        b = slid({q, sign + d.y * d.y * p, -d.y}, d, normal, per);
    }

    Light3 point(Vec x, Vec y) const {
        return {fma(b.x, y, fma(a.x, x, at.x)), fma(b.y, y, fma(a.y, x, at.y)), fma(b.z, y, fma(a.z, x, at.z))};
    }

  private:
    static Vec light_dot3(const Light3 &v, const Light3 &w) { return fma(v.z, w.z, fma(v.y, w.y, v.x * w.x)); }
    static Light3 slid(const Light3 &v, const Light3 &d, const Light3 &normal, Vec per) {
        const Vec along = light_dot3(normal, v) * per;
        return {v.x - d.x * along, v.y - d.y * along, v.z - d.z * along};
    }
};

// Radius, at a surface, of the blur of meshes of some depths.
GS_INLINE Vec light_blur(const gs_shadow_map &map, float size, Vec z, Vec depth) {
    return size * (map.parallel ? depth - (map.farthest - z) : z * depth - 1.0f);
}

// Mean radius of the blur by meshes in front that hide a part of the lamp; 0 without any.
static Vec light_blur_of(const gs_shadow_map &map, const LightPlane &plane, const LightDiscs &discs, float slack,
                         float size, int64_t row) {
    const Vec cosine = load(discs.turns[0] + row % kLightTurns), sine = load(discs.turns[1] + row % kLightTurns);
    const Vec z = light_seen(map, plane.at, slack).z;
    const Vec reach = min(max(light_blur(map, size, z, set1(map.nearest)), Vec{}), z);
    const Vec end = set1(float(map.size) - 0.5f);
    Vec sum = {}, count = {};
    for (const auto &point : discs.search) {
        const Vec x = cosine * point[0] - sine * point[1], y = sine * point[0] + cosine * point[1];
        const LightSeen seen = light_seen(map, plane.point(reach * x, reach * y), slack);
        const Mask inside =
            both(both(both(ge(seen.x, set1(-0.5f)), gt(end, seen.x)), both(ge(seen.y, set1(-0.5f)), gt(end, seen.y))),
                 gt(seen.z, Vec{}));
        const IVec column = to_int(keep(inside, seen.x + 0.5f)), line = to_int(keep(inside, seen.y + 0.5f));
        const Vec depth = gather(map.depths, (seen.view * map.size + line) * map.size + column);
        const Vec blur = light_blur(map, size, seen.z, depth);
        const Mask hides = both(both(inside, gt(depth, seen.most)), ge(blur, reach * point[2]));
        sum += keep(hides, blur);
        count += keep(hides, set1(1.0f));
    }
    return sum / max(count, set1(1.0f));
}

// Share of a lamp of some size that reaches surfaces.
static Vec light_soft(const gs_shadow_map &map, const Light3 &at, const Light3 &normal, float slack, float size,
                      int64_t row) {
    static const LightDiscs discs;
    const LightPlane plane(map, at, normal);
    const Vec blur = light_blur_of(map, plane, discs, slack, size, row);
    const Mask hidden = gt(blur, Vec{});
    if (!bits(hidden))
        return set1(1.0f);
    Vec sum = {};
    for (const auto &point : discs.soft)
        sum += light_reaching(map, plane.point(blur * point[0], blur * point[1]), slack);
    return select(hidden, sum * (1.0f / kLightSoft), set1(1.0f));
}

// Share of a lamp's strength that arrives at surfaces; below 0 on their back.
static Vec light_falloff(const gs_lamp &lamp, const Light3 &at, const Light3 &normal) {
    if (lamp.is_sun)
        return -light_dot(lamp.axis, normal);
    const Light3 towards = {lamp.place[0] - at.x, lamp.place[1] - at.y, lamp.place[2] - at.z};
    const Vec squared = max(fma(towards.z, towards.z, fma(towards.y, towards.y, towards.x * towards.x)), set1(1e-12f));
    const Vec distance = sqrt(squared);
    const Vec facing = fma(towards.z, normal.z, fma(towards.y, normal.y, towards.x * normal.x));
    Vec share = facing / (distance * max(squared, set1(lamp.radius * lamp.radius)));
    const Vec along = -light_dot(lamp.axis, towards) / distance;
    if (lamp.cone[0] > -1) {
        const float fade = lamp.cone[1] > 1e-6f ? lamp.cone[1] : 1e-6f;
        const Vec ramp = min(max((along - lamp.cone[0]) / fade, Vec{}), set1(1.0f));
        share = share * (ramp * ramp * (3.0f - 2.0f * ramp));
    }
    return lamp.is_surface ? share * max(along, Vec{}) : share;
}

// Light of the world by normals; without what differs between opposite sides if they are unknown.
static void light_of_world(const float *world, const Light3 &normal, bool two_sided, Vec out[3]) {
    Vec basis[16];
    sh_basis<3>(2, normal.x, normal.y, normal.z, basis);
    for (int c = 0; c < 3; ++c) {
        out[c] = basis[0] * world[c];
        for (int k = two_sided ? 4 : 1; k < 9; ++k)
            out[c] = fma(basis[k], world[3 * k + c], out[c]);
        out[c] = max(out[c], Vec{});
    }
}

// The light of all lamps and the world, and without the shadows of meshes that are no proxies.
struct LightSum {
    Vec all[3], bare[3];
};

static LightSum light_sum(const gs_light &light, const Light3 &at, const Light3 &normal, bool two_sided, int64_t row) {
    LightSum sum;
    light_of_world(light.world, normal, two_sided, sum.all);
    for (int c = 0; c < 3; ++c)
        sum.bare[c] = sum.all[c];
    Vec reaching[2] = {set1(1.0f), set1(1.0f)};
    const gs_lamp *known = nullptr; // has the maps of `reaching`
    for (int32_t i = 0; i < light.lamp_count; ++i) {
        const gs_lamp &lamp = light.lamps[i];
        Vec share = light_falloff(lamp, at, normal);
        const Vec side = two_sided ? select(gt(Vec{}, share), set1(-1.0f), set1(1.0f)) : set1(1.0f);
        share = max(side * share, Vec{});
        if (!bits(gt(share, Vec{})))
            continue;
        if (two_sided || !known || known->maps[0] != lamp.maps[0] || known->maps[1] != lamp.maps[1] ||
            known->size != lamp.size) {
            const Vec off = side * light.slack;
            const Light3 above = {fma(normal.x, off, at.x), fma(normal.y, off, at.y), fma(normal.z, off, at.z)};
            const Light3 facing = {normal.x * side, normal.y * side, normal.z * side};
            for (int k = 0; k < 2; ++k)
                reaching[k] = lamp.maps[k] < 0 ? set1(1.0f)
                              : lamp.size > 0
                                  ? light_soft(light.maps[lamp.maps[k]], above, facing, light.slack, lamp.size, row)
                                  : light_reaching(light.maps[lamp.maps[k]], above, light.slack);
            known = &lamp;
        }
        const Vec bare = share * reaching[0], all = bare * reaching[1];
        for (int c = 0; c < 3; ++c) {
            sum.bare[c] = fma(bare, lamp.strength[c], sum.bare[c]);
            sum.all[c] = fma(all, lamp.strength[c], sum.all[c]);
        }
    }
    return sum;
}

// Factors of colours, in place of the radiances `sum.all`.
static void light_gains(const gs_surfaces &s, const Light3 &own, const uint32_t *id, LightSum &sum) {
    Vec captured[3];
    Mask known = gt(Vec{}, Vec{});
    if (s.captured) {
        gather<3>(s.captured, s.count, id, captured);
        const Vec longest = max(max(max(own.x, -own.x), max(own.y, -own.y)), max(own.z, -own.z));
        known = both(both(gt(longest, Vec{}), gt(captured[0], Vec{})),
                     both(gt(captured[1], Vec{}), gt(captured[2], Vec{})));
    }
    for (int c = 0; c < 3; ++c) {
        Vec ratio = set1(1.0f);
        if (s.catches)
            ratio = select(gt(sum.bare[c], Vec{}), sum.all[c] / sum.bare[c], ratio);
        if (s.captured) {
            const Vec lit = select(known, sum.all[c] / captured[c], set1(1.0f));
            ratio = (1.0f - s.share) * ratio + s.share * min(lit, set1(s.most));
        }
        sum.all[c] = ratio;
    }
}

// Rows of the lanes from `i` on; those beyond the end repeat the first.
GS_INLINE int light_rows(int64_t i, int64_t end, uint32_t id[kLanes]) {
    const int lanes = end - i < kLanes ? int(end - i) : kLanes;
    for (int l = 0; l < kLanes; ++l)
        id[l] = uint32_t(l < lanes ? i + l : i);
    return lanes;
}

static void surface_light(const LightArgs &a, int64_t chunk) {
    const gs_surfaces &s = *a.surfaces;
    const int64_t begin = chunk * kChunk, end = begin + kChunk < s.count ? begin + kChunk : s.count;
    for (int64_t i = begin; i < end; i += kLanes) {
        uint32_t id[kLanes];
        const int lanes = light_rows(i, end, id);
        Vec place[3], normal[3];
        gather<3>(s.places, s.count, id, place);
        gather<3>(s.normals, s.count, id, normal);
        const float *const m = s.matrix;
        const Light3 own = {normal[0], normal[1], normal[2]}, from = {place[0], place[1], place[2]};
        const Light3 at = {light_dot(m, from) + m[3], light_dot(m + 4, from) + m[7], light_dot(m + 8, from) + m[11]};
        LightSum sum = light_sum(*a.light, at, light_turn(s.turn, own), a.gains && !s.captured, i);
        if (a.gains)
            light_gains(s, own, id, sum);
        scatter<3>(a.out, id, lanes, sum.all);
    }
}

GS_INLINE Vec light_power(Vec x, float exponent) {
    const Vec scaled = min(log2(x) * exponent, set1(127.0f));
    Vec out;
    exp2_above<1>(-126.0f, &scaled, &out);
    return out;
}

// sRGB to linear light and back (IEC 61966-2-1), of values from 0 on.
GS_INLINE Vec light_decoded(Vec v) {
    return select(ge(set1(0.04045f), v), v * (1 / 12.92f), light_power((v + 0.055f) * (1 / 1.055f), 2.4f));
}
GS_INLINE Vec light_encoded(Vec v) {
    const Vec curve = fma(light_power(max(v, set1(1e-9f)), 1 / 2.4f), set1(1.055f), set1(-0.055f));
    return select(ge(set1(0.0031308f), v), v * 12.92f, curve);
}

// The higher coefficients of one splat times a gain of each channel.
GS_INLINE void scale_rest(const float *in, int count, const float gain[3], float *out) {
    const float x = gain[0], y = gain[1], z = gain[2];
    const Vec4 period[3] = {{x, y, z, x}, {y, z, x, y}, {z, x, y, z}};
    int i = 0;
    for (; i + 12 <= count; i += 12)
        for (int k = 0; k < 3; ++k)
            store(out + i + 4 * k, load<Vec4>(in + i + 4 * k) * period[k]);
    for (; i < count; i += 3)
        for (int k = 0; k < 3; ++k)
            out[i + k] = in[i + k] * gain[k];
}

static void scale_colors(const ColorArgs &a, int64_t chunk) {
    const gs_colors &in = *a.colors;
    const float dim = 1 / 255.0f; // a darker sRGB colour is black
    const int64_t begin = chunk * kChunk, end = begin + kChunk < in.count ? begin + kChunk : in.count;
    const int rest = 3 * in.sh_rest;
    for (int64_t i = begin; i < end; i += kLanes) {
        uint32_t id[kLanes];
        const int lanes = light_rows(i, end, id);
        Vec sh0[3], gains[3];
        gather<3>(in.sh0, in.count, id, sh0);
        gather<3>(in.gains, in.count, id, gains);
        alignas(64) float scale[3][kLanes];
        for (int c = 0; c < 3; ++c) {
            const Vec color = sh0[c] * GS_SH_C0 + 0.5f;
            const Vec lit = light_encoded(max(light_decoded(max(color, Vec{})) * gains[c], Vec{})) + min(color, Vec{});
            sh0[c] = (lit - 0.5f) / GS_SH_C0;
            store(scale[c], select(gt(color, set1(dim)), lit / max(color, set1(dim)), set1(1.0f)));
        }
        scatter<3>(a.sh0, id, lanes, sh0);
        for (int l = 0; l < lanes && rest > 0; ++l) {
            const float gain[3] = {scale[0][l], scale[1][l], scale[2][l]};
            scale_rest(in.shN + (i + l) * rest, rest, gain, a.shN + (i + l) * rest);
        }
    }
}

} // namespace gs::GS_NAMESPACE
