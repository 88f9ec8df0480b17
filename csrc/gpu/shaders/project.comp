// Projects splats, one per invocation: records, depth keys, radii, numbers of tiles, and the number of splats in the
// picture per workgroup.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"
#include "ellipse.glsl"
#include "harmonics.glsl"
#include "philox.glsl"
#include "projection.glsl"
#include "scan.glsl"

// False: not in the picture.
bool project(uint row, out Splat s, out float extent) {
    Projection p;
    if (!place(row, p) || !linearise(p))
        return false;
    vec2 size = vec2(float(frame.view.width), float(frame.view.height));
    float opacity = p.raised * p.compensation;
    if (!finite(opacity) || !(opacity >= GS_ALPHA_MIN && opacity <= 3e38))
        return false;

    s.mean = p.mean2d;
    s.log2_opacity = log2_polynomial(opacity);
    float t = max(s.log2_opacity - GS_LOG2_ALPHA_MIN, 0.0) * (1.0 / GS_HALF_LOG2E);
    s.extent = vec2(sqrt(t * p.cov_xx), sqrt(t * p.cov_yy));
    if (!finite(vec3(s.mean, s.extent.x)) || !finite(s.extent.y))
        return false;
    if (!(s.mean.x + s.extent.x >= 0.5 && s.mean.x - s.extent.x <= size.x - 0.5 && s.mean.y + s.extent.y >= 0.5 &&
          s.mean.y - s.extent.y <= size.y - 0.5))
        return false;
    float inverse_yy = 1.0 / p.cov_yy;
    s.vc = sqrt(GS_HALF_LOG2E * inverse_yy);
    s.ua = sqrt(GS_HALF_LOG2E * p.cov_yy / p.det);
    s.ub = -s.ua * p.cov_xy * inverse_yy;
    s.slope = p.cov_xy * inverse_yy;
    s.half_chord = sqrt(p.det) * inverse_yy;
    s.inverse_z = p.inverse_z;
    s.z = p.cam.z;

    vec3 d = from_centre(p);
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
