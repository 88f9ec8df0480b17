// Adds the parts of the gradient of the camera, in a fixed order and in pairs of floats.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
#include "arithmetic.glsl"
#include "pairs.glsl"

shared Pair parts[GS_GROUP];

void main() {
    uint id = lane(), groups = (frame.count + GS_GROUP - 1) / GS_GROUP;
    for (uint k = 0; k < 12; ++k) {
        Pair own = Pair(0.0);
        for (uint group = id; group < groups; group += GS_GROUP)
            own = sum(own, Pair(training.camera_parts.at[12 * group + k], 0.0));
        parts[id] = own;
        barrier();
        for (uint reach = GS_GROUP / 2; reach > 0; reach /= 2) {
            if (id < reach)
                parts[id] = sum(parts[id], parts[id + reach]);
            barrier();
        }
        if (id == 0)
            training.camera.at[k] = to_float(parts[0]);
        barrier();
    }
}
