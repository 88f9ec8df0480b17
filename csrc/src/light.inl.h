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

// Places in a map: pixel coordinates with integers at centres, and z. A mesh of depth d is in front if d per > most.
struct LightSeen {
    IVec view;
    Vec x, y, per, most, z;
};

GS_INLINE LightSeen light_seen(const gs_shadow_map &map, const Light3 &at) {
    Light3 seen = {};
    const IVec view = light_view(map, {at.x - map.place[0], at.y - map.place[1], at.z - map.place[2]}, seen);
    const Vec before = seen.z - map.slack;
    const float middle = 0.5f * float(map.size) - 0.5f;
    if (map.parallel) // beyond all meshes, each of them is in front
        return {view,       fma(seen.x, map.scale, set1(middle)), fma(seen.y, map.scale, set1(middle)),
                set1(1.0f), max(map.farthest - before, Vec{}),    seen.z};
    const Vec scale = quotient(set1(map.scale), max(seen.z, set1(1e-9f)));
    return {view, fma(scale, seen.x, set1(middle)), fma(scale, seen.y, set1(middle)), before, set1(1.0f), seen.z};
}

// Share of a point, or a direction, that reaches places.
static Vec light_reaching(const gs_shadow_map &map, const Light3 &at) {
    const auto [view, x, y, per, most, z] = light_seen(map, at);
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
        const Vec near = keep(ge(most, per * gather(map.depths, first)), set1(1.0f));
        const Vec far = keep(ge(most, per * gather(map.depths, first + 1)), set1(1.0f));
        rows[k] = fma(u, far - near, near);
    }
    return select(inside, fma(v, rows[1] - rows[0], rows[0]), set1(1.0f));
}

// The mesh in the pixel nearest to each place: whether it is in front, its depth, the mean of both sides if the far one
// is in front too, as outlines are between them, and z of the place.
struct LightMesh {
    Mask hides;
    Vec depth, z;
};

GS_INLINE LightMesh light_mesh(const gs_shadow_map &map, const Light3 &at) {
    const LightSeen seen = light_seen(map, at);
    const Vec x = seen.x + 0.5f, y = seen.y + 0.5f, end = set1(float(map.size));
    const Mask inside = both(both(both(ge(x, Vec{}), gt(end, x)), both(ge(y, Vec{}), gt(end, y))), gt(seen.z, Vec{}));
    const IVec column = to_int(keep(inside, x)), line = to_int(keep(inside, y));
    const IVec pixel = (seen.view * map.size + line) * map.size + column;
    Vec depth = gather(map.depths, pixel);
    const Mask hides = both(inside, gt(seen.per * depth, seen.most));
    if (map.backs) {
        const Vec back = gather(map.backs, pixel);
        depth = select(gt(seen.per * back, seen.most), 0.5f * (back + depth), depth);
    }
    return {hides, depth, seen.z};
}

// Samples of the search for meshes in front, and of a soft shadow.
constexpr int kLightSearch = 16, kLightSoft = 24;
// Samples of a soft shadow after which it ends if they agree.
constexpr int kLightFirst = 8;
// Radius of a blur, px, from which on samples are the nearest pixels.
constexpr float kLightWide = 8.0f;
// The search of each of so many splats is turned otherwise, so that its samples make no edges.
constexpr int kLightTurns = 16;
// Least cosine at which a disc around a surface is turned into its plane.
constexpr float kLightGrazing = 0.2f;

// Points of a disc of radius 1 on a spiral by the golden angle (Vogel 1979); in the search denser in the middle, as
// meshes close to the surface blur little.
struct LightDiscs {
    float search[kLightSearch][3]; // x, y, and the distance from the middle
    float soft[kLightSoft][2];     // x, y; the first ones are the middle and the edge
    float turns[2][kLightTurns];   // cosines and sines of turns of the search

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
            // From the middle outwards.
            const int along = i == 0 ? 0 : i < kLightFirst ? kLightSoft - i : i - kLightFirst + 1;
            const double t = std::sqrt((along + 0.5) / kLightSoft), turn = 2.399963229728653 * along;
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

// Surfaces that are lit together.
constexpr int kLightRows = 256;
// Most lamps with the same shadows that light them together: an area lamp is four.
constexpr int kLightLamps = 4;

struct LightBlock {
    typedef float Rows[kLightRows];
    alignas(64) Rows at[3], normal[3]; // world
    Rows all[3], bare[3];              // the light of all lamps and the world, and without shadows of other meshes
    Rows share[kLightLamps];           // of the strength of lamps, without shadows
    Rows facing[3];                    // the normals on the side of a lamp
    Rows reaching[2];                  // shares of a lamp that pass proxies and other meshes

    Light3 columns(const Rows v[3], int i) const { return {load(v[0] + i), load(v[1] + i), load(v[2] + i)}; }
    Light3 columns(const Rows v[3], IVec rows) const {
        return {gather(v[0], rows), gather(v[1], rows), gather(v[2], rows)};
    }
    // The surfaces, off by a distance, and their planes.
    LightPlane plane(const gs_shadow_map &map, IVec rows) const {
        const Light3 side = columns(facing, rows);
        return LightPlane(map, above(rows, side, map.slack), side);
    }
    Light3 above(IVec rows, float slack) const { return above(rows, columns(facing, rows), slack); }

  private:
    Light3 above(IVec rows, const Light3 &side, float slack) const {
        const Light3 v = columns(at, rows);
        return {fma(side.x, slack, v.x), fma(side.y, slack, v.y), fma(side.z, slack, v.z)};
    }
};

// Some surfaces of a block, so that vectors are full of those that need work.
struct LightList {
    alignas(64) int32_t rows[kLightRows + kLanes];
    int count = 0;

    void add(IVec which, Mask mask) {
        int32_t lanes[kLanes];
        store(lanes, which);
        for (uint32_t left = bits(mask); left; left &= left - 1)
            rows[count++] = lanes[__builtin_ctz(left)];
    }
    // Calls f(rows, mask) for vectors of rows; the mask leaves out lanes beyond the end, which repeat a row.
    template <class F> void each(F f) {
        store(rows + count, set1(rows[0]));
        for (int i = 0; i < count; i += kLanes)
            f(load(rows + i), gt(set1(float(count - i)), iota()));
    }
};

GS_INLINE void light_put(float *column, IVec rows, Vec v) {
    for (int l = 0; l < kLanes; ++l)
        column[rows[l]] = v[l];
}

// Radius of the blur by meshes in front that hide a part of the lamp; 0 without any. Its inverse is the root mean
// square of theirs: without `backs` the map shows the side towards the lamp, which blurs more than the outline behind
// it, so that a mean of the radii would let light pass at contacts.
static Vec light_blur_of(const gs_shadow_map &map, const LightPlane &plane, const LightDiscs &discs, float size, Vec z,
                         IVec rows) {
    const Vec cosine = gather(discs.turns[0], rows & (kLightTurns - 1)),
              sine = gather(discs.turns[1], rows & (kLightTurns - 1));
    const Vec reach = min(max(light_blur(map, size, z, set1(map.nearest)), Vec{}), z);
    Vec sum = {}, count = {};
    for (const auto &point : discs.search) {
        const Vec x = cosine * point[0] - sine * point[1], y = sine * point[0] + cosine * point[1];
        const LightMesh mesh = light_mesh(map, plane.point(reach * x, reach * y));
        const Vec blur = light_blur(map, size, mesh.z, mesh.depth);
        const Mask hides = both(mesh.hides, ge(blur, reach * point[2]));
        sum += keep(hides, quotient(set1(1.0f), max(blur * blur, set1(1e-30f))));
        count += keep(hides, set1(1.0f));
    }
    return sqrt(quotient(count, max(sum, set1(1e-30f))));
}

// Sum of the samples [first, last) of a soft shadow.
static Vec light_samples(const gs_shadow_map &map, const LightPlane &plane, const LightDiscs &discs, Vec blur,
                         bool wide, int first, int last) {
    Vec sum = {};
    for (int i = first; i < last; ++i) {
        const Light3 at = plane.point(blur * discs.soft[i][0], blur * discs.soft[i][1]);
        sum += wide ? select(light_mesh(map, at).hides, Vec{}, set1(1.0f)) : light_reaching(map, at);
    }
    return sum;
}

// Share of a lamp of some size that reaches surfaces.
static void light_soft(const gs_shadow_map &map, const LightBlock &block, LightList &lit, float size, float *reaching) {
    static const LightDiscs discs;
    float blurs[kLightRows], sums[kLightRows];
    LightList hidden[2]; // with narrow and with wide blurs
    lit.each([&](IVec rows, Mask mask) {
        const LightPlane plane = block.plane(map, rows);
        const Vec z = light_seen(map, plane.at).z;
        const Vec blur = light_blur_of(map, plane, discs, size, z, rows);
        light_put(blurs, rows, blur);
        const Vec edge = map.parallel ? set1(kLightWide) : kLightWide * z;
        const Mask some = both(mask, gt(blur, Vec{}));
        hidden[0].add(rows, both(some, gt(edge, blur * map.scale)));
        hidden[1].add(rows, both(some, ge(blur * map.scale, edge)));
    });
    for (int wide = 0; wide < 2; ++wide) {
        LightList open;
        hidden[wide].each([&](IVec rows, Mask mask) {
            const Vec sum =
                light_samples(map, block.plane(map, rows), discs, gather(blurs, rows), wide > 0, 0, kLightFirst);
            light_put(sums, rows, sum);
            light_put(reaching, rows, sum * (1.0f / kLightFirst));
            open.add(rows, both(mask, both(gt(sum, Vec{}), gt(set1(float(kLightFirst)), sum))));
        });
        open.each([&](IVec rows, Mask) {
            const Vec sum = light_samples(map, block.plane(map, rows), discs, gather(blurs, rows), wide > 0,
                                          kLightFirst, kLightSoft);
            light_put(reaching, rows, (gather(sums, rows) + sum) * (1.0f / kLightSoft));
        });
    }
}

// Share of a lamp's strength that arrives at surfaces; below 0 on their back.
static Vec light_falloff(const gs_lamp &lamp, const Light3 &at, const Light3 &normal) {
    if (lamp.is_sun)
        return -light_dot(lamp.axis, normal);
    const Light3 towards = {lamp.place[0] - at.x, lamp.place[1] - at.y, lamp.place[2] - at.z};
    const Vec squared = max(fma(towards.z, towards.z, fma(towards.y, towards.y, towards.x * towards.x)), set1(1e-12f));
    const Vec per = quotient(set1(1.0f), sqrt(squared));
    const Vec facing = fma(towards.z, normal.z, fma(towards.y, normal.y, towards.x * normal.x));
    Vec share = quotient(facing * per, max(squared, set1(lamp.radius * lamp.radius)));
    const Vec along = -light_dot(lamp.axis, towards) * per;
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

// Share of the world's light that reaches surfaces past meshes.
static void light_past_meshes(const gs_light &light, const Light3 &at, const Light3 &normal, Vec share[3]) {
    Vec sent[3] = {}, hidden[3] = {};
    for (int32_t k = 0; k < light.sky_count; ++k) {
        const gs_shadow_map &map = light.maps[light.sky[k].map];
        const Vec facing = max(-light_dot(map.rotations + 6, normal), Vec{});
        if (!bits(gt(facing, Vec{})))
            continue;
        const Vec lost = keep(light_mesh(map, at).hides, facing);
        for (int c = 0; c < 3; ++c) {
            sent[c] = fma(facing, light.sky[k].strength[c], sent[c]);
            hidden[c] = fma(lost, light.sky[k].strength[c], hidden[c]);
        }
    }
    for (int c = 0; c < 3; ++c)
        share[c] = 1.0f - quotient(hidden[c], max(sent[c], set1(1e-30f)));
}

// Adds the light of lamps with the same shadows; without a known side of normals of one.
static void light_lamps(const gs_light &light, const gs_lamp *lamps, int count, bool two_sided, LightBlock &block) {
    LightList lit;
    for (int i = 0; i < kLightRows; i += kLanes) {
        const Light3 at = block.columns(block.at, i), normal = block.columns(block.normal, i);
        Vec side = set1(1.0f), most = {};
        for (int j = 0; j < count; ++j) {
            Vec share = light_falloff(lamps[j], at, normal);
            if (two_sided)
                side = select(gt(Vec{}, share), set1(-1.0f), set1(1.0f));
            share = max(side * share, Vec{});
            store(block.share[j] + i, share);
            most = max(most, share);
        }
        store(block.facing[0] + i, normal.x * side);
        store(block.facing[1] + i, normal.y * side);
        store(block.facing[2] + i, normal.z * side);
        for (auto &reaching : block.reaching)
            store(reaching + i, set1(1.0f));
        lit.add(to_int(iota()) + i, gt(most, Vec{}));
    }
    for (int k = 0; k < 2 && lit.count; ++k) {
        if (lamps->maps[k] < 0)
            continue;
        const gs_shadow_map &map = light.maps[lamps->maps[k]];
        if (lamps->size > 0)
            light_soft(map, block, lit, lamps->size, block.reaching[k]);
        else
            lit.each([&](IVec rows, Mask) {
                light_put(block.reaching[k], rows, light_reaching(map, block.above(rows, map.slack)));
            });
    }
    for (int i = 0; i < kLightRows && lit.count; i += kLanes)
        for (int j = 0; j < count; ++j) {
            const Vec bare = load(block.share[j] + i) * load(block.reaching[0] + i);
            const Vec all = bare * load(block.reaching[1] + i);
            for (int c = 0; c < 3; ++c) {
                store(block.bare[c] + i, fma(bare, lamps[j].strength[c], load(block.bare[c] + i)));
                store(block.all[c] + i, fma(all, lamps[j].strength[c], load(block.all[c] + i)));
            }
        }
}

// The lamps from the first on that light a block together.
static int light_shared(const gs_lamp *lamps, int count) {
    int shared = 1;
    while (shared < count && shared < kLightLamps && lamps[shared].maps[0] == lamps->maps[0] &&
           lamps[shared].maps[1] == lamps->maps[1] && lamps[shared].size == lamps->size)
        ++shared;
    return shared;
}

// Factors of colours, in place of radiances `all`.
static void light_gains(const gs_surfaces &s, const uint32_t *id, const Vec bare[3], Vec all[3]) {
    Vec captured[3];
    Mask known = gt(Vec{}, Vec{});
    if (s.captured) {
        Vec own[3];
        gather<3>(s.captured, s.count, id, captured);
        gather<3>(s.normals, s.count, id, own);
        const Vec longest = max(max(max(own[0], -own[0]), max(own[1], -own[1])), max(own[2], -own[2]));
        known = both(both(gt(longest, Vec{}), gt(captured[0], Vec{})),
                     both(gt(captured[1], Vec{}), gt(captured[2], Vec{})));
    }
    for (int c = 0; c < 3; ++c) {
        Vec ratio = set1(1.0f);
        if (s.catches)
            ratio = select(gt(bare[c], Vec{}), all[c] / bare[c], ratio);
        if (s.captured) {
            const Vec lit = select(known, all[c] / captured[c], set1(1.0f));
            ratio = (1.0f - s.share) * ratio + s.share * min(lit, set1(s.most));
        }
        all[c] = ratio;
    }
}

// Rows of the lanes from `i` on; those beyond the end repeat the first.
GS_INLINE int light_rows(int64_t i, int64_t end, uint32_t id[kLanes]) {
    const int lanes = end - i < kLanes ? int(end - i) : kLanes;
    for (int l = 0; l < kLanes; ++l)
        id[l] = uint32_t(l < lanes ? i + l : i);
    return lanes;
}

// Rows [begin, end) of a chunk, at most kLightRows.
static void light_block(const LightArgs &a, int64_t begin, int64_t end) {
    const gs_surfaces &s = *a.surfaces;
    const bool two_sided = a.gains && !s.captured;
    LightBlock block;
    for (int i = 0; i < kLightRows; i += kLanes) {
        uint32_t id[kLanes];
        light_rows(begin + i < end ? begin + i : begin, end, id);
        Vec place[3], normal[3], world[3];
        gather<3>(s.places, s.count, id, place);
        gather<3>(s.normals, s.count, id, normal);
        const float *const m = s.matrix;
        const Light3 from = {place[0], place[1], place[2]};
        const Light3 turned = light_turn(s.turn, {normal[0], normal[1], normal[2]});
        const Vec at[3] = {light_dot(m, from) + m[3], light_dot(m + 4, from) + m[7], light_dot(m + 8, from) + m[11]};
        const Vec axes[3] = {turned.x, turned.y, turned.z};
        light_of_world(a.light->world, turned, two_sided, world);
        for (int c = 0; c < 3; ++c) {
            store(block.at[c] + i, at[c]);
            store(block.normal[c] + i, axes[c]);
            store(block.bare[c] + i, world[c]);
        }
        Vec share[3] = {set1(1.0f), set1(1.0f), set1(1.0f)};
        if (!two_sided && a.light->sky_count > 0)
            light_past_meshes(*a.light, {at[0], at[1], at[2]}, turned, share);
        for (int c = 0; c < 3; ++c)
            store(block.all[c] + i, world[c] * share[c]);
    }
    for (int32_t i = 0; i < a.light->lamp_count;) {
        const gs_lamp *const lamps = a.light->lamps + i;
        const int count = two_sided ? 1 : light_shared(lamps, a.light->lamp_count - i);
        light_lamps(*a.light, lamps, count, two_sided, block);
        i += count;
    }
    for (int64_t i = begin; i < end; i += kLanes) {
        uint32_t id[kLanes];
        const int lanes = light_rows(i, end, id);
        Vec all[3], bare[3];
        for (int c = 0; c < 3; ++c) {
            all[c] = load(block.all[c] + (i - begin));
            bare[c] = load(block.bare[c] + (i - begin));
        }
        if (a.gains)
            light_gains(s, id, bare, all);
        scatter<3>(a.out, id, lanes, all);
    }
}

static void surface_light(const LightArgs &a, int64_t chunk) {
    const int64_t begin = chunk * kChunk, end = begin + kChunk < a.surfaces->count ? begin + kChunk : a.surfaces->count;
    for (int64_t i = begin; i < end; i += kLightRows)
        light_block(a, i, i + kLightRows < end ? i + kLightRows : end);
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
