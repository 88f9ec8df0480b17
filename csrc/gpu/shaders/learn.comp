// A training step of each row: its gradients, regularisers, Adam (Kingma and Ba 2015), and its statistics. As
// csrc/src/adam.inl.h, but SH coefficients that wait for their step do so in all rows alike.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"
#include "pairs.glsl"
#include "ellipse.glsl"
#include "harmonics.glsl"
#include "philox.glsl"
#include "projection.glsl"
#include "harmonics_backward.glsl"
#include "chain.glsl"
#include "row_gradients.glsl"

// Gradients are clamped to this, so that their squares stay finite.
#define GS_GRADIENT_MAX 1e18

bool finite(vec4 v) { return finite(v.xyz) && finite(v.w); }

struct Moved {
    vec4 value, moment1, moment2;
};

Moved moved(uint at, vec4 g, vec4 rate, vec4 eps2) {
    const float beta1 = float(GS_ADAM_BETA1), beta2 = float(GS_ADAM_BETA2);
    g = min(max(g, vec4(-GS_GRADIENT_MAX)), vec4(GS_GRADIENT_MAX));
    Moved x = Moved(training.values.at[at], training.moment1.at[at], training.moment2.at[at]);
    x.moment1 = beta1 * x.moment1 + float(1.0 - GS_ADAM_BETA1) * g;
    x.moment2 = beta2 * x.moment2 + float(1.0 - GS_ADAM_BETA2) * (g * g);
    x.value -= rate * x.moment1 / sqrt(x.moment2 + eps2);
    return x;
}

void store(uint at, Moved x) {
    training.values.at[at] = x.value;
    training.moment1.at[at] = x.moment1;
    training.moment2.at[at] = x.moment2;
}

// Steps or accumulates the SH coefficients. `keeps`: accumulated gradients count.
void learn_harmonics(uint row, Gradients g, bool visible, bool keeps) {
    uint n = frame.count, mode = training.sh_update;
    if (mode == GS_SH_STEP) {
        bool good = true;
        for (uint plane = 0; plane < training.sh_planes; ++plane) {
            vec4 v = sh_plane(plane, g.direction, g.color) + training.accumulated.at[plane * n + row];
            good = good && (plane > 0 ? finite(v) : finite(v.w));
        }
        if (keeps && !good)
            atomicAdd(training.state.at[GS_STATE_BAD_ROWS], 1u);
        keeps = keeps && good;
    }
    for (uint plane = 0; plane < training.sh_planes; ++plane) {
        uint at = (GS_PLANE_SH + plane) * n + row;
        vec4 rate = plane == 0 ? training.sh_rate : training.sh_rate.wwww;
        vec4 eps2 = plane == 0 ? training.sh_eps2 : training.sh_eps2.wwww;
        vec4 v = sh_plane(plane, g.direction, g.color), waiting = vec4(0.0);
        if (mode != GS_SH_OFF) {
            waiting = training.accumulated.at[plane * n + row];
            waiting = keeps ? waiting : vec4(0.0);
            vec4 added = visible ? v + waiting : waiting;
            if (mode == GS_SH_STEP)
                added = keeps ? added : vec4(0.0);
            v = plane == 0 ? vec4(v.xyz, added.w) : added;
            waiting = mode == GS_SH_STEP ? vec4(0.0) : added;
            if (plane == 0)
                waiting.xyz = vec3(0.0);
            training.accumulated.at[plane * n + row] = waiting;
        }
        if (plane > 0 && mode != GS_SH_STEP)
            continue;
        Moved before = Moved(training.values.at[at], training.moment1.at[at], training.moment2.at[at]);
        if (mode != GS_SH_STEP)
            v.w = 0.0;
        Moved x = moved(at, v, rate, eps2);
        if (plane == 0 && mode != GS_SH_STEP) {
            x.value.w = before.value.w;
            x.moment1.w = before.moment1.w;
            x.moment2.w = before.moment2.w;
        }
        store(at, x);
    }
}

void main() {
    if (training.state.at[GS_STATE_SKIP] != 0)
        return;
    uint row = group_number() * GS_GROUP + lane(), n = frame.count;
    Projection p;
    Gradients g;
    bool visible = gradients_of(row, p, g);
    if (training.learns_pose != 0)
        store_camera_parts(visible, p, g);
    if (row >= n || row < training.frozen || training.updates == 0)
        return;
    if (visible && training.observes != 0) {
        vec2 v = g.mean2d * vec2(training.half_width, training.half_height);
        training.gradient_sums.at[row] += sqrt(v.x * v.x + v.y * v.y);
        training.views.at[row] += 1.0;
    }
    if (training.opacity_reg != 0.0 || training.scale_reg != 0.0) {
        vec4 mean_opacity = training.values.at[GS_PLANE_MEAN * n + row];
        float e = exp_polynomial(-mean_opacity.w), opacity = 1.0 / (1.0 + e);
        vec4 scale = training.values.at[GS_PLANE_SCALE * n + row];
        g.opacity += training.opacity_reg * (opacity * (e * opacity));
        g.scale += training.scale_reg * vec3(exp_polynomial(scale.x), exp_polynomial(scale.y), exp_polynomial(scale.z));
    }
    bool good = finite(vec4(g.mean, g.opacity)) && finite(g.quat) && finite(g.scale) && finite(g.color);
    if (!good) {
        atomicAdd(training.state.at[GS_STATE_BAD_ROWS], 1u);
        g.mean = g.scale = g.color = vec3(0.0);
        g.quat = vec4(0.0);
        g.opacity = 0.0;
    }
    store(GS_PLANE_MEAN * n + row, moved(GS_PLANE_MEAN * n + row, vec4(g.mean, g.opacity), training.mean_rate, training.mean_eps2));
    store(GS_PLANE_QUAT * n + row, moved(GS_PLANE_QUAT * n + row, g.quat, training.quat_rate, training.quat_eps2));
    store(GS_PLANE_SCALE * n + row, moved(GS_PLANE_SCALE * n + row, vec4(g.scale, 0.0), training.scale_rate, training.scale_eps2));
    learn_harmonics(row, g, visible, good);
}
