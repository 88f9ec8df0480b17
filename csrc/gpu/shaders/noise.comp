// Moves faint splats by their covariance times normal numbers (Kheradmand et al. 2024, section 5), as
// gscore/engine/cpu/splat_terms.py, whose constants are repeated here.
#version 450
#extension GL_GOOGLE_include_directive : require
#define GS_PUSH gs_noise_push
#include "common.glsl"
#include "arithmetic.glsl"
#include "philox.glsl"

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer gs_noise_block {
    gs_noise of;
};

const float kGateSharpness = 100.0, kGateOpacity = 0.005;
const float kMostLogit = -2.19722458; // of opacity 0.1

float sigmoid(float x) { return 1.0 / (1.0 + exp_polynomial(-x)); }

vec3 cross_product(vec3 a, vec3 b) {
    return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// v rotated by the unit quaternion (w, axis).
vec3 rotated(float w, vec3 axis, vec3 v) {
    vec3 side = cross_product(axis, v);
    return v + 2.0 * (w * side + cross_product(axis, side));
}

void main() {
    uint index = group_number() * GS_GROUP + lane(), row = push.frozen + index;
    if (row >= push.rows || push.state.at[push.skip] != 0u)
        return;
    vec4 mean = push.values.at[row];
    if (!(mean.w < kMostLogit))
        return;
    vec4 quat = push.values.at[GS_PLANE_QUAT * push.rows + row];
    vec3 scale = push.values.at[GS_PLANE_SCALE * push.rows + row].xyz;
    gs_noise of = push.block.of;
    uvec4 words = random_words(index, of.step, of.stream, uvec2(of.seed_low, of.seed_high));
    float gate = sigmoid(-kGateSharpness * (sigmoid(mean.w) - kGateOpacity));
    vec3 noise = normal_numbers(words) * (gate * of.weight);
    quat /= max(sqrt(quat.x * quat.x + quat.y * quat.y + quat.z * quat.z + quat.w * quat.w), 1e-12);
    vec3 variance = vec3(exp_polynomial(2.0 * scale.x), exp_polynomial(2.0 * scale.y), exp_polynomial(2.0 * scale.z));
    mean.xyz += rotated(quat.x, quat.yzw, variance * rotated(quat.x, -quat.yzw, noise));
    push.values.at[row] = mean;
}
