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
    Projection p;
    Gradients g;
    bool visible = gradients_of(row, p, g);
    if (training.learns_pose != 0)
        store_camera_parts(visible, p, g);
    if (row >= n)
        return;
    training.gradients.at[GS_PLANE_MEAN * n + row] = vec4(g.mean, g.opacity);
    training.gradients.at[GS_PLANE_QUAT * n + row] = g.quat;
    training.gradients.at[GS_PLANE_SCALE * n + row] = vec4(g.scale, 0.0);
    for (uint plane = 0; plane < training.sh_planes; ++plane)
        training.gradients.at[(GS_PLANE_SH + plane) * n + row] = sh_plane(plane, g.direction, g.color);
    training.means2d.at[2 * row] = g.mean2d.x;
    training.means2d.at[2 * row + 1] = g.mean2d.y;
}
