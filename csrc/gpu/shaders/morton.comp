// Keys of rows along a Morton curve through their means, in a grid of 1024 cells per side; means beyond it are in its
// outermost cells.
#version 450
#extension GL_GOOGLE_include_directive : require
#define GS_PUSH gs_morton_push
#include "common.glsl"

// By bits, because a compiler may assume that there is no NaN.
float number_of(float x) {
    uint bits = floatBitsToUint(x), magnitude = bits & 0x7FFFFFFFu;
    return magnitude > 0x7F800000u ? 0.0 : uintBitsToFloat((bits & 0x80000000u) | min(magnitude, 0x7F7FFFFFu));
}

// Two zero bits after each bit of the cell's number.
uint spread_cell(float mean, float low, float scale) {
    uint x = uint(clamp((number_of(mean) - low) * scale, 0.0, 1023.0));
    x = (x | x << 16) & 0x030000FFu;
    x = (x | x << 8) & 0x0300F00Fu;
    x = (x | x << 4) & 0x030C30C3u;
    return (x | x << 2) & 0x09249249u;
}

void main() {
    uint i = group_number() * GS_GROUP + lane();
    if (i >= push.count)
        return;
    uint row = i;
    if (push.listed != 0u)
        row = push.list.at[i] & ~GS_FRESH;
    vec4 mean = push.values.at[push.begin + row];
    push.keys.at[i] = spread_cell(mean.x, push.low_x, push.scale_x) | spread_cell(mean.y, push.low_y, push.scale_y) << 1 |
                      spread_cell(mean.z, push.low_z, push.scale_z) << 2;
    push.order.at[i] = i;
}
