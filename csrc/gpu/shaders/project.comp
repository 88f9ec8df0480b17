// Projects splats (EWA, Zwicker et al. 2001), one per invocation: records, depth keys, radii, numbers of tiles, and the
// number of splats in the picture per workgroup. The formulas are those of csrc/src/project.inl.h.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"
#include "ellipse.glsl"
#include "harmonics.glsl"
#include "scan.glsl"

// By bits, because a compiler may assume that comparisons meet no NaN.
bool finite(float x) { return (floatBitsToUint(x) & 0x7F800000u) != 0x7F800000u; }
bool finite(vec3 v) { return finite(v.x) && finite(v.y) && finite(v.z); }

// Rotation matrix of a quaternion wxyz of any length; false if it has no direction.
bool rotation(vec4 q, out mat3 rot) {
    vec4 a = abs(q);
    float largest = max(max(a.x, a.y), max(a.z, a.w));
    // Divided by the largest component first, so that no length over- or underflows.
    q *= 1.0 / max(largest, GS_QUAT_MIN);
    q /= sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    float w = q.x, x = q.y, y = q.z, z = q.w;
    // Columns.
    rot[0] = vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
    rot[1] = vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
    rot[2] = vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
    return largest >= GS_QUAT_MIN;
}

float sum3(vec3 a, vec3 b) { return a.x * b.x + (a.y * b.y + a.z * b.z); }

// False: not in the picture.
bool project(uint row, out Splat s, out float extent) {
    uint n = frame.count;
    vec4 mean_opacity = frame.model.at[GS_PLANE_MEAN * n + row];
    vec3 mean = mean_opacity.xyz;
    mat4 world_to_camera = frame.view.viewmat; // row-major, so GLSL's columns are its rows
    vec3 w0 = world_to_camera[0].xyz, w1 = world_to_camera[1].xyz, w2 = world_to_camera[2].xyz;
    vec3 cam = vec3(sum3(w0, mean) + world_to_camera[0].w, sum3(w1, mean) + world_to_camera[1].w,
                    sum3(w2, mean) + world_to_camera[2].w);
    if (!finite(mean) || !finite(cam) || !(cam.z > frame.view.near_plane && cam.z <= frame.view.far_plane))
        return false;
    vec4 quat = frame.model.at[GS_PLANE_QUAT * n + row];
    vec3 scale = frame.model.at[GS_PLANE_SCALE * n + row].xyz;
    float opacity = mean_opacity.w;
    if (!finite(quat.xyz) || !finite(quat.w) || !finite(scale) || !finite(opacity))
        return false;
    if (frame.raw != 0) {
        scale = vec3(exp_polynomial(scale.x), exp_polynomial(scale.y), exp_polynomial(scale.z));
        opacity = 1.0 / (1.0 + exp_polynomial(-opacity));
    }
    mat3 rot;
    if (!rotation(quat, rot))
        return false;

    bool parallel = frame.view.orthographic != 0;
    float inverse_z = 1.0 / cam.z;
    vec2 focal = vec2(frame.view.fx, frame.view.fy), centre = vec2(frame.view.cx, frame.view.cy);
    vec2 size = vec2(float(frame.view.width), float(frame.view.height));
    vec2 diagonal, offset, mean2d;
    if (parallel) {
        diagonal = focal;
        offset = vec2(0.0);
        mean2d = focal * cam.xy + centre;
    } else {
        // Limits of x / z and y / z in the Jacobian, because the linearisation degenerates far off screen.
        vec2 margin = GS_JACOBIAN_MARGIN * (0.5 * size / focal);
        vec2 ratio = cam.xy * inverse_z;
        vec2 clamped = min(max(ratio, -centre / focal - margin), (size - centre) / focal + margin);
        diagonal = focal * inverse_z;
        offset = -diagonal * clamped;
        mean2d = focal * ratio + centre;
    }
    // M = J W R S, a row a line.
    vec3 m0, m1;
    for (int k = 0; k < 3; ++k) {
        float z = sum3(w2, rot[k]);
        m0[k] = (diagonal.x * sum3(w0, rot[k]) + offset.x * z) * scale[k];
        m1[k] = (diagonal.y * sum3(w1, rot[k]) + offset.y * z) * scale[k];
    }
    // The determinant of M M^T is the sum of M's squared minors (Cauchy-Binet), which does not cancel for needles.
    vec3 minor;
    for (int k = 0; k < 3; ++k) {
        int i = k == 2 ? 0 : k + 1, j = k == 0 ? 2 : k - 1;
        Pair p = two_product(m0[i], m1[j]), q = two_product(m0[j], m1[i]);
        minor[k] = (p.x - q.x) + (p.y - q.y);
    }
    float eps = frame.view.eps2d;
    float xx = sum3(m0, m0), yy = sum3(m1, m1), cov_xy = sum3(m0, m1);
    float cov_xx = xx + eps, cov_yy = yy + eps;
    float det0 = sum3(minor, minor);
    float det = eps * (xx + yy + eps) + det0;
    // Beyond float's range (a deviation of some 1e9 px) a splat cannot be drawn.
    if (!finite(det) || !(det > 0.0 && det <= 3e38))
        return false;
    if (frame.view.antialias != 0)
        opacity *= max(sqrt(det0 / det), GS_COMPENSATION_MIN);
    if (!finite(opacity) || !(opacity >= GS_ALPHA_MIN && opacity <= 3e38))
        return false;

    s.mean = mean2d;
    s.log2_opacity = log2_polynomial(opacity);
    float t = max(s.log2_opacity - GS_LOG2_ALPHA_MIN, 0.0) * (1.0 / GS_HALF_LOG2E);
    s.extent = vec2(sqrt(t * cov_xx), sqrt(t * cov_yy));
    if (!finite(vec3(s.mean, s.extent.x)) || !finite(s.extent.y))
        return false;
    if (!(s.mean.x + s.extent.x >= 0.5 && s.mean.x - s.extent.x <= size.x - 0.5 && s.mean.y + s.extent.y >= 0.5 &&
          s.mean.y - s.extent.y <= size.y - 0.5))
        return false;
    float inverse_yy = 1.0 / cov_yy;
    s.vc = sqrt(GS_HALF_LOG2E * inverse_yy);
    s.ua = sqrt(GS_HALF_LOG2E * cov_yy / det);
    s.ub = -s.ua * cov_xy * inverse_yy;
    s.slope = cov_xy * inverse_yy;
    s.half_chord = sqrt(det) * inverse_yy;
    s.inverse_z = inverse_z;
    s.z = cam.z;

    // Mean less camera centre, by W^T (W mean + t), exact also far from the origin; parallel rays all run along W^T z.
    vec3 d = parallel ? w2 : w0 * cam.x + (w1 * cam.y + w2 * cam.z);
    d /= sqrt(sum3(d, d));
    s.color = color_of(row, d);
    if (!finite(s.color))
        return false;
    s.color = max(s.color, vec3(0.0));
    extent = max(s.extent.x, s.extent.y);
    return max(s.color.r, max(s.color.g, s.color.b)) <= GS_COLOR_MAX && finite(vec3(s.ua, s.ub, s.vc));
}

void main() {
    uint row = group_number() * GS_GROUP + lane();
    bool drawn = false;
    if (row < frame.count) {
        Splat s;
        float extent;
        drawn = project(row, s, extent);
        uint tiles = 0;
        if (drawn) {
            store_splat(row, s);
            tiles = tiles_of(s);
        }
        frame.keys.at[row] = drawn ? floatBitsToUint(s.z) : GS_NO_KEY; // depths are positive: their bits have their order
        frame.tile_counts.at[row] = tiles;
        frame.radii.at[row] = drawn ? (extent < 1e9 ? uint(extent) + 1u : 1000000000u) : 0u;
    }
    uint total;
    scan_group(drawn ? 1u : 0u, total);
    if (lane() == 0 && group_number() * GS_GROUP < frame.count) // a folded dispatch has more groups
        frame.sums.at[group_number()] = total;
}
