// Resets runaway rows and clamps saturated parameters, as gscore/engine/cpu/sanitize.py, whose limits are repeated here.
// Numbers are compared by bits, because a compiler may assume that there is no NaN.
#version 450
#extension GL_GOOGLE_include_directive : require
#define GS_PUSH gs_clamp_push
#include "common.glsl"
#include "arithmetic.glsl"

const float kMostValue = 1e4, kMostLogit = 20.0, kNeutralScale = -10.0;
const float kMostSpread = 5.0;       // camera extents
const float kLogRatio = 11.5129255;  // ln 1e5, of the longest to the shortest axis
const float kMostMoment = 1e37;

bool within(uint bits, float limit) { return (bits & 0x7FFFFFFFu) <= floatBitsToUint(limit); }
bool within(uvec3 v, float limit) { return within(v.x, limit) && within(v.y, limit) && within(v.z, limit); }

bool small_scale(uint bits) {
    return (bits & 0x7FFFFFFFu) < 0x7F800000u && uintBitsToFloat(bits) <= push.most_scale;
}

bool is_good(uint row) {
    uvec4 mean = push.values.at[row], quat = push.values.at[GS_PLANE_QUAT * push.rows + row];
    uvec4 scale = push.values.at[GS_PLANE_SCALE * push.rows + row];
    bool good = within(mean.xyz, push.most_mean) && within(mean.w, kMostValue) && within(quat.xyz, kMostValue) &&
                within(quat.w, kMostValue) && small_scale(scale.x) && small_scale(scale.y) && small_scale(scale.z);
    for (uint plane = GS_PLANE_SH; plane < push.planes; ++plane) {
        uvec4 sh = push.values.at[plane * push.rows + row];
        good = good && within(sh.xyz, kMostValue) && within(sh.w, kMostValue);
    }
    return good;
}

void reset_row(uint row) {
    for (uint plane = 0; plane < push.planes; ++plane) {
        uvec4 neutral = uvec4(0u);
        if (plane == GS_PLANE_MEAN)
            neutral.w = floatBitsToUint(-kMostLogit);
        else if (plane == GS_PLANE_QUAT)
            neutral = floatBitsToUint(vec4(1.0));
        else if (plane == GS_PLANE_SCALE)
            neutral.xyz = floatBitsToUint(vec3(kNeutralScale));
        uint at = plane * push.rows + row;
        push.values.at[at] = neutral;
        push.moment1.at[at] = uvec4(0u);
        push.moment2.at[at] = uvec4(0u);
        if (plane >= GS_PLANE_SH)
            push.accumulated.at[at - GS_PLANE_SH * push.rows] = uvec4(0u);
    }
    for (uint k = 0; k < push.counter_count; ++k)
        push.counters.at[k * push.rows + row] = 0u;
    atomicAdd(push.state.at[push.lost], 1u); // a sum of whole numbers does not depend on their order
}

void clamp_row(uint row) {
    uvec4 mean = push.values.at[row], axes = push.values.at[GS_PLANE_SCALE * push.rows + row];
    mean.w = floatBitsToUint(min(max(uintBitsToFloat(mean.w), -kMostLogit), kMostLogit));
    push.values.at[row] = mean;
    vec3 scale = uintBitsToFloat(axes.xyz), at = uintBitsToFloat(mean.xyz);
    if (max(scale.x, max(scale.y, scale.z)) > push.spread) {
        // The cameras are around the origin.
        float distance = sqrt(at.x * at.x + (at.y * at.y + at.z * at.z));
        scale = min(scale, vec3(log2_polynomial(kMostSpread * (push.extent + distance)) * GS_LN2));
    }
    axes.xyz = floatBitsToUint(max(scale, vec3(max(scale.x, max(scale.y, scale.z)) - kLogRatio)));
    push.values.at[GS_PLANE_SCALE * push.rows + row] = axes;
}

bool overflowed(uint bits) {
    return (bits & 0x7FFFFFFFu) > 0x7F800000u || ((bits & 0x80000000u) == 0u && bits > floatBitsToUint(kMostMoment));
}
bool overflowed(uvec3 v) { return overflowed(v.x) || overflowed(v.y) || overflowed(v.z); }

void clear_moments(uint at, bool xyz, bool w) {
    if (!xyz && !w)
        return;
    uvec4 first = push.moment1.at[at], second = push.moment2.at[at];
    uvec4 mask = uvec4(uvec3(xyz ? 0u : 0xFFFFFFFFu), w ? 0u : 0xFFFFFFFFu);
    push.moment1.at[at] = first & mask;
    push.moment2.at[at] = second & mask;
}

// Of each parameter: a moment that overflowed, as after one gradient of 1e20, would stop a row for ever.
void clear_overflowed(uint row) {
    bool rest = false;
    for (uint plane = 0; plane < push.planes; ++plane) {
        uint at = plane * push.rows + row;
        uvec4 second = push.moment2.at[at];
        bool xyz = overflowed(second.xyz), w = overflowed(second.w);
        if (plane < GS_PLANE_SH)
            clear_moments(at, plane == GS_PLANE_QUAT ? xyz || w : xyz, plane == GS_PLANE_QUAT ? xyz || w : w);
        else if (plane == GS_PLANE_SH)
            clear_moments(at, xyz, false);
        rest = rest || (plane >= GS_PLANE_SH && w) || (plane > GS_PLANE_SH && xyz);
    }
    for (uint plane = GS_PLANE_SH; rest && plane < push.planes; ++plane)
        clear_moments(plane * push.rows + row, plane > GS_PLANE_SH, true);
}

void main() {
    uint row = push.frozen + group_number() * GS_GROUP + lane();
    if (row >= push.rows || push.state.at[push.run] == 0u)
        return;
    if (!is_good(row)) {
        reset_row(row);
        return;
    }
    clamp_row(row);
    clear_overflowed(row);
}
