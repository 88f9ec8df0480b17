// Gradients of the raw parameters of each splat, in the planes of the model; zeros where it is not in the picture.
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

void main() {
    uint row = group_number() * GS_GROUP + lane(), n = frame.count;
    bool visible = row < n && frame.keys.at[min(row, n - 1)] != GS_NO_KEY;
    Projection p;
    Gradients g;
    if (visible)
        visible = gradients_of(row, p, g);
    if (training.learns_pose != 0)
        store_camera_parts(visible, p, g);
    if (row >= n)
        return;
    if (!visible)
        g.mean = g.scale = g.color = g.direction = vec3(g.opacity = 0.0);
    if (!visible) {
        g.quat = vec4(0.0);
        g.mean2d = vec2(0.0);
    }
    training.gradients.at[GS_PLANE_MEAN * n + row] = vec4(g.mean, g.opacity);
    training.gradients.at[GS_PLANE_QUAT * n + row] = g.quat;
    training.gradients.at[GS_PLANE_SCALE * n + row] = vec4(g.scale, 0.0);
    for (uint plane = 0; plane < training.sh_planes; ++plane)
        training.gradients.at[(GS_PLANE_SH + plane) * n + row] = sh_plane(plane, g.direction, g.color);
    training.means2d.at[2 * row] = g.mean2d.x;
    training.means2d.at[2 * row + 1] = g.mean2d.y;
}
